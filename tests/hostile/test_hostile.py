"""Whatever is in a file, it is read or refused in one line: no crash, no hang, no traceback."""

from __future__ import annotations

import json
import os
import random
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from hostile import files
from hostile.files import Hostile

pytestmark = [
    pytest.mark.fuzz,
    pytest.mark.skipif(sys.platform != "linux", reason="limits memory as Linux does"),
]
HUNG_S = 250.0  # without an answer; what computes is ended by hostile.opened long before
FOUND = Path(__file__).with_name("found")
TESTS = Path(__file__).resolve().parents[1]


def environment() -> dict[str, str]:
    paths = [str(TESTS), *filter(None, sys.path)]
    limits = {"SEGLOC_MAX_POINTS": str(files.MAX_POINTS), "OPENBLAS_NUM_THREADS": "1"}
    return {**os.environ, **limits, "PYTHONPATH": os.pathsep.join(paths)}


def open_all(listed: list[tuple[str, str, Path]], folder: Path) -> dict[str, tuple[str, str]]:
    """What comes of each, by its name; a new process goes on where one ended."""
    results: dict[str, tuple[str, str]] = {}
    while waiting := [item for item in listed if item[0] not in results]:
        before = len(results)
        _open_some(waiting, folder, results)
        assert len(results) > before
    return results


def _open_some(
    listed: list[tuple[str, str, Path]], folder: Path, results: dict[str, tuple[str, str]]
) -> None:
    names, report = folder / "list", folder / "report"
    names.write_text("".join(f"{json.dumps([n, how, str(p)])}\n" for n, how, p in listed))
    report.write_text("")
    command = [sys.executable, "-m", "hostile.opened", str(names), str(report)]
    with (folder / "errors").open("wb") as errors:
        child = subprocess.Popen(command, env=environment(), stderr=errors)
        size, since = 0, time.monotonic()
        ended, hung = None, False
        while ended is None and not hung:
            time.sleep(0.05)
            ended = child.poll()
            if (now := report.stat().st_size) != size:
                size, since = now, time.monotonic()
            hung = time.monotonic() - since > HUNG_S
        if hung:
            child.kill()
            child.wait()
    lines = [json.loads(line) for line in report.read_text().splitlines()]
    output = (folder / "errors").read_text("utf-8", "replace")
    for (_, name), (what, text) in zip(lines[::2], lines[1::2], strict=False):
        results[name] = (what, text)
    if len(lines) % 2:
        slow = ended == -signal.SIGXCPU
        fault = "hung" if hung else "too slow" if slow else f"ended the process: {ended}"
        results[lines[-1][1]] = ("broken", f"{fault} {output[-500:]}")
    elif ended:
        raise AssertionError(output[-2000:])
    assert "Traceback" not in output, output[-2000:]


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> dict[str, tuple[Hostile, Path]]:
    folder = tmp_path_factory.mktemp("hostile")
    return {item.name: (item, item.write(folder)) for item in files.HOSTILE}


def test_what_is_said_of_hostile_files(
    made: dict[str, tuple[Hostile, Path]], tmp_path: Path
) -> None:
    results = open_all([(name, item.how, path) for name, (item, path) in made.items()], tmp_path)
    wrong = []
    for name, (item, path) in made.items():
        what, text = results[name]
        if what == "broken":
            wrong.append(f"{name}: {text}")
        elif what == "read" and not item.may_be_read:
            wrong.append(f"{name}: read ({text})")
        elif item.expected and not re.search(item.expected, text):
            wrong.append(f"{name}: {what}: {text!r} does not mention {item.expected!r}")
        elif what == "refused" and not item.expected and path.stem not in text:
            wrong.append(f"{name}: {text!r} does not name the file")
    assert not wrong, "\n".join(wrong)


def test_what_fuzzing_found(tmp_path: Path) -> None:
    listed = [
        (file.name, file.parent.name, file) for file in sorted(FOUND.glob("*/*")) if file.is_file()
    ]
    broken = {name: text for name, (what, text) in open_all(listed, tmp_path).items()
              if what == "broken"}  # fmt: skip
    assert not broken, broken


def test_drawn_messages_and_bags(tmp_path: Path) -> None:
    """What a robot's topics say, and bags of any layout; ``make fuzz`` draws many more."""
    pytest.importorskip("rosbags")
    listed = []
    for how, count in (("node", 15), ("layout", 6)):
        for seed in range(count):
            file = tmp_path / f"{how}-{seed}"
            file.write_bytes(random.Random(seed).randbytes(600))
            listed.append((file.name, how, file))
    broken = {name: text for name, (what, text) in open_all(listed, tmp_path).items()
              if what == "broken"}  # fmt: skip
    assert not broken, broken
