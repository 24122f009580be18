"""Helpers of the readers: header lines, counts, columns over bytes, and conversion to a Scan."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from ...errors import DatasetError, InvalidScan
from ...system.budget import check_points
from ...system.checks import axis_fields
from ...system.text import one_line
from ...types import Scan
from .point_times import time_field, time_scale, times_of

MAX_HEADER_BYTES = 1 << 20
_MAX_DIGITS = 18  # any such number fits an int64


def header_lines(data: bytes) -> Iterator[tuple[list[str], int]]:
    """Yield the words of each line and the start of the next line, up to 1 MiB."""
    start = 0
    while (end := data.find(b"\n", start, MAX_HEADER_BYTES)) >= 0:
        yield data[start:end].decode("ascii", "replace").split(), end + 1
        start = end + 1


def brief(error: object) -> str:
    """Return an error's text on one line of at most 120 characters."""
    return one_line(error)[:120]


@contextmanager
def faults_of(where: object) -> Iterator[None]:
    """Prefix DatasetErrors with the file's name; report lack of memory and of access as one."""
    try:
        yield
    except DatasetError as error:
        if str(error).startswith(f"{where}: "):
            raise
        raise DatasetError(f"{where}: {error}") from error
    except MemoryError as error:
        raise DatasetError(f"{where}: not enough memory to read it") from error
    except OSError as error:
        raise DatasetError(f"{where}: cannot read: {error.strerror or error}") from error


def parse_count(word: str, what: str) -> int:
    """Parse a count of a header.

    Raise DatasetError if it is negative, not whole or implausibly large.
    """
    if not (word.isascii() and word.isdigit() and len(word) <= _MAX_DIGITS):
        raise DatasetError(f"{what} is {word[:40]!r}, not a whole number")
    return int(word)


def require_bytes(available: int, needed: int, what: str) -> None:
    """Reject a header whose declared size exceeds the data, before allocation."""
    if needed > available:
        raise DatasetError(
            f"{what} need {needed} bytes, only {max(available, 0)} are left: the file is cut off, "
            "copy it again"
        )


def require_points(promised: int, found: int) -> None:
    """Reject a file with fewer points than its header promises."""
    if found < promised:
        raise DatasetError(
            f"the header promises {promised} points, the file has {found}: copy it again"
        )


def column(
    data: bytes | NDArray[np.uint8], dtype: DTypeLike, count: int, start: int, stride: int
) -> NDArray[Any]:
    """Return ``count`` values, ``stride`` bytes apart, as a view of ``data``."""
    return np.ndarray((count,), dtype, data, start, (stride,)) if count else np.empty(0, dtype)


def wanted_columns(names: Sequence[str]) -> list[int]:
    """Return the positions of x, y and z, and of the field with point times, if any.

    Upper-case names are used if there are no lower-case ones.

    Raise DatasetError if x, y or z is missing or duplicated.
    """
    try:
        chosen = axis_fields(names)
    except InvalidScan as error:
        raise DatasetError(str(error)) from error
    time = time_field(names)
    return chosen if time is None else [*chosen, time]


def scan_from_columns(
    columns: Sequence[NDArray[Any]], *, time_name: str = "", integer_times: bool | None = None
) -> Scan:
    """Build a scan from columns x, y, z and optional point times.

    columns: 3 or 4 arrays (N,) of any number type
    time_name: name of the field with times, which may tell their unit
    integer_times: whether the file stores integers; by default by the column's type
    """
    check_points(len(columns[0]))
    points = np.empty((len(columns[0]), 3), dtype=np.float32)
    with np.errstate(all="ignore"):  # beyond float32: inf, which Scan drops
        for axis in range(3):
            points[:, axis] = columns[axis]
        if len(columns) == 3:
            return Scan(points)
        if integer_times is None:
            integer_times = columns[3].dtype.kind in "iu"
        scale = time_scale(time_name, integer=integer_times)
        return Scan(points, times=times_of(columns[3], scale))


@dataclass(frozen=True)
class PointLayout:
    """Position of x, y and z in a file of points of equal size."""

    count: int
    start: int  # offset of the points
    columns: tuple[int, ...]  # offsets of x, y and z in a point; in a text file their columns
    dtypes: tuple[np.dtype[Any], ...] = ()  # of x, y and z
    stride: int = 0  # bytes per point; in a text file numbers per row
    text: bool = False
