"""How the time of aligning sessions grows with their length: Markdown.

    python -m segloc_lab.protocols.align_growth --lengths 500 1000 2000 [--every-part]

Six drifting sessions of a simulated town, as of ``protocols.align_simulation``; its area grows with
their length. They are recorded first, so that neither time nor memory is the simulator's. Times are
processor time of one thread, so that other work on the machine does not count; with ``--workers``
they are by the clock on the wall. With ``--every-part`` each submap is also localized in every part
before it: the square that the growing map avoids. What has been measured is kept, a line a length,
and a run goes on where the last one ended. Needs the extra ``sim``.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import resource
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from segloc import Config, geometry
from segloc.datasets import Sequence, open_sequence
from segloc.loops import AlignConfig, Reposed, align_sessions
from segloc.system.processes import executing

from ..bench.harness import in_process
from ..journal import entries, keep
from ..kitti00 import poses_of
from ..results.fingerprints import LOCALIZING
from ..results.store import Cell, Result
from ..script import resumed
from ..simulation import SENSORS, Conditions, record, simulate_sessions, town
from .align_kitti00 import DRIFT
from .align_simulation import errors, false_loops

EDGE_M = 12.5
"""Of the town, times the root of a session's length; at least the smallest."""
SMALLEST_M = 220.0
POSES = "poses.tum"
STAGES_OF_ALIGNING = ("Describing", "Looking", "Aligning")
VOTED = "parts that are voted for"
COLUMNS = (
    *("searched", "km in all", "description s", "loops s", "neighbours s", "graph s", "s a km"),
    *("components", "loops", "false", "median error m", "peak MB"),
)


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


def recorded(folder: Path, length_m: float, count: int, thin: int, seed: int) -> None:
    """Record sessions of one town, every second one in winter, those that are not there yet."""
    paths = [folder / f"session_{k}" for k in range(count)]
    if all((path / POSES).exists() for path in paths):
        return
    seasons = [Conditions(), Conditions(foliage=0.2, replaced=0.2)]
    drives = simulate_sessions(
        town(seed, size_m=max(SMALLEST_M, EDGE_M * np.sqrt(length_m))),
        SENSORS["hdl64e"]().thinned(thin),
        [seasons[k % 2] for k in range(count)],
        length_m=length_m,
        seed=seed,
    )
    for drive, path in zip(drives, paths, strict=True):
        if not (path / POSES).exists():
            record(drive, path, workers=1)


def drifted(drives: list[Sequence], seed: int) -> list[Reposed]:
    """The drives with 1 % of drift, each in a frame of its own."""
    sessions = []
    for k, drive in enumerate(drives):
        rng = np.random.default_rng([seed, k])
        shift = tuple(rng.uniform(-500, 500, 3).tolist())
        frame = geometry.yaw_transform(float(rng.uniform(-np.pi, np.pi)), shift)
        sessions.append(Reposed(drive, frame @ DRIFT.odometry(poses_of(drive), rng)))
    return sessions


def measured(
    folder: Path, count: int, settings: AlignConfig, seed: int, workers: int
) -> dict[str, float]:
    """Align the recordings in a folder: what each stage cost, and how good it is."""
    drives = [open_sequence(folder / f"session_{k}", POSES) for k in range(count)]
    truths = [poses_of(drive) for drive in drives]
    now = time.process_time if workers == 1 else time.perf_counter
    clock, began, config = Clock(now), now(), Config(threads=1)
    with executing(workers, None) as executor:
        sessions = drifted(drives, seed)
        found = align_sessions(sessions, config, settings, clock.stage, executor=executor)
    whole, spent = now() - began, clock.seconds
    off = np.concatenate([*errors(truths, found).values(), np.empty((0, 2))])
    return {
        "km": sum(float(geometry.travelled(truth)[-1]) for truth in truths) / 1000.0,
        **{stage: spent.get(stage, 0.0) for stage in STAGES_OF_ALIGNING},
        "rest": whole - sum(spent.values()),
        "whole": whole,
        "components": len(found.components),
        "loops": sum(loop.accepted for loop in found.loops),
        "false": false_loops(truths, found),
        "error_m": float(np.median(off[:, 0])) if len(off) else float("nan"),
        "peak_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
    }


def _cells(found: dict[str, Any]) -> tuple[Cell, ...]:
    seconds = [round(found[name]) for name in (*STAGES_OF_ALIGNING, "rest")]
    a_km = round(found["whole"] / found["km"], 1)
    good = found["components"], found["loops"], found["false"], round(found["error_m"], 2)
    return (
        found["searched"],
        round(found["km"], 2),
        *seconds,
        a_km,
        *good,
        round(found["peak_mb"]),
    )


def report(found: list[dict[str, Any]], store: Path | None) -> None:
    """Print the table, and keep it where results are."""
    rows = [_cells(each) for each in found]
    command = "python -m segloc_lab.protocols.align_growth --report align_growth.jsonl"
    stages, kept = (*LOCALIZING, "alignment"), {"runs": found}
    Result.measured("align-growth", command, COLUMNS, rows, stages=stages, counts=kept).tell(store)


def main() -> None:
    options = resumed(__doc__, "align_growth.jsonl")
    options.add_argument("--lengths", type=float, nargs="+", default=[500.0, 1000.0, 2000.0])
    options.add_argument("--sessions", type=int, default=6)
    options.add_argument("--every", type=float, default=6.0, help="metres between submaps")
    options.add_argument("--part", type=float, default=200.0, help="metres of a part")
    options.add_argument("--thin", type=int, default=8, help="every n-th firing of the sensor")
    options.add_argument("--seed", type=int, default=5)
    options.add_argument("--every-part", action="store_true")
    options.add_argument("--scans", type=Path, default=Path("align_growth"), help="a folder")
    options.add_argument("--workers", type=int, default=1)
    args = options.parse_args()
    if args.report:
        report([run for path in args.report for run in entries(path)], args.store)
        return
    settings = AlignConfig(every_m=args.every, part_m=args.part)
    ways = {VOTED: settings}
    if args.every_part:
        ways["every part"] = settings.model_copy(update={"searched_parts": 10**6})
    done = entries(args.out) if args.out.exists() else []
    for length_m in args.lengths:
        runs = [{"searched": w, "length_m": length_m, "sessions": args.sessions} for w in ways]
        left = [run for run in runs if not any(run.items() <= kept.items() for kept in done)]
        if not left:
            continue
        folder = args.scans / f"{args.sessions} x {length_m:g} m, seed {args.seed}"
        in_process(1, recorded, folder, length_m, args.sessions, args.thin, args.seed)
        for run in left:
            way = ways[run["searched"]]
            found = in_process(1, measured, folder, args.sessions, way, args.seed, args.workers)
            keep(args.out, run | found)
    report(entries(args.out), args.store)


if __name__ == "__main__":
    main()
