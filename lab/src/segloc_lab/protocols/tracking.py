"""The tracker on a real drive: keyframes with odometry, on the map and far beyond it.

The first half of KITTI 00 is mapped and the second driven; then short parts are mapped, and all the
rest is driven from where they end, along streets that go on as the mapped ones did. Farther than
4 m from the truth is false; poses that odometry alone carries on, degraded, are counted apart.

    python -m segloc_lab.protocols.tracking DATA
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from segloc import Config, Localizer, Scan, build_map
from segloc.live import Status
from segloc.tools.batch import COVERAGE_RADIUS_M, distances_to_path
from segloc.tools.datasets import Sequence
from segloc.tracker import Tracker
from segloc.types import Bools, Float64

from ..kitti00 import FIRST_HALF, SECOND_HALF, keyframes, poses_of
from ..report import Cell, Table, publish, reporting

DRIVES = (
    (FIRST_HALF, SECOND_HALF),
    *((f"{a}:{a + 139}", f"{a + 170}:1820") for a in (100, 240, 380)),
)
FALSE_M = 4.0


def held(localizer: Localizer, drive: Sequence, step: int) -> tuple[Float64, Bools]:
    """Return the position error of every ``step``-th scan [m], and which are localized.

    The error is NaN without a pose.
    """
    tracker, poses = Tracker(localizer), poses_of(drive)
    errors, localized = list[float](), list[bool]()
    for i in range(0, len(drive), step):
        T = poses[i]
        track = tracker.update(Scan(drive.scan(i).points), T)
        off = np.full(3, np.nan)
        if track.T_map_odom is not None:
            off = (track.T_map_odom @ T)[:3, 3] - T[:3, 3]
        errors.append(float(np.linalg.norm(off)))
        localized.append(track.status is Status.LOCALIZED)
    return np.array(errors), np.array(localized)


def main() -> None:
    options = reporting(__doc__)
    options.add_argument("data", type=Path)
    options.add_argument("--method", default="profile")
    options.add_argument("--every", type=int, default=3, help="scans between queries")
    args = options.parse_args()
    config = Config.preset(args.method).model_copy(update={"threads": 1})
    rows: list[tuple[Cell, ...]] = []
    for mapped, driven in DRIVES:
        prior_map = build_map(keyframes(args.data, mapped), config)
        drive = keyframes(args.data, driven)
        errors, localized = held(Localizer(prior_map, config), drive, args.every)
        beside = distances_to_path(poses_of(drive)[:: args.every], prior_map.trajectory)
        inside, right, false = beside <= COVERAGE_RADIUS_M, errors <= FALSE_M, errors > FALSE_M
        found = f"{(inside & right & localized).sum()} of {inside.sum()}"
        degraded = np.isfinite(errors) & ~localized
        counts = [int(k.sum()) for s in (localized, degraded) for k in (s, s & false)]
        rows.append((mapped, driven, len(errors), found, *counts))
    columns = (
        *("map", "drive", "queries", "found within map coverage", "localized", "of them false"),
        *("degraded", "of them beyond 4 m"),
    )
    publish(args.report, "The tracker on KITTI 00", Table(columns, rows))


if __name__ == "__main__":
    main()
