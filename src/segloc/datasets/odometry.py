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
from ..errors import DatasetError, MissingDependency
from ..io.trajectory import Trajectory, read_trajectory, write_tum
from ..motion import times_fit
from ..types import Float64
from .recorded import RecordedSequence

_MIN_POINTS = 50
_MAX_STEP_M = 20.0
_MAX_IN_A_ROW = 5


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
    odometry = _kiss_icp(max_range_m)
    timed = recording.stamps is not None and bool((recording.stamps % 1).any())
    clock = recording.stamps if timed else None
    keys, poses = [], []
    guard = _Guard()
    for i in range(len(recording)):
        scan = recording.raw(i)
        if i == 0 and len(scan) and geometry.in_one_plane(scan.points):
            raise DatasetError(f"{recording.where(i)}: odometry needs 3D scans, not one plane")
        if len(scan) < _MIN_POINTS:
            raise DatasetError(f"{recording.where(i)}: odometry lost: only {len(scan)} points")
        times, last = np.empty(0), 0.0
        if clock is not None and scan.times is not None and times_fit(scan):
            times, last = scan.times, float(scan.times.max())
        odometry.register_frame(scan.points.astype(np.float64), times)
        pose = np.array(odometry.last_pose, dtype=np.float64)
        guard.check(pose, recording.where(i))
        keys.append(float(recording.indices[i]) if clock is None else float(clock[i]) + last)
        poses.append(pose)
        if progress:
            progress(i + 1, len(recording))
    return Trajectory(np.array(keys), np.array(poses))


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
    return KissICP(config)


class _Guard:
    """Detect lost odometry, which kiss-icp never reports, by implausible poses."""

    def __init__(self) -> None:
        self._poses: list[Float64] = []
        self._idle = 0

    def check(self, pose: Float64, where: str) -> None:
        fault = self._fault(pose)
        if fault:
            raise DatasetError(f"{where}: odometry lost: {fault}")
        self._poses = [*self._poses[-2:], pose]

    def _fault(self, pose: Float64) -> str:
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
