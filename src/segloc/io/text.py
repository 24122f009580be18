"""Numbers as text: ``.csv`` (libpointmatcher's among them), ``.txt`` and ``.xyz``."""

from __future__ import annotations

import io
from collections.abc import Sequence

import numpy as np

from ..errors import DatasetError
from ..types import Float32, Float64, Scan
from .fields import one_line, scan_from_columns, wanted_columns


def parse_table(
    data: bytes,
    *,
    columns: Sequence[int],
    width: int,
    delimiter: str | None = None,
    rows: int | None = None,
) -> Float64:
    """Some columns of a table of numbers.

    Parameters
    ----------
    data : bytes
        The lines; blank ones are skipped.
    columns : sequence of int
        Which columns to parse; what stands in the others may be any text.
    width : int
        How many columns there are; checked on the last line, where a cut would show.
    delimiter : str, optional
        Between the columns; white space by default.
    rows : int, optional
        How many rows there should be.

    Returns
    -------
    (N, len(columns)) float64

    Raises
    ------
    DatasetError
        If a number cannot be parsed, or there are too few rows or columns.
    """
    return _parse_lines(_split_lines(data), columns, width, delimiter, rows)


def _split_lines(data: bytes) -> list[str]:
    text = data.decode("utf-8-sig", "replace")
    return [line for line in text.split("\n") if line and not line.isspace()]


def _parse_lines(
    lines: list[str],
    columns: Sequence[int],
    width: int,
    delimiter: str | None,
    rows: int | None = None,
) -> Float64:
    if rows is not None and len(lines) != rows:
        raise DatasetError(f"the header says {rows} points, but there are {len(lines)} rows")
    if not lines:
        return np.empty((0, len(columns)))
    if (found := len(lines[-1].split(delimiter))) != width:
        raise DatasetError(f"the last row has {found} columns, not {width}")
    try:
        return np.loadtxt(
            lines, delimiter=delimiter, usecols=columns, comments=None, ndmin=2, dtype=np.float64
        )
    except ValueError as error:
        raise DatasetError(f"cannot parse the points: {one_line(error)}") from error


def parse_csv(data: bytes) -> Scan:
    """Columns named x, y, z in any order (and a time, if any); without names the first three."""
    lines = _split_lines(data)
    if not lines:
        raise DatasetError("empty file")
    return _parse_text(lines)


def parse_txt(data: bytes) -> Scan:
    """As ``parse_csv``; lines that start with # or // are comments, and no lines are no points."""
    lines = [line for line in _split_lines(data) if not line.lstrip().startswith(("#", "//"))]
    return _parse_text(lines) if lines else Scan(np.empty((0, 3), dtype=np.float32))


def _parse_text(lines: list[str]) -> Scan:
    delimiter = next((mark for mark in ",;" if mark in lines[0]), None)
    first = [word.strip().strip("\"'").lower() for word in lines[0].split(delimiter)]
    if all(_is_number(word) for word in first[:3]):
        if len(first) < 3:
            raise DatasetError(f"the first row has {len(first)} columns; x, y, z need 3")
        columns = [0, 1, 2]
    else:
        columns = wanted_columns(first)
        lines = lines[1:]
    table = _parse_lines(lines, columns, len(first), delimiter)
    return scan_from_columns(list(table.T))


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


def format_csv(points: Float32) -> bytes:
    """The header x,y,z and rows with the nine digits that tell any two float32 apart."""
    buffer = io.StringIO()
    np.savetxt(buffer, points, fmt="%.9g", delimiter=",", header="x,y,z", comments="")
    return buffer.getvalue().encode("ascii")
