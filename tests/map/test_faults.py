"""Full devices, limits of the system and Ctrl-C: one line, and nothing half-written."""

from __future__ import annotations

import os
import re
import resource
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from samples.maps import make_map

from segloc import SegmentMap
from segloc.errors import SeglocError

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(sys.platform != "linux", reason="faults are made with Linux' means"),
]

SEGLOC = [
    sys.executable,
    "-c",
    "from segloc.tools.cli import main; print('up', flush=True); main()",
]


def segloc(
    folder: Path, *arguments: str, limits: Callable[[], None] | None = None
) -> tuple[int, str]:
    """Exit status and errors of a command."""
    done = subprocess.run(
        [*SEGLOC, *arguments],
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
        timeout=200,
        preexec_fn=limits,
        env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
    )
    return done.returncode, done.stderr


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def assert_one_line(errors: str, match: str) -> None:
    output = [line for line in errors.splitlines() if not line.startswith("segloc: note: ")]
    assert len(output) == 1 and re.match(rf"segloc: {match}", output[0]), errors


def test_a_device_that_is_full_is_refused(place: Path) -> None:
    with pytest.raises(SeglocError, match="not a regular file"):
        make_map().save("/dev/full")
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(
            [*SEGLOC, "map", "info", str(place / "site.segmap")],
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
            check=False,
            timeout=100,
        )
    assert done.returncode != 0
    assert "no space left" in done.stderr.lower()


def test_a_limit_on_memory_is_said_in_a_line(tmp_path: Path) -> None:
    make_map(1, segments=1_500_000).save(tmp_path / "large.segmap")  # 114 MB
    code, errors = segloc(
        tmp_path, "map", "merge", "large.segmap", "large.segmap", "--out", "out.segmap",
        limits=lambda: resource.setrlimit(resource.RLIMIT_AS, (520 << 20, 520 << 20)),
    )  # fmt: skip
    assert code == 1, errors
    assert_one_line(errors, r"error: .*memory")
    assert names(tmp_path) == ["large.segmap"]


COMMANDS = {
    "build": "map build one --poses poses.tum --out out.segmap",
    "update": "map update site.segmap two --poses two/poses.tum --out out.segmap",
    "localize": "localize two --map site.segmap --out out",
    "align": "align one two --poses poses.tum --out out",
}


TELLING = """
import os, signal, sys, time

signal.signal(signal.SIGINT, signal.default_int_handler)  # jobs in the background ignore it

def watch(event, given):
    # Python tells of every file that is opened, and here of those in the working folder.
    if event != "open" or not isinstance(given[0], (str, os.PathLike)):
        return
    path = os.path.abspath(given[0])
    if not path.startswith(os.getcwd() + os.sep) or path.endswith(".lock"):
        return
    if not given[2] & (os.O_WRONLY | os.O_RDWR):
        return
    print("writing", flush=True)
    for _ in range(1000):  # a signal that arrives before a sleep is handled after it
        time.sleep(0.1)

sys.addaudithook(watch)
from segloc.tools.cli import main
main()
"""
"""The command line, which reports its first write and waits there."""


def interrupted(folder: Path, command: str) -> tuple[int, str]:
    """Exit status and errors of a command that gets Ctrl-C at its first write."""
    process = subprocess.Popen(
        [sys.executable, "-c", TELLING, *command.split()],
        cwd=folder,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        env={**os.environ, "COLUMNS": "500"},  # notes are not wrapped
    )
    assert process.stdout
    output = next((line for line in process.stdout if line == "writing\n"), "")
    os.killpg(process.pid, signal.SIGINT)  # as a terminal does: its children, too
    errors = process.communicate(timeout=100)[1]
    assert output, errors
    return process.returncode, errors


@pytest.fixture
def workplace(place: Path, tmp_path: Path) -> Path:
    for part in place.iterdir():
        (tmp_path / part.name).symlink_to(part)
    return tmp_path


@pytest.mark.parametrize("name", COMMANDS)
def test_an_interrupt_ends_in_a_line(name: str, workplace: Path) -> None:
    """Interrupt a command where it first writes a file."""
    code, errors = interrupted(workplace, COMMANDS[name])
    assert code == 130, (code, errors)
    assert_one_line(errors, "interrupted$")
    for path in workplace.rglob("*"):
        assert not path.name.endswith((".tmp", ".lock")), path
    assert not (workplace / "out.segmap").exists()


def test_a_folder_that_may_only_be_read(place: Path, tmp_path: Path) -> None:
    make_map(1).save(tmp_path / "a.segmap")
    tmp_path.chmod(0o500)
    try:
        if os.access(tmp_path, os.W_OK):
            mount = ["mount", "--bind", str(tmp_path), str(tmp_path)]
            again = ["mount", "-o", "remount,ro,bind", str(tmp_path)]
            if any(subprocess.run(c, capture_output=True, check=False).returncode
                   for c in (mount, again)):  # fmt: skip
                pytest.skip("root may write anywhere, and may not mount here")
        assert len(SegmentMap.load(tmp_path / "a.segmap")) == 3
        with pytest.raises(SeglocError, match=r"cannot be written: (read-only|permission)"):
            make_map(2).save(tmp_path / "a.segmap")
        code, errors = segloc(tmp_path, "map", "merge", "a.segmap", "a.segmap", "--out", "a.segmap")
        assert code == 1
        assert_one_line(errors, r"error: a\.segmap: cannot be written: (read-only|permission)")
    finally:
        subprocess.run(["umount", str(tmp_path)], capture_output=True, check=False)
        tmp_path.chmod(0o700)
    assert names(tmp_path) == ["a.segmap"]
    assert np.isfinite(SegmentMap.load(tmp_path / "a.segmap").vectors).all()
