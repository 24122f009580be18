"""Read and write PCL's ``.pcd``: ASCII, binary and binary_compressed, any field layout."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ... import _native
from ...errors import DatasetError
from ...system.budget import check_bytes, check_points
from ...types import Float32, Scan
from .fields import (
    PointLayout,
    column,
    header_lines,
    parse_count,
    require_bytes,
    scan_from_columns,
    wanted_columns,
)
from .text import parse_table

_KINDS = {"F": ("f", (4, 8)), "I": ("i", (1, 2, 4, 8)), "U": ("u", (1, 2, 4, 8))}


@dataclass(frozen=True)
class _Field:
    """One field of a point: ``count`` values of ``size`` bytes."""

    name: str
    size: int
    kind: str
    count: int

    @property
    def num_bytes(self) -> int:
        return self.size * self.count

    @property
    def dtype(self) -> np.dtype[Any]:
        letter, sizes = _KINDS.get(self.kind.upper(), ("", ()))
        if self.size not in sizes:
            raise DatasetError(f"field {self.name} has type {self.kind!r} of size {self.size}")
        return np.dtype(f"<{letter}{self.size}")


@dataclass(frozen=True)
class _Header:
    fields: tuple[_Field, ...]
    points: int
    encoding: str
    start: int
    """Offset of the points."""

    @property
    def stride(self) -> int:
        return sum(field.num_bytes for field in self.fields)

    @property
    def used_fields(self) -> list[int]:
        # Fields of several values are no coordinates.
        return wanted_columns([field.name if field.count == 1 else "" for field in self.fields])

    @property
    def width(self) -> int:
        """Numbers per point."""
        return sum(field.count for field in self.fields)

    def columns(self, wanted: list[int]) -> list[int]:
        """Return the first column of fields in an ASCII file."""
        return [sum(field.count for field in self.fields[:k]) for k in wanted]

    def places(self, wanted: list[int]) -> list[tuple[np.dtype[Any], int]]:
        """Return type and offset of fields in a binary point."""
        sizes = [field.num_bytes for field in self.fields]
        return [(self.fields[k].dtype, sum(sizes[:k])) for k in wanted]

    def scan(self, columns: Sequence[NDArray[Any]]) -> Scan:
        """Build a scan from the wanted columns, whose types may be lost."""
        last = self.fields[self.used_fields[-1]]
        is_integer = last.kind.upper() in ("I", "U")
        return scan_from_columns(columns, time_name=last.name, integer_times=is_integer)


def parse_pcd(data: bytes) -> Scan:
    """Parse a PCD file; VIEWPOINT is ignored: points stay in the stored frame."""
    header = _parse_header(data)
    return header.scan(_columns(data, header, header.used_fields))


def parse_coordinates(data: bytes) -> list[NDArray[Any]]:
    """Return the columns x, y and z of a PCD file as they are stored."""
    header = _parse_header(data)
    return _columns(data, header, header.used_fields[:3])


def parse_fields(data: bytes) -> tuple[list[str], NDArray[np.float64]]:
    """Return the names of the fields with one value, and their values (N, fields)."""
    header = _parse_header(data)
    single = [k for k, field in enumerate(header.fields) if field.count == 1]
    if not single:
        raise DatasetError("no fields")
    with np.errstate(invalid="ignore"):  # damaged bytes may be signalling NaN
        rows = np.column_stack(_columns(data, header, single)).astype(np.float64)
    return [header.fields[k].name for k in single], rows


def _columns(data: bytes, header: _Header, wanted: list[int]) -> list[NDArray[Any]]:
    """Return the values of fields."""
    check_points(header.points)
    if header.encoding == "ascii":
        return _parse_ascii(data, header, wanted)
    if header.encoding == "binary":
        return _parse_binary(data, header, wanted)
    if header.encoding == "binary_compressed":
        return _parse_compressed(data, header, wanted)
    raise DatasetError(f"DATA is {header.encoding[:40]!r}, not ascii, binary or binary_compressed")


def point_layout(head: bytes) -> PointLayout | None:
    """Return the layout of coordinates by a file's first bytes; None if compressed."""
    header = _parse_header(head)
    if header.encoding == "ascii":
        columns = tuple(header.columns(header.used_fields[:3]))
        return PointLayout(header.points, header.start, columns, stride=header.width, text=True)
    if header.encoding != "binary":
        return None
    dtypes, columns = zip(*header.places(header.used_fields[:3]), strict=True)
    return PointLayout(header.points, header.start, columns, dtypes, header.stride)


