"""HeLiPR: a sequence's folder with ``LiDAR/Ouster``, ``LiDAR/Avia``, ... and ``LiDAR_GT``.

Format: sites.google.com/view/heliprdataset and github.com/minwoo0611/HeLiPR-File-Player; M. Jung
et al., "HeLiPR: Heterogeneous LiDAR dataset for inter-LiDAR place recognition", IJRR 2024.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ....types import Scan
from ..layout import (
    choose,
    drop_missing_returns,
    holds_scans,
    in_seconds,
    numbers,
    rows_of,
    scan_files,
)
from ..recorded import FileSource, Found
from ..tracks import Track, clean_track, quaternion_poses, read_table

NAME = "HeLiPR"
_XYZ = [("x", "<f4"), ("y", "<f4"), ("z", "<f4")]
_AEVA = [*_XYZ, ("reflectivity", "<f4"), ("velocity", "<f4"), ("t", "<i4"), ("line", "u1")]
POINTS: dict[str, np.dtype[Any]] = {
    "Ouster": np.dtype(
        [*_XYZ, ("intensity", "<f4"), ("t", "<u4"), ("reflectivity", "<u2"), ("ring", "<u2"),
         ("ambient", "<u2")]
    ),
    "Velodyne": np.dtype([*_XYZ, ("intensity", "<f4"), ("ring", "<u2"), ("time", "<f4")]),
    "Avia": np.dtype([*_XYZ, ("reflectivity", "u1"), ("tag", "u1"), ("line", "u1"), ("t", "<u4")]),
    "Aeva": np.dtype([*_AEVA, ("intensity", "<f4")]),
    "Aeva, early": np.dtype(_AEVA),
}  # fmt: skip
"""Point layout of each sensor, packed; field ``t`` is in nanoseconds, ``time`` in seconds."""
_LAST_EARLY_AEVA_NS = 1691936557946849179
INNER = tuple(f"LiDAR/{name}" for name in POINTS)


def recognises(path: Path) -> bool:
    return any(holds_scans(path / "LiDAR" / name, 15) for name in POINTS)


def find(path: Path, topic: str | None) -> Found:
    present = [name for name in POINTS if holds_scans(path / "LiDAR" / name, 15)]
    sensor = choose(path, present, topic)
    files = scan_files(path / "LiDAR" / sensor)
    stamps = numbers(files)
    early = sensor == "Aeva" and stamps[0] <= _LAST_EARLY_AEVA_NS
    layout = POINTS["Aeva, early" if early else sensor]
    truth = path / "LiDAR_GT" / f"global_{sensor}_gt.txt"
    return Found(
        name=f"{path.resolve().name}-{sensor}",
        format=NAME,
        source=FileSource(tuple(files), partial(parse, layout=layout)),
        indices=np.arange(len(files)),
        stamps=in_seconds(files, 1e-9),
        own_track=lambda: _track(truth, f"LiDAR_GT/{truth.name}") if truth.is_file() else None,
        topic=sensor,
        frame=sensor,
        fields=" ".join(layout.names or ()),
    )


def parse(data: bytes, layout: np.dtype[Any]) -> Scan:
    """Parse packed records of one of the sensors."""
    rows: np.ndarray = rows_of(data, layout)
    points = np.column_stack([rows["x"], rows["y"], rows["z"]])
    names = layout.names or ()
    times = rows["time"].astype(np.float64) if "time" in names else rows["t"] * 1e-9
    return drop_missing_returns(points, times)


def _track(path: Path, name: str) -> Track:
    rows = read_table(path, range(8), separator=None)  # nanoseconds, x, y, z, qx, qy, qz, qw
    poses = quaternion_poses(rows[:, 1:4], rows[:, 4:], str(path))
    return clean_track(name, rows[:, 0] * 1e-9, poses)
