"""What the readers share: header lines and counts, columns over bytes, and the way to a Scan."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from ..errors import DatasetError
from ..system.budget import check_points
from ..types import Scan

TIME_NAMES = frozenset({"t", "time", "timestamp", "time_stamp"})
"""Fields that hold a point's time."""

_MAX_HEADER = 1 << 20
_MAX_DIGITS = 18  # any such number fits an int64


def header_lines(data: bytes) -> Iterator[tuple[list[str], int]]:
    """The words of each line, and where the next line starts; ends after 1 MiB."""
    start = 0
    while (end := data.find(b"\n", start, _MAX_HEADER)) >= 0:
        yield data[start:end].decode("ascii", "replace").split(), end + 1
        start = end + 1


def one_line(error: object) -> str:
    """What an error from elsewhere says, fit to stand in a message of one line."""
    return " ".join(str(error).split())[:120] or type(error).__name__


@contextmanager
def faults_of(where: object) -> Iterator[None]:
    """Name the file in a DatasetError about its content, or where memory runs out."""
    try:
        yield
    except DatasetError as error:
        if str(error).startswith(f"{where}: "):
            raise
        raise DatasetError(f"{where}: {error}") from error
    except MemoryError as error:
        raise DatasetError(f"{where}: not enough memory to read it") from error


def parse_count(word: str, what: str) -> int:
    """A number of things from a header.

    Raise DatasetError if it is not a whole number of 0 or more, or one beyond all reason.
    """
    if not (word.isascii() and word.isdigit() and len(word) <= _MAX_DIGITS):
        raise DatasetError(f"{what} is {word[:40]!r}, not a whole number")
    return int(word)


def require_bytes(available: int, needed: int, what: str) -> None:
    """Refuse a header that promises more than there is, before anything is allocated."""
    if needed > available:
        raise DatasetError(f"{what} need {needed} bytes, but only {max(available, 0)} are left")


def column(
    data: bytes | NDArray[np.uint8], dtype: DTypeLike, count: int, start: int, stride: int
) -> NDArray[Any]:
    """``count`` values, ``stride`` bytes apart, as a view of ``data``."""
    return np.ndarray((count,), dtype, data, start, (stride,)) if count else np.empty(0, dtype)


def wanted_columns(names: Sequence[str]) -> list[int]:
    """Positions of x, y and z, and of the first field that holds a time where there is one.

    Capital letters do where there are no small ones.

    Raise DatasetError if x, y or z is missing or there twice.
    """
    chosen = []
    for axis in "xyz":
        name = axis if axis in names else axis.upper()
        if (found := names.count(name)) != 1:
            raise DatasetError(f"there are {found} fields named {axis}" if found else f"no {axis}")
        chosen.append(names.index(name))
    time = [position for position, name in enumerate(names) if name.lower() in TIME_NAMES]
    return chosen + time[:1]


def scan_from_columns(columns: Sequence[NDArray[Any]], *, nanoseconds: bool | None = None) -> Scan:
    """A scan of the columns x, y, z and, where there is a fourth, the points' times.

    columns: 3 or 4 arrays (N,) of any number type
    nanoseconds: whether the times are nanoseconds; by default they are where their type is an
      integer
    """
    check_points(len(columns[0]))
    points = np.empty((len(columns[0]), 3), dtype=np.float32)
    with np.errstate(all="ignore"):  # what float32 cannot hold becomes inf, which a Scan drops
        for axis in range(3):
            points[:, axis] = columns[axis]
        if len(columns) == 3:
            return Scan(points)
        if nanoseconds is None:
            nanoseconds = columns[3].dtype.kind in "iu"
        times = np.asarray(columns[3], dtype=np.float64)
        return Scan(points, times=times * 1e-9 if nanoseconds else times)


@dataclass(frozen=True)
class PointLayout:
    """Where x, y and z stand in a file whose points all have one size.

    Attributes
    ----------
    count : int
        Number of points.
    start : int
        First byte of the points.
    columns : (int, int, int)
        First bytes of x, y and z in a point; in a text their columns.
    dtypes : tuple of dtype
        Of x, y and z.
    stride : int
        Bytes of a point.
    text : bool
    """

    count: int
    start: int
    columns: tuple[int, ...]
    dtypes: tuple[np.dtype[Any], ...] = ()
    stride: int = 0
    text: bool = False
