"""LiDAR odometry by kiss-icp, for recordings without poses.

I. Vizzo et al., "KISS-ICP: In Defense of Point-to-Point ICP", RA-L 2023.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from .. import geometry
from ..errors import DatasetError, InvalidScan, MissingDependency
from ..io.pose_files import read_trajectory
from ..io.trajectory import Trajectory, write_tum
from ..motion import times_fit
from ..types import Pose, Scan
from .recorded import RecordedSequence

_MIN_POINTS = 50
_MAX_STEP_M = 20.0
_MAX_IN_A_ROW = 5
_LAST_STEP = 1e-3
"""Step of the registration [m, rad] below which it ends. KISS-ICP's own 1e-4 takes up to twice the
time, for the same drift."""


def lidar_odometry(
    recording: RecordedSequence,
    *,
    max_range_m: float = 100.0,
    progress: Callable[[int, int], None] | None = None,
) -> Trajectory:
    """Estimate the sensor's poses from its scans; the frame is that of the first scan.

    Runs on one thread, so that results repeat. Points with times are de-skewed to the end of their
    scan; the pose and its stamp then hold at that moment.

    Parameters
    ----------
    recording : RecordedSequence
        Any sequence that :func:`~segloc.datasets.open_sequence` opens.
    max_range_m : float
        Range beyond which points are ignored [m].
    progress : callable, optional
        Called with (scans done, total).

    Returns
    -------
    Trajectory
        Stamped in seconds, or by scan number if the recording has no stamps.

    Raises
    ------
    DatasetError
        If a scan cannot be read, is empty or lies in one plane, or the odometry is lost: a pose is
        not finite, jumps, or returns to the origin, or several scans in a row are not registered.
    MissingDependency
        If kiss-icp is not installed.
    """
    odometry = ScanOdometry(max_range_m)
    timed = recording.stamps is not None and bool((recording.stamps % 1).any())
    clock = recording.stamps if timed else None
    keys, poses = [], []
    for i in range(len(recording)):
        scan = recording.raw(i)
        if clock is None:
            scan.times = None
        try:
            pose, after_s = odometry.add(scan)
        except InvalidScan as error:
            raise DatasetError(f"{recording.where(i)}: {error}") from error
        keys.append(float(recording.indices[i]) if clock is None else float(clock[i]) + after_s)
        poses.append(pose)
        if progress:
            progress(i + 1, len(recording))
    return Trajectory(np.array(keys), np.array(poses))


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


def odometry_path(path: Path, topic: str | None = None) -> Path:
    """Return the file of stored odometry, beside the recording at ``path``."""
    place = path.resolve()
    part = f".{topic.strip('/').replace('/', '_')}" if topic else ""
    return place.parent / f"{place.name}{part}.odometry.tum"


def kept_odometry(file: Path, recording: RecordedSequence) -> bool:
    """Return whether a file holds odometry of these scans: same number, same times."""
    if not file.is_file():
        return False
    try:
        stamps = read_trajectory(file).stamps
    except DatasetError:
        return False
    wanted = recording.stamps
    if wanted is None or not (wanted % 1).any():
        wanted = recording.indices.astype(np.float64)
    return len(stamps) == len(wanted) and bool(np.abs(stamps - wanted).max() <= 1.0)


def compute_odometry(
    recording: RecordedSequence, file: Path, progress: Callable[[int, int], None] | None = None
) -> Trajectory:
    """Run :func:`lidar_odometry` and write its poses to a TUM file.

    Raise DatasetError early if the file's folder is not writable, and as the odometry does.
    """
    if not os.access(file.parent, os.W_OK):
        raise DatasetError(f"{file}: folder not writable: choose another file with --out")
    trajectory = lidar_odometry(recording, progress=progress)
    write_tum(file, trajectory)
    return trajectory
