"""The tracker on a real drive: keyframes with odometry, on the map and far beyond it.

The first half of KITTI 00 is mapped and the second driven; then short parts are mapped, and all the
rest is driven from where they end, along streets that go on as the mapped ones did. What is held
farther than 4 m from the truth is false.

    python -m segloc_lab.protocols.tracking DATA
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from segloc import Config, Localizer, Scan, build_map
from segloc.tools.batch import COVERAGE_RADIUS_M, distances_to_path
from segloc.tools.datasets import Sequence
from segloc.tracker import Tracker
from segloc.types import Float64

from ..kitti00 import FIRST_HALF, SECOND_HALF, keyframes, poses_of
from ..report import Table, publish, reporting

DRIVES = (
    (FIRST_HALF, SECOND_HALF),
    *((f"{a}:{a + 139}", f"{a + 170}:1820") for a in (100, 240, 380)),
)
FALSE_M = 4.0


def held(localizer: Localizer, drive: Sequence, step: int) -> Float64:
    """Return the position error of every ``step``-th scan [m]; NaN if unknown."""
    tracker, poses = Tracker(localizer), poses_of(drive)
    errors = []
    for i in range(0, len(drive), step):
        T = poses[i]
        track = tracker.update(Scan(drive.scan(i).points), T)
        off = np.full(3, np.nan)
        if track.T_map_odom is not None:
            off = (track.T_map_odom @ T)[:3, 3] - T[:3, 3]
        errors.append(float(np.linalg.norm(off)))
    return np.array(errors)


def main() -> None:
    options = reporting(__doc__)
    options.add_argument("data", type=Path)
    options.add_argument("--method", default="profile")
    options.add_argument("--every", type=int, default=3, help="scans between queries")
    args = options.parse_args()
    config = Config.preset(args.method).model_copy(update={"threads": 1})
    rows = []
    for mapped, driven in DRIVES:
        prior_map = build_map(keyframes(args.data, mapped), config)
        drive = keyframes(args.data, driven)
        errors = held(Localizer(prior_map, config), drive, args.every)
        beside = distances_to_path(poses_of(drive)[:: args.every], prior_map.trajectory)
        inside, right = beside <= COVERAGE_RADIUS_M, errors <= FALSE_M
        found = f"{(inside & right).sum()} of {inside.sum()}"
        known, false = np.isfinite(errors).sum(), (errors > FALSE_M).sum()
        rows.append((mapped, driven, len(errors), found, int(known), int(false)))
    columns = ("map", "drive", "queries", "found within map coverage", "held", "of them false")
    publish(args.report, "The tracker on KITTI 00", Table(columns, rows))


if __name__ == "__main__":
    main()
