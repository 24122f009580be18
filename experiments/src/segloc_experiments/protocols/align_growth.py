"""How the time of aligning sessions grows with their length: Markdown.

    python -m segloc_experiments.protocols.align_growth --lengths 500 1000 2000 [--every-part]

Six drifting sessions of a simulated town, as of ``protocols.align_simulation``; the town grows with
them, so that what a session meets again stays a share of its length. Times are processor time of
one thread, so that other work on the machine does not count; with ``--workers`` they are by the
clock on the wall. With ``--every-part`` each submap is
also localized in every part before it: the square that the growing map avoids. Needs the extra
``sim``.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import resource
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np

from segloc import Config, geometry
from segloc.alignment import AlignConfig, Reposed, align_sessions
from segloc.processes import executing
from segloc.simulation import SENSORS, Conditions, SimulatedSequence, simulate_sessions, town

from ..script import head, parser, row
from .align_kitti00 import DRIFT
from .align_simulation import errors, false_loops

EDGE_OF_LENGTH = 0.5
"""Of the town, as a share of the length of a session; at least the smallest."""
SMALLEST_M = 220.0


class Clock:
    """Seconds by the names of stages."""

    def __init__(self, now: Callable[[], float]) -> None:
        self.seconds: dict[str, float] = {}
        self._now = now

    @contextmanager
    def stage(self, label: str) -> Iterator[Callable[[int, int], None]]:
        name = label.split()[0]
        began = self._now()
        yield lambda done, total: None
        self.seconds[name] = self.seconds.get(name, 0.0) + self._now() - began


def drives_of(
    length_m: float, count: int, thin: int, seed: int, edge_m: float | None = None
) -> list[SimulatedSequence]:
    """Sessions of one town, every second one in winter."""
    seasons = [Conditions(), Conditions(foliage=0.2, replaced=0.2)]
    return simulate_sessions(
        town(seed, size_m=edge_m or max(SMALLEST_M, EDGE_OF_LENGTH * length_m)),
        SENSORS["hdl64e"]().thinned(thin),
        [seasons[k % 2] for k in range(count)],
        length_m=length_m,
        seed=seed,
    )


def drifted(drives: list[SimulatedSequence], seed: int) -> list[Reposed]:
    """The drives with 1 % of drift, each in a frame of its own."""
    sessions = []
    for k, drive in enumerate(drives):
        rng = np.random.default_rng([seed, k])
        shift = tuple(rng.uniform(-500, 500, 3).tolist())
        frame = geometry.yaw_transform(float(rng.uniform(-np.pi, np.pi)), shift)
        sessions.append(Reposed(drive, frame @ DRIFT.odometry(drive.truth, rng)))
    return sessions


def report(
    way: str, drives: list[SimulatedSequence], settings: AlignConfig, seed: int, workers: int
) -> None:
    """Align the drives, and print a row of what it cost and how good it is."""
    now = time.process_time if workers == 1 else time.perf_counter
    clock, began, config = Clock(now), now(), Config(threads=1)
    with executing(workers, None) as executor:
        sessions = drifted(drives, seed)
        found = align_sessions(sessions, config, settings, clock.stage, executor=executor)
    whole = now() - began
    spent = clock.seconds
    rest = whole - sum(spent.values())
    kilometres = sum(float(geometry.travelled(drive.truth)[-1]) for drive in drives) / 1000.0
    off = np.concatenate([*errors(drives, found).values(), np.empty((0, 2))])
    median = f"{np.median(off[:, 0]):.2f}" if len(off) else "-"
    accepted = sum(loop.accepted for loop in found.loops)
    peak_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    times = (f"{spent.get(name, 0.0):.0f}" for name in ("Describing", "Looking", "Aligning"))
    cells = (f"{kilometres:.2f}", *times, f"{rest:.0f}", f"{whole / kilometres:.0f}")
    good = (len(found.components), accepted, false_loops(drives, found), median)
    print(row(way, *cells, *good, f"{peak_mb:.0f}"), flush=True)


def main() -> None:
    options = parser(__doc__)
    options.add_argument("--lengths", type=float, nargs="+", default=[500.0, 1000.0, 2000.0])
    options.add_argument("--sessions", type=int, default=6)
    options.add_argument("--every", type=float, default=6.0, help="metres between submaps")
    options.add_argument("--part", type=float, default=200.0, help="metres of a part")
    options.add_argument("--thin", type=int, default=8, help="every n-th firing of the sensor")
    options.add_argument("--seed", type=int, default=5)
    options.add_argument("--every-part", action="store_true")
    options.add_argument("--edge", type=float, help="of the town, metres; by default as it grows")
    options.add_argument("--workers", type=int, default=1)
    args = options.parse_args()
    times = ("description s", "loops s", "neighbours s", "graph s", "s a km")
    good = ("components", "loops", "false", "median error m")
    print(head("searched", "km in all", *times, *good, "peak MB"), flush=True)
    for length_m in args.lengths:
        drives = drives_of(length_m, args.sessions, args.thin, args.seed, args.edge)
        settings = AlignConfig(every_m=args.every, part_m=args.part)
        report("parts that are voted for", drives, settings, args.seed, args.workers)
        if args.every_part:
            all_parts = settings.model_copy(update={"searched_parts": 10**6})
            report("every part", drives, all_parts, args.seed, args.workers)


if __name__ == "__main__":
    main()
