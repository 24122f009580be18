"""Headerless float32 rows: KITTI's ``.bin`` and nuScenes' ``.pcd.bin``."""

from __future__ import annotations

import numpy as np

from ...errors import DatasetError
from ...system.budget import check_points
from ...system.checks import MAX_METRES
from ...types import Float32, Scan

_WIDTHS = (4, 3, 5)  # KITTI's first
_MIN_ROWS = 100
_MANY_ROWS = 30_000
_STEP = 61  # prime to all widths, so that samples of a wrong width mix all columns
_MIN_CONTRAST = 1.5
_OTHERS, _MUCH_MORE = (6, 7, 8), 4.0  # in 729 files of each kind at most 1.2, and at least 15
_MAX_BEYOND = 0.01  # share of rows with implausible coordinates
_RECORDS = {19: "Avia", 22: "Velodyne", 25: "early Aeva", 26: "Ouster", 29: "Aeva"}
"""Bytes per point of HeLiPR's files, which also end in .bin."""


def parse_kitti(data: bytes) -> Scan:
    """Parse rows of x, y, z, reflectance; an empty file has no points.

    Some .bin files have three columns (no reflectance) or five (a ring). Read at a wrong width,
    every column is the same mixture of all: a width of 3 or 5 is used if rows of 4 look mixed and
    rows of 3 or 5 do not.
    """
    if len(data) % 4:
        raise DatasetError(
            f"{len(data)} bytes are no multiple of float32{_other_records(len(data))}"
        )
    values = _values(data)
    fitting = [width for width in _WIDTHS if len(values) % width == 0]
    default = fitting[:1] if fitting[:1] == [4] else []
    widths = [width for width in fitting if _contrast(values, width) > _MIN_CONTRAST] + default
    if not widths:
        raise DatasetError(f"{len(data)} bytes are no multiple of rows of 4 float32")
    mixed = _MUCH_MORE * _contrast(values, widths[0])
    for width in _OTHERS:
        if len(values) % width == 0 and _contrast(values, width) > mixed:
            raise DatasetError(
                f"rows of {width} float32, as of Boreas or Waymo: open the folder of the set, or "
                "save x, y, z and reflectance"
            )
    rows = values.reshape(-1, widths[0])
    check_points(len(rows))
    if _beyond(rows) > _MAX_BEYOND:
        raise DatasetError(
            f"rows of {widths[0]} float32 have coordinates beyond {MAX_METRES:.0e} m: not a KITTI "
            f"scan{_other_records(len(data))}"
        )
    return Scan(rows)


def parse_nuscenes(data: bytes) -> Scan:
    """Parse rows of x, y, z, intensity, ring."""
    if len(data) % 20:
        raise DatasetError(f"{len(data)} bytes are no multiple of rows of 5 float32")
    check_points(len(data) // 20)
    return Scan(_values(data).reshape(-1, 5))


def _values(data: bytes) -> Float32:
    return np.frombuffer(data, dtype="<f4") if data else np.empty(0, dtype=np.float32)


def _beyond(rows: Float32) -> float:
    """Return the share of rows with implausible coordinates; missing returns do not count."""
    points = rows[np.isfinite(rows[:, :3]).all(axis=1), :3]
    return float((np.abs(points) > MAX_METRES).any(axis=1).mean()) if len(points) else 0.0


def _other_records(size: int) -> str:
    """Return a hint for a file of ``size`` bytes that may be HeLiPR's."""
    names = [name for width, name in _RECORDS.items() if size % width == 0]
    if not names:
        return ""
    return (
        f"; {size} bytes fit records of HeLiPR's {' or '.join(names)}: open the sequence's "
        "folder, the one with LiDAR in it"
    )


def _contrast(values: Float32, width: int) -> float:
    """Return how much wider the widest column spreads than the narrowest; 1 with few rows."""
    rows = values.reshape(-1, width)
    sample = rows[:: _STEP if len(rows) > _MANY_ROWS else 1]
    with np.errstate(all="ignore"):
        sample = sample[np.isfinite(sample).all(axis=1)]
        if len(sample) < _MIN_ROWS:
            return 1.0
        low, high = np.percentile(sample.astype(np.float64), [10, 90], axis=0)
    spreads = high - low
    with np.errstate(divide="ignore", invalid="ignore"):
        return float(spreads.max() / spreads.min()) if spreads.max() else 1.0


def format_kitti(points: Float32) -> bytes:
    """Format rows of x, y, z and a reflectance of 0."""
    rows = np.zeros((len(points), 4), dtype="<f4")
    rows[:, :3] = points
    return rows.tobytes()
