"""map -> odom at a bounded rate."""

from __future__ import annotations

import numpy as np
from segloc_ros.core.smooth import SmoothTransform

from segloc import geometry


def test_corrections_are_bounded_at_the_base_and_arrive() -> None:
    """Far from the odometry's origin, where a turn of map -> odom moves the base by metres."""
    smooth = SmoothTransform(max_mps=0.2, max_dps=2.0, jump_m=3.0)
    before = geometry.yaw_transform(0.3, (5.0, -2.0, 0.1))
    T_odom_base = geometry.yaw_transform(1.0, (400.0, 30.0, 0.0))
    correction = geometry.yaw_transform(0.05, (0.6, -0.8, 0.0))
    after = before @ T_odom_base @ correction @ geometry.inverse(T_odom_base)
    last = smooth.update(10.0, before, T_odom_base) @ T_odom_base
    for k in range(1, 100):
        remaining = smooth.offset(after, T_odom_base)
        T = smooth.update(10.0 + 0.1 * k, after, T_odom_base) @ T_odom_base
        step = geometry.inverse(last) @ T
        assert np.linalg.norm(step[:3, 3]) < 0.0201
        assert np.degrees(geometry.rotation_angle(step)) < 0.201
        assert np.linalg.norm(smooth.offset(after, T_odom_base)) <= np.linalg.norm(remaining)
        last = T
    assert np.allclose(smooth.T_map_odom, after)
    elsewhere = after @ geometry.yaw_transform(0.0, (20.0, 0.0, 0.0))
    assert np.array_equal(smooth.update(20.0, elsewhere, T_odom_base), elsewhere)
