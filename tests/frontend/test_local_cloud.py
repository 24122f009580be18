"""What of the scans belongs to a local cloud."""

from __future__ import annotations

import numpy as np
import pytest

from segloc import Scan, geometry
from segloc.frontend.local_cloud import Accumulator, LocalCloudConfig
from segloc.types import Float32, Pose


def cropped(points: Float32, T: Pose, radius: float) -> Float32:
    """Reference: points through T, of those the ones near the z axis."""
    moved = geometry.transform(T, points)
    near = (np.hypot(moved[:, 0], moved[:, 1]) < radius) & (np.abs(moved[:, 2]) < radius)
    return moved[near].astype(np.float32)


@pytest.mark.parametrize("count", [0, 1, 5000])
def test_points_near_the_sensor_in_the_local_frame(count: int) -> None:
    rng = np.random.default_rng(count)
    accumulator = Accumulator(LocalCloudConfig(radius_m=20.0))
    scans = [
        Scan(rng.normal(0, 15, (count, 3)), T_odom_sensor=geometry.yaw_transform(*place))
        for place in ((0.3, (1.0, 2.0, 0.5)), (-2.0, (4.0, -3.0, 1.0)))
    ]
    cloud = accumulator.gather(scans)
    T_local_odom = geometry.inverse(geometry.levelled(scans[-1].T_odom_sensor))
    expected = [cropped(s.points, T_local_odom @ s.T_odom_sensor, 20.0) for s in scans]
    assert np.array_equal(cloud.points, np.concatenate(expected))
    assert cloud.points.dtype == np.float32
