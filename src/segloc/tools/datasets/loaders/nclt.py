"""NCLT: a session's folder with ``velodyne_sync``, and ``groundtruth_DATE.csv``.

Format: robots.engin.umich.edu/nclt and its read_vel_sync.py; N. Carlevaris-Bianco et al.,
"University of Michigan North Campus long-term vision and lidar dataset", IJRR 2016. Points are
motion-compensated, in the body frame. Body and world have z down; both are turned about x here, so
that z is up.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ....types import Scan
from ...io.pose_files import header_of
from ..layout import holds_scans, in_seconds, locations, relative, rows_of, scan_files
from ..recorded import FileSource, Found
from ..tracks import Z_UP, Track, clean_track, euler_poses, read_table

NAME = "NCLT"
INNER = ("velodyne_sync",)
_POINT = np.dtype([("xyz", "<u2", 3), ("intensity", "u1"), ("laser", "u1")])
_STEP_M, _OFFSET_M = 0.005, -100.0


def recognises(path: Path) -> bool:
    return holds_scans(path / "velodyne_sync", 15)


def find(path: Path, topic: str | None) -> Found:
    files = scan_files(path / "velodyne_sync")
    truth = next(filter(None, map(_truth, locations(path))), None)
    return Found(
        name=path.resolve().name,
        format=NAME,
        source=FileSource(tuple(files), parse),
        indices=np.arange(len(files)),
        stamps=in_seconds(files, 1e-6),
        own_track=lambda: _track(truth, relative(truth, path.resolve())) if truth else None,
        frame="body, z up",
        fields="x y z intensity laser",
        own_poses=lambda file: (
            _track(file, str(file)) if file.suffix == ".csv" and not header_of(file) else None
        ),
    )


def parse(data: bytes) -> Scan:
    """Parse records of three uint16 (5 mm steps from -100 m), intensity and laser."""
    steps = rows_of(data, _POINT)["xyz"].astype(np.float64)  # type: ignore[call-overload]
    points = steps * _STEP_M + _OFFSET_M
    return Scan(points * [1.0, -1.0, -1.0])


def _truth(path: Path) -> Path | None:
    name = f"groundtruth_{path.name}.csv"
    folders = (path, path.parent, path.parent / "ground_truth", path.parent / "groundtruth")
    own = sorted(path.glob("groundtruth_*.csv"))
    return next((file for file in [*own, *(f / name for f in folders)] if file.is_file()), None)


def _track(path: Path, name: str) -> Track:
    rows = read_table(path, range(7))  # microseconds, x, y, z, roll, pitch, heading
    known = np.isfinite(rows).all(axis=1)
    rows = rows[known]
    poses = Z_UP @ euler_poses(rows[:, 1:4], rows[:, 4:]) @ Z_UP
    return clean_track(name, rows[:, 0] * 1e-6, poses)
