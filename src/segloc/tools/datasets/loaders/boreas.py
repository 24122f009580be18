"""Boreas: a sequence's folder with ``lidar`` and ``applanix/lidar_poses.csv``.

Format: DATA_REFERENCE.md of github.com/utiasASRL/pyboreas; K. Burnett et al., "Boreas: A
multi-season autonomous driving dataset", IJRR 2023. A scan's stamp is the middle of its turn, and
point times count from there. Euler angles rotate the world into the sensor: the transpose of the
usual convention.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from ....errors import DatasetError
from ....types import Scan
from ...io.pose_files import header_of
from ...io.trajectory import rigid_poses
from ..layout import float_rows, holds_scans, in_seconds, scan_files
from ..recorded import FileSource, Found
from ..tracks import Track, clean_track, read_table

NAME = "Boreas"
INNER = ("lidar",)
_COLUMNS = (0, 1, 2, 3, 7, 8, 9)  # microseconds, x, y, z, roll, pitch, yaw


def recognises(path: Path) -> bool:
    beside = any((path / name).is_dir() for name in ("applanix", "calib"))
    return beside and holds_scans(path / "lidar", 15)


def find(path: Path, topic: str | None) -> Found:
    files = scan_files(path / "lidar")
    truth = path / "applanix" / "lidar_poses.csv"
    return Found(
        name=path.resolve().name,
        format=NAME,
        source=FileSource(tuple(files), parse),
        indices=np.arange(len(files)),
        stamps=in_seconds(files, 1e-6),
        own_track=lambda: _track(truth, "applanix/lidar_poses.csv") if truth.is_file() else None,
        frame="lidar",
        fields="x y z intensity laser time",
        own_poses=lambda file: (
            _track(file, str(file)) if file.suffix == ".csv" and not header_of(file) else None
        ),
    )


def parse(data: bytes) -> Scan:
    """Parse rows of float32: x, y, z, intensity, laser, seconds from the middle of the turn."""
    rows = float_rows(data, 6)
    return Scan(rows[:, :3], times=rows[:, 5])


def _track(path: Path, name: str) -> Track:
    rows = read_table(path, _COLUMNS, header=True)
    rows = rows[np.isfinite(rows).all(axis=1)]
    if not len(rows):
        raise DatasetError(f"{path}: no poses")
    # Rotation by -yaw about z, then -pitch about y, then -roll about x.
    poses = rigid_poses(rows[:, 1:4], Rotation.from_euler("zyx", -rows[:, :3:-1]))
    return clean_track(name, rows[:, 0] * 1e-6, poses)