def point_count(head: bytes) -> int:
    """Return the number of points by a file's first bytes."""
    return _parse_header(head).points


def field_names(head: bytes) -> list[str]:
    """Return the names of the fields of a point by a file's first bytes."""
    return [field.name for field in _parse_header(head).fields]


def _parse_header(data: bytes) -> _Header:
    entries: dict[str, list[str]] = {}
    for words, start in header_lines(data):
        if words and not words[0].startswith("#"):
            entries[words[0]] = words[1:]
        if "DATA" in entries:
            fields, points = _parse_fields(entries), _parse_num_points(entries)
            return _Header(fields, points, " ".join(entries["DATA"]).lower(), start)
    raise DatasetError("not a PCD file: no DATA line in its header")


def _parse_fields(entries: dict[str, list[str]]) -> tuple[_Field, ...]:
    names = entries.get("FIELDS", entries.get("COLUMNS", []))  # COLUMNS: before version 0.6
    rows = {"SIZE": entries.get("SIZE", []), "TYPE": entries.get("TYPE", [])}
    rows["COUNT"] = entries.get("COUNT", ["1"] * len(names))
    for key, values in rows.items():
        if len(values) != len(names):
            raise DatasetError(f"{len(names)} FIELDS but {len(values)} values in the {key} line")
    return tuple(
        _Field(name, parse_count(size, "a SIZE"), kind, parse_count(count, "a COUNT"))
        for name, size, kind, count in zip(
            names, rows["SIZE"], rows["TYPE"], rows["COUNT"], strict=True
        )
    )


def _parse_num_points(entries: dict[str, list[str]]) -> int:
    def count(key: str, default: str | None = None) -> int:
        words = entries.get(key, [] if default is None else [default])
        if len(words) != 1:
            raise DatasetError(f"the header needs one {key}")
        return parse_count(words[0], key)

    if "WIDTH" not in entries:
        return count("POINTS")
    grid = count("WIDTH") * count("HEIGHT", "1")
    if not grid:  # some writers set POINTS only
        return count("POINTS", "0")
    if count("POINTS", str(grid)) != grid:
        raise DatasetError(f"POINTS is {entries['POINTS'][0]}, but WIDTH x HEIGHT is {grid}")
    return grid


def _parse_ascii(data: bytes, header: _Header, wanted: list[int]) -> list[NDArray[Any]]:
    table = parse_table(
        data[header.start :],
        columns=header.columns(wanted),
        width=header.width,
        rows=header.points,
    )
    return list(table.T)


def _parse_binary(data: bytes, header: _Header, wanted: list[int]) -> list[NDArray[Any]]:
    needed = header.points * header.stride
    require_bytes(len(data) - header.start, needed, f"{header.points} points")
    return [
        column(data, dtype, header.points, header.start + at, header.stride)
        for dtype, at in header.places(wanted)
    ]


def _parse_compressed(data: bytes, header: _Header, wanted: list[int]) -> list[NDArray[Any]]:
    """Parse two sizes, then LZF over the fields, stored one after another."""
    content = _decompress(data, header.start, header.points * header.stride)
    return [
        column(content, dtype, header.points, header.points * at, dtype.itemsize)
        for dtype, at in header.places(wanted)
    ]


def _decompress(data: bytes, start: int, expected: int) -> NDArray[np.uint8]:
    require_bytes(len(data) - start, 8, "the sizes of the compressed data")
    compressed, size = struct.unpack_from("<II", data, start)
    if size != expected:
        raise DatasetError(f"the points need {expected} bytes, the compressed data hold {size}")
    require_bytes(len(data) - start - 8, compressed, "the compressed points")
    check_bytes(size, "points")
    try:
        return _native.lzf_decompress(column(data, np.uint8, compressed, start + 8, 1), size)
    except ValueError as error:
        raise DatasetError(str(error)) from error


def format_pcd(points: Float32) -> bytes:
    """Format a binary PCD with the fields x, y, z as float32."""
    header = (
        "# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\n"
        "FIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\n"
        f"WIDTH {len(points)}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\n"
        f"POINTS {len(points)}\nDATA binary\n"
    )
    return header.encode("ascii") + points.astype("<f4").tobytes()
