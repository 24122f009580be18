"""What is told of a robot at one moment."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..tracking.views import Status
from ..types import Float64, Pose


@dataclass(frozen=True)
class State:
    """Where the robot is, and how well that is known.

    Attributes
    ----------
    stamp : float
        Of the newest scan or, between scans, of the newest odometry; seconds.
    status : Status
        ``lost``, ``candidate``, ``localized`` or ``degraded``.
    T_map_odom : (4, 4) float64 or None
        Takes poses of the odometry to the map; None while lost or candidate. Read-only.
    T_odom_base : (4, 4) float64 or None
        Where the base was at ``stamp``, by the odometry. Read-only.
    covariance : (6, 6) float64 or None
        Of ``T_map_base``: of a small rotation (rad) and then a translation (m), both in the base's
        frame. :func:`segloc.ros_covariance` gives ROS's. Read-only.
    confidence : float
        In [0, 1]: of the views that agree, taken as independent; not calibrated.
    views : int
        Independent views that agree.
    reason : str
        Why it is no better known; "" when localized.
    travelled_m : float
        By the odometry, since the beginning.
    answered : float or None
        Stamp of the scan whose query this answers; None where it answers none.
    latency_ms : float or None
        From when that scan, or else the newest, came in until this was said. None where no clock
        ran.
    """

    stamp: float
    status: Status
    T_map_odom: Pose | None = None
    T_odom_base: Pose | None = None
    covariance: Float64 | None = None
    confidence: float = 0.0
    views: int = 0
    reason: str = ""
    travelled_m: float = 0.0
    answered: float | None = None
    latency_ms: float | None = None

    def __post_init__(self) -> None:
        for array in (self.T_map_odom, self.T_odom_base, self.covariance):
            if array is not None:
                array.setflags(write=False)

    @property
    def localized(self) -> bool:
        """Whether a pose is believed: localized or degraded."""
        return self.T_map_odom is not None

    @property
    def T_map_base(self) -> Pose | None:
        """Where the base is in the map, (4, 4) float64."""
        if self.T_map_odom is None or self.T_odom_base is None:
            return None
        return self.T_map_odom @ self.T_odom_base

    def record(self) -> Mapping[str, Any]:
        """In values that JSON can hold."""
        return {
            "stamp": self.stamp,
            "state": self.status.value,
            "reason": self.reason,
            "T_map_odom": _nested(self.T_map_odom),
            "T_map_base": _nested(self.T_map_base),
            "covariance": _nested(self.covariance),
            "confidence": self.confidence,
            "views": self.views,
            "travelled_m": self.travelled_m,
            "answered": self.answered,
            "latency_ms": self.latency_ms,
        }


def _nested(array: Float64 | None) -> list[list[float]] | None:
    return None if array is None else np.asarray(array).tolist()
