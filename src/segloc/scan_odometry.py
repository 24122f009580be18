"""LiDAR odometry by kiss-icp, scan by scan.

I. Vizzo et al., "KISS-ICP: In Defense of Point-to-Point ICP", RA-L 2023.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from . import geometry
from .errors import InvalidScan, requires
from .motion import times_fit
from .types import Float64, Pose, Scan

_MIN_POINTS = 50
_MAX_STEP_M = 20.0
_MAX_IN_A_ROW = 5
_LAST_STEP = 1e-3
"""Step of the registration [m, rad] below which it ends. KISS-ICP's own 1e-4 takes up to twice the
time, for the same drift."""
_POINTS_PER_VOXEL = 10
"""Points of the local map in a voxel. KISS-ICP's own 20 take a third more time, for the same drift.
"""
_RANGE_PER_VOXEL, _LEAST_VOXEL_M = 8.0, 0.25
"""Middle range of a scan, in voxels of the local map, and the smallest voxel. Measured 2026-11-28
by simulated scans of a VLP-16: in offices voxels of 0.25 m drift a quarter as much as those of 1 m;
in a town those of 0.5 m take 3.5 times as long, for the same drift."""
_ANOTHER, _SCANS_ELSEWHERE = 2.0, 10
"""Factor by which the voxel of a place differs from the map's, in so many scans in a row, before a
map with other voxels is begun."""
_SAMPLED = 2000
"""Points by which the range of a scan is judged."""


class ScanOdometry:
    """KISS-ICP, scan by scan, on one thread: the same scans give the same poses.

    The voxels of its map follow the ranges of the scans: a robot may drive out of a building.

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
        self._max_range_m, self._voxel_m = max_range_m, max_range_m / 100.0
        self._registration = _kiss_icp(max_range_m, self._voxel_m)
        self._T_first_begun: Pose = np.eye(4)  # where the map was begun
        self._last = np.empty((0, 3)), np.empty(0)  # points and times of the last scan
        self._poses: list[Pose] = []  # the last three
        self._idle = self._elsewhere = 0

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
        points = scan.points.astype(np.float64)
        self._fit_voxels(points)
        self._registration.register_frame(points, times)
        pose = self._T_first_begun @ np.array(self._registration.last_pose, dtype=np.float64)
        self._last = points, times
        if fault := self._fault(pose):
            raise InvalidScan(f"odometry is lost: {fault}")
        self._poses = [*self._poses[-2:], pose]
        return pose, last

    def _fit_voxels(self, points: Float64) -> None:
        """Begin another map, with the last scan, where voxels are much too large or too small."""
        ranges = np.linalg.norm(points[:: -(-len(points) // _SAMPLED)], axis=1)
        fits_m = float(np.median(ranges)) / _RANGE_PER_VOXEL
        fits_m = min(max(fits_m, _LEAST_VOXEL_M), self._max_range_m / 100.0)
        apart = max(fits_m / self._voxel_m, self._voxel_m / fits_m)
        if not self._poses:
            self._registration = _kiss_icp(self._max_range_m, fits_m)
            self._voxel_m = fits_m
            return
        self._elsewhere = self._elsewhere + 1 if apart >= _ANOTHER else 0
        if self._elsewhere < _SCANS_ELSEWHERE:
            return
        self._elsewhere, self._voxel_m, self._T_first_begun = 0, fits_m, self._poses[-1]
        begun = _kiss_icp(self._max_range_m, fits_m)
        begun.register_frame(*self._last)
        begun.last_delta = self._registration.last_delta
        self._registration = begun

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
        begun = self._T_first_begun
        if np.array_equal(pose, begun) and np.linalg.norm(last[:3, 3] - begun[:3, 3]) > 0.1:
            return "pose returned to the origin"
        if len(self._poses) < 3 or step < 1e-3:
            return ""
        # Without correspondences kiss-icp returns the predicted pose: the last step again.
        before = self._poses[-2]
        predicted = last @ np.linalg.inv(before) @ last
        self._idle = self._idle + 1 if np.abs(predicted - pose).max() < 1e-9 else 0
        return "consecutive scans do not match" if self._idle >= _MAX_IN_A_ROW else ""


def _kiss_icp(max_range_m: float, voxel_m: float) -> Any:
    with requires("kiss-icp", "odometry", "LiDAR odometry"):
        from kiss_icp.config.parser import load_config
        from kiss_icp.kiss_icp import KissICP
    config = load_config(None)
    config.data.max_range = max_range_m
    config.mapping.voxel_size = voxel_m
    config.mapping.max_points_per_voxel = _POINTS_PER_VOXEL
    config.registration.max_num_threads = 1
    config.registration.convergence_criterion = _LAST_STEP
    return KissICP(config)
