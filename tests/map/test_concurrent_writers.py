"""Several processes that write one map: nothing is lost, and no killed one blocks the others."""

from __future__ import annotations

import signal
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from samples.maps import make_map

from segloc import SegmentMap
from segloc.system.files import replacing
from segloc.system.locks import exclusive

SEGLOC = [sys.executable, "-c", "from segloc.tools.cli import main; main()"]
HOLD = """
import sys, time
from segloc.system.locks import exclusive
with exclusive(sys.argv[1]):
    print("held", flush=True)
    time.sleep(60)
"""
HALF = """
import sys, time
from segloc.system.files import replacing
with replacing(sys.argv[1]) as stream:
    stream.write(b"half")
    stream.flush()
    print("held", flush=True)
    time.sleep(60)
"""


def started(code: str, path: Path) -> subprocess.Popen[str]:
    child = subprocess.Popen(
        [sys.executable, "-c", code, str(path)], stdout=subprocess.PIPE, text=True
    )
    assert child.stdout and child.stdout.readline() == "held\n"
    child.stdout.close()
    return child


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir() if path.is_file())


@pytest.mark.slow
def test_of_two_updates_at_once_both_sessions_are_there(place: Path, tmp_path: Path) -> None:
    site = tmp_path / "site.segmap"
    site.write_bytes((place / "site.segmap").read_bytes())
    command = [*SEGLOC, "map", "update", str(site), "--out", str(site), "--threads", "1"]
    running = [
        subprocess.Popen(
            [*command, str(place / name), "--poses", "poses.tum"],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
        )
        for name in ("one", "two")
    ]
    output = [process.communicate(timeout=200)[1] for process in running]
    assert [process.returncode for process in running] == [0, 0], output
    assert len(np.unique(SegmentMap.load(site).session)) == 3
    assert sum("waiting for another process" in text for text in output) <= 1
    assert names(tmp_path) == ["site.segmap"]


def test_a_killed_holder_blocks_nobody(tmp_path: Path) -> None:
    path = tmp_path / "site.segmap"
    child = started(HOLD, path)
    assert names(tmp_path) == [".site.segmap.lock"]
    waited: list[float] = []

    def wait() -> None:
        with exclusive(path, lambda: waited.append(0.0)):
            waited.append(time.monotonic())

    thread = threading.Thread(target=wait)
    thread.start()
    time.sleep(0.3)
    assert len(waited) == 1  # told that it waits, and waiting
    child.send_signal(signal.SIGKILL)
    thread.join(20)
    assert len(waited) == 2
    child.wait()
    assert names(tmp_path) == []


def test_locks_are_passed_on_one_at_a_time(tmp_path: Path) -> None:
    inside, most = [0], [0]

    def work(_: int) -> None:
        for _ in range(8):
            with exclusive(tmp_path / "a"):
                inside[0] += 1
                most[0] = max(most[0], inside[0])
                time.sleep(0.0005)
                inside[0] -= 1

    with ThreadPoolExecutor(6) as threads:
        list(threads.map(work, range(6)))
    assert (inside, most) == ([0], [1])
    assert names(tmp_path) == []


def test_what_a_killed_save_left_is_removed_by_the_next(tmp_path: Path) -> None:
    path = tmp_path / "site.segmap"
    killed, other = started(HALF, path), started(HALF, tmp_path / "other.segmap")
    running = started(HALF, path)
    for child in (killed, other):
        child.kill()
        child.wait()
    assert len(names(tmp_path)) == 3
    kept = {name for name in names(tmp_path) if f".{killed.pid}-" not in name}
    make_map().save(path)
    assert set(names(tmp_path)) == kept | {"site.segmap"}  # another file's, and a live writer's
    running.kill()
    running.wait()
    with replacing(path) as stream:
        stream.write(b"new")
    assert [n for n in names(tmp_path) if n.startswith(".site")] == []


def test_a_writer_that_cannot_be_seen_but_holds_its_lock_is_left_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As on a folder that several containers share."""
    monkeypatch.setattr("segloc.system.files.process_lives", lambda _: False)
    running = started(HALF, tmp_path / "site.segmap")
    make_map().save(tmp_path / "site.segmap")
    assert len(names(tmp_path)) == 2
    running.kill()
    running.wait()
    make_map().save(tmp_path / "site.segmap")
    assert names(tmp_path) == ["site.segmap"]


def test_many_writers_of_one_file_never_break_it(tmp_path: Path) -> None:
    path = tmp_path / "a.segmap"
    make_map(1).save(path)

    def write(seed: int) -> None:
        for k in range(5):
            make_map(1, seed=10 * seed + k).save(path)

    with ThreadPoolExecutor(4) as threads:
        writers = [threads.submit(write, seed) for seed in range(4)]
        while not all(writer.done() for writer in writers):
            assert len(SegmentMap.load(path)) == 3
    assert [writer.exception() for writer in writers] == [None] * 4
    assert names(tmp_path) == ["a.segmap"]
