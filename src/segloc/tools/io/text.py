"""Read and write numbers as text: ``.csv`` (also libpointmatcher's), ``.txt``, ``.xyz`` etc."""

from __future__ import annotations

import io
import mmap
import re
from collections.abc import Iterator, Sequence
from itertools import chain

import numpy as np

from ...errors import DatasetError
from ...system.budget import check_points
from ...types import Float32, Float64, Scan
from .fields import brief, require_points, scan_from_columns, wanted_columns
from .point_times import time_scale

Mapped = bytes | mmap.mmap

_BLOCK = 1 << 23  # bytes parsed at a time: as lines they take several times as many
_MAX_LINE = 1 << 16
COMMENTS = ("#", "//")
_BOM = b"\xef\xbb\xbf"
_TITLES = re.compile(r"^\s*(?:#|//)\s*(?=[A-Za-z\"])")  # before names of columns
_NOT_A_NUMBER = re.compile(r"[-+]?(?:nan\([^)\s]*\)|1\.#(?:q?nan|snan|ind|inf)\w*)", re.I)
"""Non-finite values as Microsoft's and other C libraries print them."""


def plain_nan(text: str) -> str:
    """Return the text with ``nan`` for other spellings of non-finite values."""
    return _NOT_A_NUMBER.sub("nan", text)


def parse_table(
    data: bytes,
    *,
    columns: Sequence[int],
    width: int | None,
    rows: int,
    skipped: int = 0,
    more: bool = False,
) -> Float64:
    """Parse columns of a table of numbers between white space, (N, len(columns)) float64.

    data: lines; blank ones are skipped
    columns: columns to parse; others may hold any text
    width: number of columns, checked on the last line, where truncation shows; None if rows differ
    rows: expected number of rows
    skipped: lines before them
    more: True if lines may follow

    Raise DatasetError if a number cannot be parsed, or there are too few rows or columns.
    """
    check_points(rows)
    found = _select(_blocks(data), skipped, rows if more else None)
    table = _join(_tables(found, columns, width, None))
    if len(table) > rows:
        raise DatasetError(f"the header declares {rows} points, the file has {len(table)} rows")
    require_points(rows, len(table))
    return table


def table_parts(
    data: Mapped, start: int, columns: Sequence[int], rows: int, width: int
) -> Iterator[Float64]:
    """Read some columns of the first rows of a table between white space, part by part.

    data: the file
    start: where the table begins
    columns: which columns to parse
    rows: how many rows there should be
    width: number of columns, checked on the last row

    Yield (N, len(columns)) float64.

    Raise DatasetError if a number cannot be parsed, or there are too few rows.
    """
    left = rows
    for part in _tables(_select(_blocks(data, (), start), 0, rows), columns, width, None):
        left -= len(part)
        yield part
    require_points(rows, rows - left)


def _blocks(data: Mapped, comments: tuple[str, ...] = (), start: int = 0) -> Iterator[list[str]]:
    """The lines that are neither blank nor comments, some megabytes of them at a time."""
    if not start and data[: len(_BOM)] == _BOM:
        start = len(_BOM)
    while start < len(data):
        end = len(data)
        if end - start > _BLOCK:
            end = data.find(b"\n", start + _BLOCK, start + _BLOCK + _MAX_LINE) + 1
            if not end and start + _BLOCK + _MAX_LINE < len(data):
                raise DatasetError(f"a line longer than {_MAX_LINE} bytes")
            end = end or len(data)
        lines = data[start:end].decode("utf-8", "replace").split("\n")
        yield [
            line
            for line in lines
            if line and not line.isspace() and not (comments and line.lstrip().startswith(comments))
        ]
        start = end


def _select(blocks: Iterator[list[str]], skipped: int, rows: int | None) -> Iterator[list[str]]:
    """Yield the lines after the first ``skipped``, at most ``rows``."""
    for lines in blocks:
        kept = lines[skipped:] if skipped else lines
        skipped -= len(lines) - len(kept)
        if rows is not None:
            kept = kept[:rows]
            rows -= len(kept)
        yield kept
        if rows == 0:
            return


def _tables(
    blocks: Iterator[list[str]], columns: Sequence[int], width: int | None, delimiter: str | None
) -> Iterator[Float64]:
    """The table of each block; an empty one if there are no lines."""
    count, last = 0, ""
    for lines in blocks:
        if not lines:
            continue
        try:
            table = _load(lines, columns, delimiter)
        except ValueError as error:
            after = f" after row {count}" if count else ""
            raise DatasetError(f"cannot parse the points{after}: {brief(error)}") from error
        count, last = count + len(lines), lines[-1]
        yield table
    if not count:
        yield np.empty((0, len(columns)))
    elif width is not None and (found := len(_words(last, delimiter))) != width:
        raise DatasetError(f"the last row has {found} columns, not {width}")


