"""LiDAR odometry for recordings without poses."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import numpy as np

from ...errors import DatasetError, InvalidScan
from ...scan_odometry import ScanOdometry
from ...types import Float64, Scan
from ..io.pose_files import read_trajectory
from ..io.trajectory import Trajectory, write_tum
from .clocks import epoch_unit
from .recorded import FileSource, RecordedSequence

_CAPTURES = (".bag", ".db3", ".mcap", ".pcap")
"""Suffixes of files that hold many scans."""


def lidar_odometry(
    recording: RecordedSequence,
    part: Callable[[Scan], Scan] = lambda scan: scan,
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
        Any sequence that :func:`~segloc.tools.datasets.open_sequence` opens.
    part : callable, optional
        Returns the part of a scan that is used, as :meth:`LocalCloudConfig.without_body`; by
        default all of it.
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
    clock = _clock(recording)
    keys, poses = [], []
    for i in range(len(recording)):
        scan = part(recording.raw(i))
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


def odometry_path(path: Path, topic: str | None = None) -> Path:
    """Return the file of stored odometry, beside the recording at ``path``."""
    place = path.resolve() if path.name in ("", "..") else path.absolute()  # links are kept
    part = f".{topic.strip('/').replace('/', '_')}" if topic else ""
    return place.parent / f"{place.name}{part}.odometry.tum"


def _clock(recording: RecordedSequence) -> Float64 | None:
    """Return the stamps of the scans; None without any, or if files would take them for numbers."""
    stamps = recording.stamps
    if stamps is None or not (epoch_unit(stamps) or (stamps % 1).any()):
        return None
    return stamps


def kept_odometry(file: Path, recording: RecordedSequence, path: Path) -> bool:
    """Return whether a file holds odometry of these scans: same number, same times, not older."""
    if not file.is_file():
        return False
    source, inside = recording.source, path.iterdir() if path.is_dir() else (path,)
    bags = (each for each in inside if each.suffix in _CAPTURES and each.is_file())
    scans = source.paths if isinstance(source, FileSource) else bags
    if max((scan.stat().st_mtime for scan in scans), default=0.0) > file.stat().st_mtime:
        return False
    try:
        stamps = read_trajectory(file).stamps
    except DatasetError:
        return False
    clock = _clock(recording)
    wanted = recording.indices.astype(np.float64) if clock is None else clock
    return len(stamps) == len(wanted) and bool(np.abs(stamps - wanted).max() <= 1.0)


def compute_odometry(
    recording: RecordedSequence,
    file: Path,
    part: Callable[[Scan], Scan],
    progress: Callable[[int, int], None],
) -> Trajectory:
    """Run :func:`lidar_odometry` and write its poses to a TUM file.

    Raise DatasetError early if the file's folder is not writable, and as the odometry does.
    """
    if not os.access(file.parent, os.W_OK):
        raise DatasetError(
            f"{file}: folder not writable: run `segloc odometry {recording.name} --out FILE.tum`, "
            "and pass --poses FILE.tum"
        )
    trajectory = lidar_odometry(recording, part, progress=progress)
    write_tum(file, trajectory)
    return trajectory
