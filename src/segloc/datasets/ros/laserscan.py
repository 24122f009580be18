"""ROS's sensor_msgs/LaserScan: one sweep of a scanner in the plane z = 0 of its frame."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ...errors import DatasetError
from ...types import Scan


class Sweep(Protocol):
    """sensor_msgs/LaserScan."""

    angle_min: float
    angle_increment: float
    time_increment: float
    range_min: float
    range_max: float
    ranges: NDArray[np.float32]


def to_scan(sweep: Sweep) -> Scan:
    """The points of a sweep, and their times after its stamp where it has them.

    Ranges outside the sensor's limits are no returns, as the message's definition has it.

    Raises
    ------
    DatasetError
        If its angles are not finite.
    """
    ranges = np.asarray(sweep.ranges, dtype=np.float64)
    steps = np.arange(len(ranges))
    angles = sweep.angle_min + steps * sweep.angle_increment
    if not np.isfinite(angles).all():
        raise DatasetError("the sweep's angles are not finite")
    with np.errstate(invalid="ignore"):
        hit = (ranges >= sweep.range_min) & (ranges <= sweep.range_max) & (ranges > 0)
    reach, angles = ranges[hit], angles[hit]
    points = np.column_stack([reach * np.cos(angles), reach * np.sin(angles), 0.0 * reach])
    step_s = float(sweep.time_increment)
    timed = np.isfinite(step_s) and step_s != 0
    return Scan(points, times=steps[hit] * step_s if timed else None)
