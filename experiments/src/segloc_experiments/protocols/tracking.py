"""The tracker on a real drive: keyframes one by one, with odometry, on the map and far beyond it.

The first half of KITTI 00 is mapped and the second driven; then short parts are mapped, and all the
rest is driven from where they end, along streets that go on as the mapped ones did. What is held
farther than 4 m from the truth is false.

    python benchmarks/tracking.py DATA
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from segloc import Config, Localizer, Scan, build_map
from segloc.batch.score import COVERAGE_RADIUS_M, distances_to_path
from segloc.datasets import Sequence, open_sequence
from segloc.tracker import Tracker

DRIVES = (
    ("100:947", "948:1820"),
    *((f"{a}:{a + 139}", f"{a + 170}:1820") for a in (100, 240, 380)),
)
FALSE_M = 4.0


def held(localizer: Localizer, drive: Sequence, step: int) -> np.ndarray:
    """For every ``step``-th scan: how far its tracked position is off, metres; NaN if unknown."""
    assert drive.poses is not None
    tracker = Tracker(localizer)
    errors = []
    for i in range(0, len(drive), step):
        T = drive.poses[i]
        track = tracker.update(Scan(drive.scan(i).points), T)
        off = np.full(3, np.nan)
        if track.T_map_odom is not None:
            off = (track.T_map_odom @ T)[:3, 3] - T[:3, 3]
        errors.append(float(np.linalg.norm(off)))
    return np.array(errors)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("data", type=Path)
    parser.add_argument("--method", default="profile")
    parser.add_argument("--every", type=int, default=3, help="scans between queries")
    args = parser.parse_args()
    config = Config.preset(args.method).model_copy(update={"threads": 1})
    folder, poses = args.data / "keyframes", "keyframes.tum"
    print(
        "| map | drive | queries | at a place | held | of them false |\n|---|---|---|---|---|---|"
    )
    for mapped, driven in DRIVES:
        prior_map = build_map(open_sequence(folder, poses, mapped), config)
        drive = open_sequence(folder, poses, driven)
        errors = held(Localizer(prior_map, config), drive, args.every)
        assert drive.poses is not None
        beside = distances_to_path(drive.poses[:: args.every], prior_map.trajectory)
        place, right = beside <= COVERAGE_RADIUS_M, errors <= FALSE_M
        cells = [
            mapped,
            driven,
            str(len(errors)),
            f"{(place & right).sum()} of {place.sum()}",
            str(np.isfinite(errors).sum()),
            str((errors > FALSE_M).sum()),
        ]
        print(f"| {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
