"""Scans of several LiDARs merged."""

from __future__ import annotations

import numpy as np
from segloc_ros.core.merge import MountedScan, ScanMerger

from segloc import Scan, geometry
from segloc.motion import Motion, at_stamp

FRONT = geometry.yaw_transform(0.5, (1.0, 0.0, 0.5))
REAR = geometry.yaw_transform(-2.6, (-1.0, 0.2, 0.4))


def seen(T_world_base: np.ndarray, mount: np.ndarray, points: np.ndarray) -> np.ndarray:
    return geometry.transform(geometry.inverse(T_world_base @ mount), points)


def test_merged_points_lie_where_they_are_while_the_base_moves() -> None:
    """At 10 m/s: what is merged and de-skewed by the motion is the world from one place."""
    rng = np.random.default_rng(0)
    world = rng.uniform(-20.0, 20.0, (500, 3))
    stamps = np.arange(5) * 0.1
    poses = np.stack([geometry.yaw_transform(s, (10.0 * s, 0.0, 0.0)) for s in stamps])
    motion = Motion(stamps, poses)
    merger = ScanMerger("front", ["rear"])
    assert merger.add("front", MountedScan(0.2, Scan(seen(poses[2], FRONT, world)), FRONT)) == []
    (T,) = motion.at([0.24])
    rear = MountedScan(0.24, Scan(seen(T, REAR, world), times=np.zeros(500)), REAR)
    (merged,) = merger.add("rear", rear)
    assert merged.stamp == 0.2 and merger.missing == () and len(merged.scan) == 1000
    sensor = Motion(stamps, poses @ FRONT)
    still = at_stamp(merged.scan, sensor, merged.stamp)
    found = geometry.transform(poses[2] @ FRONT, still.points)
    assert np.abs(found - np.vstack([world, world])).max() < 5e-3


def test_a_silent_lidar_is_not_waited_for() -> None:
    merger, scan = ScanMerger("front", ["rear"], wait_s=0.25), Scan(np.ones((9, 3)))
    told = [merger.add("front", MountedScan(0.1 * k, scan, FRONT)) for k in range(8)]
    assert [len(merged) for merged in told] == [0, 0, 0, 1, 1, 1, 1, 1]
    assert told[3][0].scan is scan and merger.missing == ("rear",)
    assert merger.add("front", MountedScan(-50.0, scan, FRONT)) == []  # the clock was set back


def test_a_lidar_on_another_clock_is_not_waited_for() -> None:
    merger, scan, told = ScanMerger("front", ["rear"], wait_s=0.25), Scan(np.ones((9, 3))), 0
    for k in range(8):
        told += len(merger.add("front", MountedScan(100.0 + 0.1 * k, scan, FRONT)))
        told += len(merger.add("rear", MountedScan(0.1 * k, scan, REAR)))
    assert told >= 5 and merger.missing == ("rear",)
