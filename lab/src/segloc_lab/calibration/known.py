"""Fit what a view says about a pose that is known already: that of a tracker.

Each drive of the worlds (:mod:`.worlds`) is followed scan by scan, at every 2 m, in the map of its
world and in the first half of it, past whose end the robot drives; a fifth of the things are
replaced. A scan is compared at the true pose, and at wrong ones: every :data:`EVERY`-th scan is
searched, and from the likeliest wrong places robots that believe to be there drive on by the same
odometry, as one that was carried to a place that looks alike does.

    python -m segloc_lab.calibration.known rows/fit --out known.npz --every 3
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from pathlib import Path

import numpy as np
from rich.progress import track

from segloc import Config, Localizer, Scan, geometry
from segloc.likelihood import FEATURES, ScoredPose
from segloc.system.processes import in_parallel
from segloc.types import Float64, LocalCloud, Pose

from ..script import parser
from .rows import World, errors, is_right, worlds_of
from .worlds import narrowed

EVERY, HELD = 6, 2
"""Scans between searches, and the wrong places held from each until the next."""
SEARCHED = ("own", "half")
COLUMNS = ("map", "narrow", "track", "step", "right", "log_ratio", "unknown", *FEATURES)
Row = tuple[float, ...]


def rows_of(world: World, config: Config) -> Float64:
    """Follow the drives of a world, at right and at wrong poses, (N, K)."""
    rows: list[Row] = []
    for m, name in enumerate(SEARCHED):
        localizer = Localizer(world.maps[name], config)
        for n, (scans, truths) in enumerate(world.drives()):
            rows += ((m, 0, *row) for row in _followed(localizer, scans, truths, n))
            few = [
                Scan(narrowed(s.points, k), T_odom_sensor=s.T_odom_sensor)
                for k, s in enumerate(scans)
            ]
            rows += ((m, 1, *row) for row in _followed(localizer, few, truths, n))
    return np.array(rows, np.float64).reshape(-1, len(COLUMNS))


def _followed(
    localizer: Localizer, scans: list[Scan], truths: Float64, drive: int
) -> Iterator[Row]:
    """Yield the track, step, label, log-ratio and unknown share of each comparison."""
    held: list[Pose] = []
    before: Pose | None = None
    for i, (scan, truth) in enumerate(zip(scans, truths, strict=True)):
        cloud, T_odom_sensor = localizer.accumulator.gather(scan), scan.T_odom_sensor
        assert T_odom_sensor is not None
        T_local_sensor = cloud.T_local_sensor
        if i % EVERY == 0:
            query = localizer.describe(cloud)
            places = localizer.search(query).posterior.places
            found = (place.T_map_local @ T_local_sensor for place in places)
            held = [T for T in found if not is_right(*errors(T, truth))][:HELD]
        elif before is not None:
            moved = geometry.inverse(before) @ T_odom_sensor
            held = [T @ moved for T in held]
        before, step = T_odom_sensor, i % EVERY
        at = _compared(localizer, cloud, truth)
        if at is not None:
            yield 100 * drive, i, 1, at.log_ratio, at.unknown, *at.features
        for k, T in enumerate(held):
            at = _compared(localizer, cloud, T)
            if at is None:
                continue
            held[k] = T_there = at.T_map_local @ T_local_sensor
            right = bool(is_right(*errors(T_there, truth)))
            number = 100 * drive + i // EVERY * HELD + k + 1
            yield number, step, right, at.log_ratio, at.unknown, *at.features


def _compared(localizer: Localizer, cloud: LocalCloud, T_map_sensor: Pose) -> ScoredPose | None:
    """Compare a cloud at a known pose; None if it has nothing to compare."""
    T = T_map_sensor @ geometry.inverse(cloud.T_local_sensor)
    apart = localizer.likelihood.separation.apart
    places = localizer.compare(cloud, [T]).places
    return next((place for place in places if not apart(place.T_map_local, T)), None)


def main() -> None:
    options = parser(__doc__)
    options.add_argument("worlds", type=Path, help="folder of generated worlds")
    options.add_argument("--out", type=Path, default=Path("known.npz"))
    options.add_argument("--every", type=int, default=1, help="take each Nth world")
    options.add_argument("--workers", type=int, default=1, help="processes")
    args = options.parse_args()
    chosen = worlds_of(args.worlds)[:: args.every]
    found = in_parallel(partial(rows_of, config=Config(threads=1)), chosen, args.workers)
    rows = {chosen[k].name: each for k, each in track(found, "worlds", total=len(chosen))}
    np.savez_compressed(args.out, **rows)  # type: ignore[arg-type]


if __name__ == "__main__":
    main()
