"""LiDAR odometry by kiss-icp, scan by scan.

I. Vizzo et al., "KISS-ICP: In Defense of Point-to-Point ICP", RA-L 2023.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from . import geometry
from .errors import InvalidScan, MissingDependency
from .motion import times_fit
from .types import Pose, Scan

_MIN_POINTS = 50
_MAX_STEP_M = 20.0
_MAX_IN_A_ROW = 5
_LAST_STEP = 1e-3
"""Step of the registration [m, rad] below which it ends. KISS-ICP's own 1e-4 takes up to twice the
time, for the same drift."""


class ScanOdometry:
    """KISS-ICP, scan by scan, on one thread: the same scans give the same poses.

    Parameters
    ----------
    max_range_m : float
        Points farther away are not used.

    Raises
    ------
    MissingDependency
        If kiss-icp is not installed.
    """

    def __init__(self, max_range_m: float = 100.0) -> None:
        self._registration = _kiss_icp(max_range_m)
        self._poses: list[Pose] = []  # the last three
        self._idle = 0

    def add(self, scan: Scan) -> tuple[Pose, float]:
        """Register a scan; points with times are de-skewed.

        Returns
        -------
        pose : (4, 4) float64
            Of the sensor, in the frame of the first scan.
        after_s : float
            When it holds, seconds after the scan's stamp: at the end of a scan with times.

        Raises
        ------
        InvalidScan
            If the scan is empty or the first one of a single plane, or the odometry is lost: a
            pose is not finite, or jumps, or falls back to where it began, or several scans in a
            row were not registered.
        """
        if not self._poses and len(scan) and geometry.in_one_plane(scan.points):
            raise InvalidScan("odometry needs 3D, not one plane")
        if len(scan) < _MIN_POINTS:
            raise InvalidScan(f"only {len(scan)} points: odometry is lost")
        times, last = np.empty(0), 0.0
        if scan.times is not None and times_fit(scan):
            last = float(scan.times.max())
            # Of times that are all equal KISS-ICP divides by zero, and ends the process.
            times = scan.times if scan.times.min() < last else times
        self._registration.register_frame(scan.points.astype(np.float64), times)
        pose = np.array(self._registration.last_pose, dtype=np.float64)
        if fault := self._fault(pose):
            raise InvalidScan(f"odometry is lost: {fault}")
        self._poses = [*self._poses[-2:], pose]
        return pose, last

    def _fault(self, pose: Pose) -> str:
        """KISS-ICP reports a loss by odd poses, never by an error."""
        if not np.isfinite(pose).all():
            return "pose not finite"
        if not self._poses:
            return ""
        last = self._poses[-1]
        step = float(np.linalg.norm(pose[:3, 3] - last[:3, 3]))
        if step > _MAX_STEP_M:
            return f"a step of {step:.1f} m (at most {_MAX_STEP_M:.0f} m)"
        if np.array_equal(pose, np.eye(4)) and np.linalg.norm(last[:3, 3]) > 0.1:
            return "pose returned to the origin"
        if len(self._poses) < 3 or step < 1e-3:
            return ""
        # Without correspondences kiss-icp returns the predicted pose: the last step again.
        before = self._poses[-2]
        predicted = last @ np.linalg.inv(before) @ last
        self._idle = self._idle + 1 if np.abs(predicted - pose).max() < 1e-9 else 0
        return "consecutive scans do not match" if self._idle >= _MAX_IN_A_ROW else ""


def _kiss_icp(max_range_m: float) -> Any:
    try:
        from kiss_icp.config.parser import load_config
        from kiss_icp.kiss_icp import KissICP
    except ImportError as error:
        raise MissingDependency("kiss-icp", "odometry", "LiDAR odometry") from error
    config = load_config(None)
    config.data.max_range = max_range_m
    config.mapping.voxel_size = max_range_m / 100.0
    config.registration.max_num_threads = 1
    config.registration.convergence_criterion = _LAST_STEP
    return KissICP(config)