def _join(tables: Iterator[Float64]) -> Float64:
    """All of them in one; their rows are counted against the limit of a scan."""
    found: list[Float64] = []
    count = 0
    for table in tables:
        count += len(table)
        check_points(count)
        found.append(table)
    return found[0] if len(found) == 1 else np.concatenate(found)


def _load(lines: list[str], columns: Sequence[int], delimiter: str | None) -> Float64:
    """Parse columns of lines of numbers, with any spelling of NaN."""

    def load(rows: list[str]) -> Float64:
        return np.loadtxt(
            rows, delimiter=delimiter, usecols=columns, comments=None, ndmin=2, dtype=np.float64
        )

    try:
        return load(lines)
    except ValueError:
        plain = [plain_nan(line) for line in lines]
        if plain == lines:
            raise
        return load(plain)


def _words(line: str, delimiter: str | None) -> list[str]:
    if len(line) > _MAX_LINE:
        raise DatasetError(f"a line of {len(line)} characters, at most {_MAX_LINE}")
    return line.split(delimiter)


def parse_csv(data: bytes) -> Scan:
    """Columns named x, y, z in any order (and a time, if any); without names the first three."""
    return scan_from_columns(list(_join(text_parts(data, ())).T))


def parse_txt(data: bytes) -> Scan:
    """As ``parse_csv``; lines that start with # or // are comments, and no lines are no points."""
    return scan_from_columns(list(_join(text_parts(data)).T))


def text_parts(data: Mapped, comments: tuple[str, ...] = COMMENTS) -> Iterator[Float64]:
    """Yield the columns x, y, z (and a time, if any) of a text file, (N, 3 or 4), part by part.

    comments: marks of lines to skip; none in a table, which must not be empty

    Raise DatasetError if a number cannot be parsed, or a column is missing.
    """
    blocks = _blocks(data, comments)
    lines = next(filter(None, blocks), None)
    if lines is None and not comments:
        raise DatasetError("empty file")
    if lines is None:
        yield np.empty((0, 3))
        return
    first, delimiter = _first_row(lines)
    if not all(_is_number(word) for word in first[:3]):
        names = first
        del lines[0]
    elif len(first) < 3:
        raise DatasetError(f"the first row has {len(first)} columns; x, y, z need 3")
    else:
        names = _names_above(data, comments, len(first))
    columns = wanted_columns(names) if names else [0, 1, 2]
    # Text has no types: without a unit in the name times are taken as seconds.
    scale = time_scale(names[columns[-1]] if names else "", integer=False)
    for table in _tables(chain([lines], blocks), columns, len(first), delimiter):
        table[:, 3:] *= scale
        yield table


def _names_above(data: Mapped, comments: tuple[str, ...], count: int) -> list[str]:
    """Return the column names in the last comment before the first row, if there are ``count``."""
    last, head = "", data[:_MAX_LINE].decode("utf-8", "replace")
    for line in map(str.strip, head.splitlines()):
        if line and not (comments and line.startswith(comments)):
            break
        last = line or last
    names = _first_row([last])[0] if last else []
    return names if len(names) == count and {"x", "y", "z"} <= {*names} else []


def field_names(head: bytes) -> list[str]:
    """Return the names of the columns by a file's first bytes; none without names."""
    lines = next(filter(None, _blocks(head, COMMENTS)), None)
    first = _first_row(lines)[0] if lines else []
    if any(_is_number(word) for word in first[:3]):
        return _names_above(head, COMMENTS, len(first))
    return first


def _first_row(lines: list[str]) -> tuple[list[str], str | None]:
    """Return the words of the first row and the delimiter; drops a number of points before it."""
    if len(lines) > 1 and _is_count(lines[0]) and not _is_count(lines[1]):
        del lines[0]
    lines[0] = _TITLES.sub("", lines[0])
    delimiter = next((mark for mark in ",;" if mark in lines[0]), None)
    return [word.strip().strip("\"'").lower() for word in _words(lines[0], delimiter)], delimiter


def _is_count(line: str) -> bool:
    """Return whether a line is one whole number, the first line of .pts files."""
    return len(line) <= _MAX_LINE and line.strip().isdecimal()


def _is_number(word: str) -> bool:
    try:
        float(plain_nan(word))
    except ValueError:
        return False
    return True


def format_csv(points: Float32) -> bytes:
    """Format the header x,y,z and rows with nine digits, which keep every float32 distinct."""
    buffer = io.StringIO()
    np.savetxt(buffer, points, fmt="%.9g", delimiter=",", header="x,y,z", comments="")
    return buffer.getvalue().encode("ascii")
