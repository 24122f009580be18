"""MulRan: a sequence's folder with ``Ouster`` and ``global_pose.csv``.

Format: sites.google.com/view/mulran-pr and its calib_base2ouster.txt; G. Kim et al., "MulRan:
Multimodal range dataset for urban place recognition", ICRA 2020.
"""

from __future__ import annotations

from math import radians
from pathlib import Path

import numpy as np

from ....types import Scan
from ...io.pose_files import header_of
from ..layout import (
    column_times,
    drop_missing_returns,
    float_rows,
    holds_scans,
    in_seconds,
    scan_files,
)
from ..recorded import FileSource, Found
from ..tracks import Track, clean_track, matrix_poses, mount, read_table

NAME = "MulRan"
INNER = ("Ouster",)
MOUNT = ((1.7042, -0.021, 1.8047), (radians(0.0001), radians(0.0003), radians(179.6654)))
"""T_base_ouster: x, y, z in metres and roll, pitch, yaw in radians."""


def recognises(path: Path) -> bool:
    return holds_scans(path / "Ouster", 15)


def find(path: Path, topic: str | None) -> Found:
    files = scan_files(path / "Ouster")
    truth = path / "global_pose.csv"
    return Found(
        name=path.resolve().name,
        format=NAME,
        source=FileSource(tuple(files), parse),
        indices=np.arange(len(files)),
        stamps=in_seconds(files, 1e-9),
        own_track=lambda: _track(truth, "global_pose.csv") if truth.is_file() else None,
        frame="ouster",
        fields="x y z intensity, times by column",
        own_poses=lambda file: (
            _track(file, str(file)) if file.suffix == ".csv" and not header_of(file) else None
        ),
    )


def parse(data: bytes) -> Scan:
    """Parse rows of float32 of an OS1-64: x, y, z, intensity, column by column."""
    rows = float_rows(data, 4)
    return drop_missing_returns(rows, column_times(len(rows)))


def _track(path: Path, name: str) -> Track:
    rows = read_table(path, range(13))  # nanoseconds and the upper rows of T_world_base
    rows = rows[np.isfinite(rows).all(axis=1)]
    return clean_track(
        name, rows[:, 0] * 1e-9, matrix_poses(rows[:, 1:], str(path)) @ mount(*MOUNT)
    )
