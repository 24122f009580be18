"""A transform that follows corrections at a bounded rate."""

from __future__ import annotations

import math

import numpy as np

from segloc import geometry
from segloc.robot import Float64, Pose


class SmoothTransform:
    """T_map_odom without jumps: the base moves towards its estimated pose at a bounded rate.

    Parameters
    ----------
    max_mps, max_dps : float
        Largest rates of the correction at the base [m/s] and [deg/s].
    jump_m : float
        A larger correction is applied at once: the robot is somewhere else [m].

    Attributes
    ----------
    T_map_odom : (4, 4) float64 or None
        The transform at the last update; None before the first.
    """

    def __init__(self, max_mps: float, max_dps: float, jump_m: float) -> None:
        self._max_mps, self._max_rps = max_mps, math.radians(max_dps)
        self._jump_m = jump_m
        self.T_map_odom: Pose | None = None
        self._stamp = -math.inf

    def clear(self) -> None:
        """Apply the next correction at once."""
        self.T_map_odom = None

    def update(self, stamp: float, T_map_odom: Pose, T_odom_base: Pose) -> Pose:
        """Move towards an estimate (4, 4), as far as the time since the last update allows."""
        seconds = max(0.0, stamp - self._stamp)
        self._stamp = stamp
        offset = None if self.T_map_odom is None else self.offset(T_map_odom, T_odom_base)
        if self.T_map_odom is None or offset is None or _metres(offset) > self._jump_m:
            self.T_map_odom = T_map_odom
            return T_map_odom
        share = min(
            1.0,
            self._max_mps * seconds / max(_metres(offset), 1e-9),
            self._max_rps * seconds / max(float(np.linalg.norm(offset[:3])), 1e-9),
        )
        if share < 1.0:
            T = geometry.displace(self.T_map_odom @ T_odom_base, share * offset)
            T_map_odom = geometry.orthonormal(T @ geometry.inverse(T_odom_base))
        self.T_map_odom = T_map_odom
        return T_map_odom

    def offset(self, T_map_odom: Pose, T_odom_base: Pose) -> Float64:
        """Remaining correction, (6,): rotation [rad] and translation [m] in the base's frame."""
        if self.T_map_odom is None:
            return np.zeros(6)
        return geometry.displacement(self.T_map_odom @ T_odom_base, T_map_odom @ T_odom_base)


def _metres(offset: Float64) -> float:
    return float(np.linalg.norm(offset[3:]))
