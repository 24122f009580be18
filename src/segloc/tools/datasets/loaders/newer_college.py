"""Newer College (2020): ``raw_format/ouster_scan`` and ``ground_truth/registered_poses.csv``.

Format: ori-drs.github.io/newer-college-dataset; M. Ramezani et al., "The Newer College Dataset:
Handheld LiDAR, Inertial and Vision with Ground Truth", IROS 2020. Its bags are read as bags.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from ....types import Float64, Pose, Scan
from ...io.pcd import parse_pcd
from ...io.pose_files import header_of
from ..layout import column_times, drop_missing_returns
from ..recorded import FileSource, Found
from ..tracks import Track, clean_track, quaternion_poses, read_table

NAME = "Newer College"
INNER = ("raw_format/ouster_scan", "ouster_scan")
_SCAN = re.compile(r"cloud_(\d{1,12})_(\d{1,9})\.pcd", re.ASCII)
_TRUTHS = ("ground_truth/registered_poses.csv", "registered_poses.csv")


def recognises(path: Path) -> bool:
    return any(_holds_clouds(path / inner) for inner in INNER)


def _holds_clouds(folder: Path) -> bool:
    return folder.is_dir() and any(_SCAN.fullmatch(file.name) for file in folder.glob("*.pcd"))


def find(path: Path, topic: str | None) -> Found:
    folder = next(path / inner for inner in INNER if _holds_clouds(path / inner))
    scans = sorted(
        (int(match[1]) + 1e-9 * int(match[2]), file)
        for file in folder.iterdir()
        if (match := _SCAN.fullmatch(file.name))
    )
    truth = next((name for name in _TRUTHS if (path / name).is_file()), None)
    return Found(
        name=path.resolve().name,
        format=NAME,
        source=FileSource(tuple(file for _, file in scans), parse),
        indices=np.arange(len(scans)),
        stamps=np.array([stamp for stamp, _ in scans]),
        own_track=lambda: _track(path / truth, truth) if truth else None,
        frame="os1_lidar",
        fields="x y z, times by column",
        own_poses=lambda file: (
            _track(file, str(file)) if file.suffix == ".csv" and _is_own(file) else None
        ),
    )


def parse(data: bytes) -> Scan:
    """Parse a cloud of an OS1-64, stored column by column."""
    scan = parse_pcd(data)
    times = scan.times
    if times is None:
        times = column_times(len(scan) + scan.dropped + scan.missing_returns)
        if times is not None and scan.kept is not None:
            times = times[scan.kept]
    kept = drop_missing_returns(scan.points, times)
    kept.dropped, kept.blank = scan.dropped, scan.blank
    kept.missing_returns = scan.missing_returns
    return kept


def _is_own(path: Path) -> bool:
    """Return whether a table has the set's own columns: sec, nsec, position, quaternion."""
    header = header_of(path).strip("# ")
    return not header or header.startswith("sec")


def _track(path: Path, name: str) -> Track:
    rows = read_table(path, range(9))
    poses = quaternion_poses(rows[:, 2:5], rows[:, 5:9], str(path)) @ _mount()
    return clean_track(name, rows[:, 0] + 1e-9 * rows[:, 1], poses)


def _mount() -> Pose:
    """T_base_lidar."""
    xyz: Float64 = np.array([[-0.084, -0.025, 0.050]])
    poses = quaternion_poses(xyz, np.array([[0.0, 0.0, 0.924, 0.383]]), NAME)
    return np.asarray(poses[0], dtype=np.float64)
