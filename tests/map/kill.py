"""Kill processes that save, update and merge maps, and look at what is left.

    python tests/map/kill.py --kills 300

After every kill the map must be one that was saved whole, a lock must be had at once, and the next
save must remove what the killed one left. Linux; children are forked, so that a kill takes
milliseconds.
"""

from __future__ import annotations

import argparse
import os
import random
import shutil
import signal
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from samples.maps import make_map
from samples.plaza import Plaza, PlazaSequence

from segloc import Config, SegmentMap, build_map
from segloc.cli import main
from segloc.io import Trajectory, write_scan, write_tum
from segloc.system.locks import exclusive

CONFIG = Config.preset("geo").model_copy(update={"threads": 1})
Work = Callable[[Path], None]


def prepare(folder: Path) -> None:
    """Maps and a recording to work with."""
    run, plaza = PlazaSequence(Plaza(0), steps=5), Plaza(0)
    build_map(run, CONFIG).save(folder / "old.segmap")
    run.poses[:, 1, 3] += 1.0
    build_map(run, CONFIG).save(folder / "other.segmap")
    (folder / "run").mkdir()
    for i in range(len(run)):
        write_scan(folder / "run" / f"{i}.npy", plaza.scan(run.poses[i], seed=50 + i).points)
    write_tum(folder / "run" / "poses.tum", Trajectory(run.indices.astype(float), run.poses))
    make_map(1, segments=60_000).save(folder / "large.segmap")


def command(*arguments: str | Path) -> None:
    sys.argv = ["segloc", *map(str, arguments)]
    try:
        main()
    except SystemExit as end:
        if end.code:
            raise


def save(folder: Path) -> None:
    large, small = (SegmentMap.load(folder / f"{name}.segmap") for name in ("large", "old"))
    print("ready", flush=True)
    while True:
        large.save(folder / "site.segmap")
        small.save(folder / "site.segmap")


def merge(folder: Path) -> None:
    print("ready", flush=True)
    while True:
        shutil.copy(folder / "old.segmap", folder / "fresh.segmap")
        (folder / "fresh.segmap").replace(folder / "site.segmap")
        site = folder / "site.segmap"
        command("map", "merge", site, folder / "other.segmap", "--out", site)


def update(folder: Path) -> None:
    print("ready", flush=True)
    site, run = folder / "site.segmap", folder / "run"
    command("map", "update", site, run, "--poses", run / "poses.tum", "--out", site,
            "--threads", "1")  # fmt: skip


LONGEST_S = {"save": 0.3, "merge": 0.8, "update": 2.5}
WORKS: dict[str, Work] = {"save": save, "merge": merge, "update": update}


def forked(work: Callable[[], None], output: int | None = None) -> int:
    """The number of a child that does the work and ends."""
    if child := os.fork():
        return child
    status = 1
    try:
        if output is not None:
            os.dup2(output, 1)
        work()
        status = 0
    finally:
        os._exit(status)


def kill_one(folder: Path, name: str, delay: float) -> str:
    """Kill one child some time after it began; what state the map is in, or AssertionError."""
    site = folder / "site.segmap"
    shutil.copy(folder / "old.segmap", site)
    reader, writer = os.pipe()
    child = forked(lambda: WORKS[name](folder), writer)
    os.close(writer)
    assert os.read(reader, 5) == b"ready"
    time.sleep(delay)
    os.kill(child, signal.SIGKILL)
    status = os.waitpid(child, 0)[1]
    os.close(reader)
    assert status in (0, signal.SIGKILL), f"{name}: it had ended by itself, with status {status}"
    state = check(folder)
    assert state in STATES[name], (name, state)
    return state


STATES = {"save": {"old", "large"}, "merge": {"old", "merged"}, "update": {"old", "merged"}}


def check(folder: Path) -> str:
    site = SegmentMap.load(folder / "site.segmap")
    leftovers = [path.name for path in folder.iterdir() if path.name.startswith(".site")]
    start = time.monotonic()
    waited: list[None] = []
    with exclusive(folder / "site.segmap", lambda: waited.append(None)):
        site.save(folder / "again.segmap")
        site.save(folder / "site.segmap")
    assert not waited and time.monotonic() - start < 5, "something blocks"
    left = [path.name for path in folder.iterdir() if path.name.startswith(".site")]
    assert not left, f"{leftovers}: {left} is left"
    if len(site) == 60_000:
        return "large"
    return "old" if len(np.unique(site.session)) == 1 else "merged"


def run(kills: int, seed: int, folder: Path) -> dict[str, Counter[str]]:
    """How often the map was in which state, for each kind of work."""
    assert os.waitpid(forked(lambda: prepare(folder)), 0)[1] == 0  # here no thread is started
    rng, found = random.Random(seed), {name: Counter[str]() for name in WORKS}
    for k in range(kills):
        name = list(WORKS)[k % len(WORKS)]
        found[name][kill_one(folder, name, rng.uniform(0, LONGEST_S[name]))] += 1
    return found


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kills", type=int, default=300)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as root:
        for work, states in run(given.kills, given.seed, Path(root)).items():
            counts = ", ".join(f"{count} {state}" for state, count in sorted(states.items()))
            print(f"{work}: {sum(states.values())} kills: {counts}")
