"""Read the POINTS of legacy ``.vtk`` files, ASCII and BINARY (big endian)."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...errors import DatasetError
from ...system.budget import check_points
from ...types import Scan
from .fields import brief, column, header_lines, parse_count, require_bytes, scan_from_columns
from .text import plain_nan

_TYPES = {
    "float": "f4", "double": "f8",
    "char": "i1", "short": "i2", "int": "i4", "long": "i8", "vtktypeint64": "i8",
    "unsigned_char": "u1", "unsigned_short": "u2", "unsigned_int": "u4", "unsigned_long": "u8",
}  # fmt: skip
_WORD = re.compile(rb"(?<!\S)(?![-+]?(?:nan|inf|infinity)(?!\S))[a-z]", re.I)
"""Start of the next section of a file."""
_POINTS = re.compile(rb"^POINTS[ \t]+(\S{1,40})[ \t]+(\w{1,40})[ \t]*\r?\n", re.M | re.I)


def parse_vtk(data: bytes) -> Scan:
    """Parse the points of poly data, unstructured and structured grids."""
    return scan_from_columns(parse_coordinates(data))


def parse_coordinates(data: bytes) -> list[NDArray[Any]]:
    """Return the columns x, y and z of a file as they are stored."""
    encoding, start = _parse_header(data)
    found = _POINTS.search(data, start)
    if found is None:
        raise DatasetError("no POINTS line")
    count = parse_count(found[1].decode("ascii", "replace"), "the number of POINTS")
    check_points(count)
    name = found[2].decode("ascii").lower()
    if name not in _TYPES:
        raise DatasetError(f"points of unknown type {name!r}")
    if encoding == "BINARY":
        return _parse_binary(data, found.end(), count, np.dtype(f">{_TYPES[name]}"))
    return _parse_ascii(data[found.end() :], count)


def _parse_header(data: bytes) -> tuple[str, int]:
    lines = header_lines(data)
    magic, _ = next(lines, ([], 0))
    if [word.lower() for word in magic[:3]] != ["#", "vtk", "datafile"]:
        raise DatasetError("not a legacy VTK file: the first line is not '# vtk DataFile'")
    next(lines, None)  # title
    words, start = next(lines, ([], 0))
    encoding = " ".join(words).upper()
    if encoding not in ("ASCII", "BINARY"):
        raise DatasetError(f"the third line is {encoding[:40]!r}, not ASCII or BINARY")
    return encoding, start


def _parse_binary(data: bytes, start: int, count: int, dtype: np.dtype[Any]) -> list[NDArray[Any]]:
    size = dtype.itemsize
    require_bytes(len(data) - start, 3 * size * count, f"{count} points")
    return [column(data, dtype, count, start + axis * size, 3 * size) for axis in range(3)]


def _parse_ascii(data: bytes, count: int) -> list[NDArray[Any]]:
    """Parse numbers in any number of columns; VTK writes three points per line."""
    require_bytes(len(data) + 1, 6 * count, f"{count} points")  # at least a digit and a space each
    if b"#" in data or b"nan(" in data.lower():
        data = plain_nan(data.decode("latin-1")).encode("latin-1")
    if not count:
        return [np.empty(0)] * 3
    end = _WORD.search(data)
    try:
        # Without a count: given a count and too few numbers, NumPy returns uninitialised memory.
        values = np.fromstring(data[: end.start()] if end else data, dtype=np.float64, sep=" ")
    except (ValueError, DeprecationWarning) as error:  # depends on NumPy's version
        raise DatasetError(f"cannot parse the points: {brief(error)}") from error
    if len(values) < 3 * count:
        raise DatasetError(f"{count} points need {3 * count} numbers, only {len(values)} are there")
    return list(values[: 3 * count].reshape(-1, 3).T)
