"""Queries beside the mapped lane: how far from the mapped path a robot can be.

Simulated worlds are mapped along a path in one session; in another (other cars and people, a tenth
of the things replaced), single scans are taken 0 to 15 m to the left and to the right of that path,
wherever there is room for a sensor: nothing within 1.5 m of it. Scans behind walls and inside
houses are among them: nothing says that a query can be found at all.

    python -m segloc_lab.protocols.offset

Real ones: keyframes of the second half of KITTI 00 that lie 3 to 20 m from the path of the first
half, where the drive crosses it, turns into it or leaves it; each alone and accumulated.

    python -m segloc_lab.protocols.offset --real DATA OUT   # OUT: of kitti00.sh
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from segloc import Config, Localizer, SegmentMap, build_map
from segloc.batch.score import distances_to_path, pose_errors
from segloc.descriptors import create
from segloc.types import Float64

from ..evaluation.scenario import QuerySet
from ..kitti00 import SECOND_HALF, keyframes, poses_of
from ..recordings import beside, has_room
from ..results.store import Cell, Result
from ..script import storing
from ..simulation import SCENES, Conditions, hdl64e
from .change import SIZES_M, evaluations, mapped_drive, ways_of

OFFSETS_M = (0.0, 3.0, 5.0, 7.5, 10.0, 12.5, 15.0)
WORLDS = {"town": 4, "industrial": 2, "park": 1}
"""How many of each kind."""
RIGHT_M, RIGHT_DEG = 1.0, 5.0
REAL_M = (3.0, 5.0, 10.0, 20.0)
NAME = "segloc_lab.protocols.offset"
Row = tuple[Cell, ...]


def simulated(name: str, seed: int, config: Config, every: int) -> Iterator[tuple[float, str]]:
    """The offset of each query from the mapped path, and what became of it."""
    world = SCENES[name](seed, size_m=SIZES_M[name])
    drive = mapped_drive(world, seed, hdl64e(900))
    localizer = Localizer(build_map(drive, config), config)
    again = replace(drive, session=1, conditions=Conditions(replaced=0.1), seed=seed + 1)
    for offset in OFFSETS_M:
        for side in (offset, -offset) if offset else (0.0,):
            shifted = beside(again, drive.truth[4::every], side)
            for i in range(len(shifted)):
                scan = shifted.scan(i)
                # Beside a bend the sensor may be nearer to another part of the path.
                gap = distances_to_path(shifted.truth[i : i + 1], drive.truth)[0]
                if gap > offset - 1.0 and has_room(scan, drive.sensor.mount_height_m):
                    T = localizer.localize(scan).T_map_sensor
                    yield offset, "lost" if T is None else _judged(T, shifted.truth[i])


def _judged(T: Float64, truth: Float64) -> str:
    metres, degrees = pose_errors(T[None], truth[None])
    return "found" if metres[0] < RIGHT_M and degrees[0] < RIGHT_DEG else "false"


def simulation(method: str, worlds: list[str], first_seed: int, every: int) -> Iterator[Row]:
    """A row for each kind of world: found of all queries at each offset."""
    config = Config.preset(method).model_copy(update={"threads": 1})
    for name in worlds:
        count = WORLDS[name]
        seen: Counter[tuple[float, str]] = Counter()
        for seed in range(first_seed, first_seed + count):
            seen.update(simulated(name, seed, config, every))
        totals = Counter(offset for offset, _ in seen.elements())
        cells = [f"{seen[o, 'found']} of {totals[o]}" for o in OFFSETS_M]
        false = sum(n for (_, what), n in seen.items() if what == "false")
        yield f"{count} x {name}", *cells, false


def real(data: Path, out: Path, methods: list[str]) -> Iterator[Row]:
    """A row for each method and way: found of all keyframes that lie so far from the path."""
    drive = keyframes(data, SECOND_HALF)
    alone = keyframes(data, SECOND_HALF, posed=False)
    truths = poses_of(drive)
    ways = ways_of({name: SegmentMap.load(out / f"first-{name}.segmap") for name in methods})
    distance = distances_to_path(truths, next(iter(ways.values())).trajectory)
    positions = np.flatnonzero((distance > REAL_M[0]) & (distance <= REAL_M[-1]))
    spans = [(distance[positions] > a) & (distance[positions] <= b) for a, b in pairwise(REAL_M)]
    descriptors = {method: create(method, 1) for method in methods}
    for name, recording in {"alone": alone, "accumulated": drive}.items():
        query_set = QuerySet(recording, positions, truths[positions])
        for (method, way), e in evaluations(query_set, descriptors, ways).items():
            cells = [f"{(e.correct & span).sum()} of {span.sum()}" for span in spans]
            yield method, way, name, *cells, int(e.false.sum())


def main() -> None:
    options = storing(__doc__)
    options.add_argument("--methods", nargs="+", default=["profile"])
    options.add_argument("--worlds", nargs="+", default=list(WORLDS), choices=list(WORLDS))
    options.add_argument("--real", nargs=2, type=Path, metavar=("DATA", "OUT"))
    options.add_argument("--seed", type=int, default=8000)
    options.add_argument("--every", type=int, default=6, help="scans, 2 m apart, between queries")
    args = options.parse_args()
    command = f"python -m {NAME}"
    if args.real:
        data, out = args.real
        columns = ("method", "by", "clouds", *(f"{a:g} to {b:g} m" for a, b in pairwise(REAL_M)))
        rows = list(real(data, out, args.methods))
        name, command = (
            "beside-real",
            f"{command} --real DATA OUT --methods {' '.join(args.methods)}",
        )
    else:
        columns = ("method", "scenes", *(f"{o:g} m" for o in OFFSETS_M))
        rows = [
            (method, *cells)
            for method in args.methods
            for cells in simulation(method, args.worlds, args.seed, args.every)
        ]
        name = "beside-simulated"
    columns = (*columns, "false")
    Result.measured(name, command, columns, rows, methods=args.methods).tell(args.store)


if __name__ == "__main__":
    main()
