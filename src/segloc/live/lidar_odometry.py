"""Odometry of a base from the scans of its LiDAR alone."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from .. import _native, geometry
from ..errors import InvalidScan
from ..frontend.gravity import AttitudeConfig, AttitudeEstimator
from ..motion import times_fit
from ..scan_odometry import ScanOdometry
from ..system.checks import checked_pose
from ..types import Float32, Pose, Scan

_MAX_GAP_S = 2.0
"""After a longer gap between scans the motion is unknown."""
_NEAR_M, _REACH_M = 0.4, 35.0
"""Distance of a point from the scan before at which they match, and range of the points."""
_MATCHED, _UNRELATED = 0.5, 0.2
"""Share of points that match, and agreement (0 by chance, 1 if all do), from which scans belong
together. Of scans 2 m apart in seven simulated worlds 1 % match by less than 0.67, and agree by
less than 0.44; those of a robot that was carried away by 0.45 and 0.12 in the middle."""
_ASIDE = np.array([(4.0, 0.0, 0.0), (-4.0, 0.0, 0.0), (0.0, 4.0, 0.0), (0.0, -4.0, 0.0)])
_AROUND, _COMPARED, _FEW = 10_000, 400, 1_000
"""Points of the scan before, and of the one that is compared with it; of fewer, points of one
surface lie farther apart than such that match."""


class LidarOdometry:
    """KISS-ICP for a base, in a level frame; it restarts where it was lost.

    The frame has its origin and heading at the first pose of the base. Its z axis points up as
    the floors and walls of the first scan show, or else as the base stands.

    Parameters
    ----------
    T_base_sensor : (4, 4) array, optional
        How the sensor is mounted; by default the sensor is the base.
    attitude : AttitudeConfig, optional
    max_range_m : float
        Points farther away are not used.

    Attributes
    ----------
    losses : int
        How often odometry was lost.
    fault : str
        Why it was lost the last time.

    Raises
    ------
    MissingDependency
        If kiss-icp is not installed.
    """

    def __init__(
        self,
        T_base_sensor: ArrayLike | None = None,
        attitude: AttitudeConfig | None = None,
        max_range_m: float = 100.0,
    ) -> None:
        given = np.eye(4) if T_base_sensor is None else T_base_sensor
        self.T_base_sensor = checked_pose(given, "T_base_sensor")
        self._attitudes = AttitudeEstimator(attitude)
        self._max_range_m = max_range_m
        self._odometry = ScanOdometry(max_range_m)
        self._T_odom_first: Pose | None = None  # pose of the sensor at the first registered scan
        self._T_odom_sensor: Pose | None = None
        self._before: tuple[Scan, Pose] | None = None
        self._stamp = -math.inf
        self.losses, self.fault = 0, ""

    def add(self, scan: Scan, stamp: float) -> list[tuple[float, Pose]]:
        """Register a scan; return stamps [s] and poses T_odom_base (4, 4) that are now known.

        Where odometry is lost, or the scan does not match the one before, it restarts with the
        scan, at the last pose: ``losses`` grows.
        """
        gap_s = stamp - self._stamp
        if self._T_odom_sensor is not None and not 0.0 < gap_s <= _MAX_GAP_S:
            self._restart(f"no scans for {gap_s:.1f} s" if gap_s > 0 else "the clock was set back")
        try:
            T, after_s = self._odometry.add(scan)
            if self._before is not None and not _match(scan, T, *self._before):
                raise InvalidScan("odometry is lost: consecutive scans do not match")
        except InvalidScan as error:
            self._restart(str(error))
            try:
                T, after_s = self._odometry.add(scan)
            except InvalidScan:  # of no use for a beginning either
                self._odometry = ScanOdometry(self._max_range_m)
                return []
        self._stamp, self._before = stamp, (scan, T)
        begin: list[tuple[float, Pose]] = []
        if self._T_odom_first is None:
            self._T_odom_first = self._first_pose(scan) @ geometry.inverse(T)
            if scan.times is not None and times_fit(scan) and scan.times.min() < after_s:
                begin = [(stamp + min(0.0, float(scan.times.min())), self._T_odom_first @ T)]
        self._T_odom_sensor = self._T_odom_first @ T
        poses = [*begin, (stamp + after_s, self._T_odom_sensor)]
        T_sensor_base = geometry.inverse(self.T_base_sensor)
        return [(time, geometry.orthonormal(T_odom @ T_sensor_base)) for time, T_odom in poses]

    def _restart(self, why: str) -> None:
        self._odometry = ScanOdometry(self._max_range_m)
        self._T_odom_first = self._before = None
        if self._T_odom_sensor is not None:
            self.losses, self.fault = self.losses + 1, why

    def _first_pose(self, scan: Scan) -> Pose:
        """T_odom_sensor of the first scan after a start."""
        if self._T_odom_sensor is not None:
            return self._T_odom_sensor
        level = self.T_base_sensor[2, :3]
        found = self._attitudes.estimate(scan.points, level)
        T_level_sensor = geometry.upright(level if found is None else found.up)
        T_level_base = T_level_sensor @ geometry.inverse(self.T_base_sensor)
        return geometry.inverse(geometry.levelled(T_level_base)) @ T_level_sensor


def _match(scan: Scan, T_odom_scan: Pose, before: Scan, T_odom_before: Pose) -> bool:
    """Return whether a scan matches the one before; KISS-ICP does not tell."""
    around, points = _some(before, _AROUND), _some(scan, _COMPARED)
    if len(around) < _FEW:
        return True
    index, T = _native.PointIndex(around, _NEAR_M), geometry.inverse(T_odom_before) @ T_odom_scan
    share = float(index.overlap(points, T[None], _NEAR_M)[0])
    if share >= _MATCHED:
        return True
    aside = [geometry.rigid(T[:3, :3], T[:3, 3] + step) for step in _ASIDE]
    chance = float(index.overlap(points, np.stack(aside), _NEAR_M).mean())
    return share - chance >= _UNRELATED * (1.0 - chance)


def _some(scan: Scan, count: int) -> Float32:
    """Return some of the points within reach."""
    near = scan.points[np.linalg.norm(scan.points, axis=1) < _REACH_M]
    return np.ascontiguousarray(near[:: 1 + len(near) // count], np.float32)
