"""Which way is up in the odometry's frame, by an IMU: for odometries that begin as they stand."""

from __future__ import annotations

from collections import deque

import numpy as np

from segloc import geometry
from segloc.datasets.gravity import HALF_WINDOW_S, gravity_of
from segloc.types import Float64, Pose

_MOST = 2048


class Upright:
    """Gathers accelerations at rest until they tell how the odometry's frame stands.

    Attributes
    ----------
    T_level_odom : (4, 4) float64 or None
        Turns the odometry's z axis up; None until it is known.
    """

    def __init__(self) -> None:
        self.T_level_odom: Pose | None = None
        self._kept: deque[tuple[float, Float64]] = deque(maxlen=_MOST)

    def add(self, stamp: float, acceleration: Float64) -> None:
        """An accelerometer's (3,) reading, m/s2 or g, in the frame of the IMU."""
        if self._kept and stamp < self._kept[-1][0]:
            self._kept.clear()
        self._kept.append((stamp, acceleration))
        while self._kept[0][0] < stamp - 2 * HALF_WINDOW_S:
            self._kept.popleft()

    def settle(self, T_odom_imu: Pose) -> bool:
        """Whether it is known by now, where the IMU stands so in the odometry's frame."""
        if self.T_level_odom is not None:
            return True
        if not self._kept or self._kept[-1][0] - self._kept[0][0] < HALF_WINDOW_S:
            return False
        gravity = gravity_of(np.stack([value for _, value in self._kept]))
        if gravity is None:
            return False
        self.T_level_odom = geometry.upright(-(T_odom_imu[:3, :3] @ gravity.direction))
        return True
