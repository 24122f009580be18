"""Scans in the headerless binary formats of datasets."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..errors import DatasetError
from ..system.budget import check_points
from ..types import Float32, Scan


def rows_of(data: bytes, dtype: np.dtype[np.void] | str, width: int = 0) -> NDArray[np.generic]:
    """The bytes as records, (N,), or as rows of ``width`` values, (N, width).

    Raises
    ------
    DatasetError
        If they are not a whole number of records, as in a file that was cut off.
    """
    kind = np.dtype(dtype)
    size = kind.itemsize * (width or 1)
    if len(data) % size:
        raise DatasetError(f"cut off: {len(data)} bytes are not whole points of {size}")
    check_points(len(data) // size)
    values = np.frombuffer(data, dtype=kind) if data else np.empty(0, dtype=kind)
    return values.reshape(-1, width) if width else values


def float_rows(data: bytes, width: int) -> Float32:
    """Rows of little-endian float32."""
    return np.asarray(rows_of(data, "<f4", width), dtype=np.float32)


def returned(points: NDArray[np.floating], times: NDArray[np.floating] | None = None) -> Scan:
    """A scan of the points that are returns: firings without one are stored as zeros."""
    hit = (points[:, :3] != 0).any(axis=1)
    if hit.all():
        return Scan(points, times=times)
    return Scan(points[hit], times=None if times is None else times[hit])


def parse_float4(data: bytes) -> Scan:
    """Rows of float32: x, y, z, reflectance."""
    return returned(float_rows(data, 4))


def column_times(count: int, rows: int = 64, columns: int = 1024) -> NDArray[np.float64] | None:
    """Seconds after the start of a 10 Hz turn, for clouds stored column by column.

    None where the cloud is not whole, so that the columns of its points are not known.
    """
    if count != rows * columns:
        return None
    return np.repeat(np.arange(columns) / columns * 0.1, rows)
