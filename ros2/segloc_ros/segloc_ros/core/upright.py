"""Level an odometry whose origin has the sensor's initial tilt, by an IMU."""

from __future__ import annotations

from collections import deque

import numpy as np

from segloc import geometry
from segloc.robot import GRAVITY_HALF_WINDOW_S as HALF_WINDOW_S
from segloc.robot import Float64, Pose, gravity_of

_MOST = 2048


class Upright:
    """Estimates the tilt of the odometry's frame from accelerations at rest.

    Attributes
    ----------
    T_level_odom : (4, 4) float64 or None
        Turns the odometry's z axis up; None until it is known.
    """

    def __init__(self) -> None:
        self.T_level_odom: Pose | None = None
        self._kept: deque[tuple[float, Float64]] = deque(maxlen=_MOST)

    def add(self, stamp: float, acceleration: Float64) -> None:
        """Add a reading (3,), m/s2 or g, in the frame of the IMU."""
        if self._kept and stamp < self._kept[-1][0]:
            self._kept.clear()
        self._kept.append((stamp, acceleration))
        while self._kept[0][0] < stamp - 2 * HALF_WINDOW_S:
            self._kept.popleft()

    def settle(self, T_odom_imu: Pose) -> bool:
        """Return whether the tilt is known, given the pose of the IMU by the odometry."""
        if self.T_level_odom is not None:
            return True
        if not self._kept or self._kept[-1][0] - self._kept[0][0] < HALF_WINDOW_S:
            return False
        gravity = gravity_of(np.stack([value for _, value in self._kept]))
        if gravity is None:
            return False
        self.T_level_odom = geometry.upright(-(T_odom_imu[:3, :3] @ gravity.direction))
        return True
