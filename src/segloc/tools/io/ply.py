"""Read and write Stanford's ``.ply``: ASCII and binary of either byte order."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...errors import DatasetError
from ...system.budget import check_points
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

_TYPES = {
    "char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4",
    "float": "f4", "double": "f8",
    "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4",
    "float32": "f4", "float64": "f8",
}  # fmt: skip
_ODD_ROWS = 256  # rows measured one by one if lengths vary
_ALIKE_ROWS = 1 << 16
_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}


@dataclass(frozen=True)
class _Property:
    name: str
    type: str
    length_type: str | None = None
    """Type of the length before the values, if the property is a list."""


@dataclass
class _Element:
    name: str
    count: int
    properties: list[_Property] = field(default_factory=list)

    @property
    def has_lists(self) -> bool:
        return any(prop.length_type for prop in self.properties)

    @property
    def stride(self) -> int:
        """Bytes per row without lists."""
        return sum(np.dtype(prop.type).itemsize for prop in self.properties)

    def places(self, wanted: list[int], order: str) -> list[tuple[np.dtype[Any], int]]:
        """Return type and offset of properties in a row without lists."""
        dtypes = [np.dtype(order + prop.type) for prop in self.properties]
        return [(dtypes[k], sum(dtype.itemsize for dtype in dtypes[:k])) for k in wanted]


def parse_ply(data: bytes) -> Scan:
    """Parse the vertices; other elements may hold anything, including lists."""
    vertex, columns = _parse(data)
    last = vertex.properties[wanted_columns(_single(vertex))[-1]]
    is_integer = last.type[0] in "iu"  # columns may have lost it
    return scan_from_columns(columns, time_name=last.name, integer_times=is_integer)


def parse_coordinates(data: bytes) -> list[NDArray[Any]]:
    """Return the columns x, y and z of the vertices as they are stored."""
    return _parse(data)[1][:3]


def _parse(data: bytes) -> tuple[_Element, list[NDArray[Any]]]:
    """Return the element of the vertices, and its wanted columns."""
    order, elements, start = _parse_header(data)
    names = [element.name for element in elements]
    if names.count("vertex") != 1:
        raise DatasetError(f"{names.count('vertex')} vertex elements, must be 1")
    before, vertex = elements[: names.index("vertex")], elements[names.index("vertex")]
    check_points(vertex.count, "vertices")
    if order == "":
        return vertex, _parse_ascii(data[start:], before, vertex)
    for element in before:
        start = _skip(data, start, element, order)
    return vertex, _parse_binary(data, start, vertex, order)


def point_layout(head: bytes) -> PointLayout | None:
    """Return the layout of coordinates by a file's first bytes; None if it varies by row."""
    order, elements, start = _parse_header(head)
    vertex = elements[0] if elements else None
    if vertex is None or vertex.name != "vertex" or vertex.has_lists:
        return None
    wanted = wanted_columns(_single(vertex))[:3]
    if not order:
        width = len(vertex.properties)
        return PointLayout(vertex.count, start, tuple(wanted), stride=width, text=True)
    dtypes, columns = zip(*vertex.places(wanted, order), strict=True)
    return PointLayout(vertex.count, start, columns, dtypes, vertex.stride)


def point_count(head: bytes) -> int:
    """Return the number of vertices by a file's first bytes."""
    _, elements, _ = _parse_header(head)
    return sum(element.count for element in elements if element.name == "vertex")


def field_names(head: bytes) -> list[str]:
    """Return the names of the properties of a vertex by a file's first bytes."""
    _, elements, _ = _parse_header(head)
    vertices = (element for element in elements if element.name == "vertex")
    return [prop.name for element in vertices for prop in element.properties]


def _parse_header(data: bytes) -> tuple[str, list[_Element], int]:
    lines = header_lines(data)
    if next(lines, ([], 0))[0] != ["ply"]:
        raise DatasetError("not a PLY file: the first line is not 'ply'")
    order: str | None = None
    elements: list[_Element] = []
    for words, start in lines:
        if words[:1] == ["format"] and len(words) > 1:
            order = _ORDERS.get(words[1])
        elif words[:1] == ["element"] and len(words) == 3:
            elements.append(_Element(words[1], parse_count(words[2], f"count of {words[1]}")))
        elif words[:1] == ["property"] and elements:
            elements[-1].properties.append(_parse_property(words))
        elif words == ["end_header"]:
            if order is None:
                raise DatasetError("the header declares no known format")
            return order, elements, start
        elif words and words[0] not in ("comment", "obj_info"):
            raise DatasetError(f"unknown line in the header: {' '.join(words)[:60]!r}")
    raise DatasetError("the header has no end_header line")


def _parse_property(words: list[str]) -> _Property:
    is_list = words[1:2] == ["list"]
    types = words[2:4] if is_list else words[1:2]
    codes = [_TYPES.get(word) for word in types]
    if len(words) != (5 if is_list else 3) or None in codes:
        raise DatasetError(f"unknown property: {' '.join(words)[:60]!r}")
    if len(codes) == 1:
        return _Property(words[-1], str(codes[0]))
    if codes[0] in ("f4", "f8"):
        raise DatasetError(f"the length of list {words[-1]} is not an integer")
    return _Property(words[-1], str(codes[1]), codes[0])


def _parse_ascii(data: bytes, before: list[_Element], vertex: _Element) -> list[NDArray[Any]]:
    names = _single(vertex)
    columns = wanted_columns(names)
    lists = [k for k, prop in enumerate(vertex.properties) if prop.length_type]
    if lists and lists[0] < max(columns):
        name = vertex.properties[lists[0]].name
        raise DatasetError(f"list {name} comes before x, y, z or the time of a vertex")
    table = parse_table(
        data,
        columns=columns,
        width=None if lists else len(names),
        rows=vertex.count,
        skipped=sum(element.count for element in before),
        more=True,
    )
    return list(table.T)


def _single(element: _Element) -> list[str]:
    """Return the names of properties, "" for lists, which are no coordinates."""
    return ["" if prop.length_type else prop.name for prop in element.properties]


def _parse_binary(data: bytes, start: int, vertex: _Element, order: str) -> list[NDArray[Any]]:
    wanted = wanted_columns(_single(vertex))
    if vertex.has_lists:
        return _parse_with_lists(data, start, vertex, order, wanted)
    require_bytes(len(data) - start, vertex.count * vertex.stride, f"{vertex.count} vertices")
    return [
        column(data, dtype, vertex.count, start + at, vertex.stride)
        for dtype, at in vertex.places(wanted, order)
    ]


def _parse_with_lists(
    data: bytes, start: int, vertex: _Element, order: str, wanted: list[int]
) -> list[NDArray[Any]]:
    """Parse vertices of variable size, with lists beside coordinates."""
    row, properties = _Row(vertex, order), vertex.properties
    fixed = not any(prop.length_type for prop in properties[: max(wanted)])
    places, offsets = [np.empty(0, np.int64)], [np.empty((0, len(wanted)), np.int64)]
    for place, rows, size in _runs(data, start, vertex, order):
        places.append(np.arange(place, place + rows * size, size))
        if not (fixed and len(offsets) > 1):
            chosen = np.array(row.offsets(data, place))[wanted]
        offsets.append(np.broadcast_to(chosen, (rows, len(wanted))))
    at = np.concatenate(places)[:, None] + np.concatenate(offsets)
    content = np.frombuffer(data, np.uint8)
    columns = []
    for k, position in enumerate(wanted):
        dtype = np.dtype(order + properties[position].type)
        columns.append(content[at[:, k, None] + np.arange(dtype.itemsize)].view(dtype)[:, 0])
    return columns


def _skip(data: bytes, start: int, element: _Element, order: str) -> int:
    """Return the end of an element's rows."""
    if not element.has_lists:
        what = f"{element.count} rows of {element.name}"
        require_bytes(len(data) - start, element.count * element.stride, what)
        return start + element.count * element.stride
    for place, rows, size in _runs(data, start, element, order):
        start = place + rows * size
    return start


def _runs(data: bytes, start: int, element: _Element, order: str) -> Iterator[tuple[int, int, int]]:
    """Yield offset, number and size of successive rows with lists of equal lengths."""
    what = f"{element.count} rows of {element.name}"
    check_points(element.count, f"rows of {element.name}")
    # Each row has at least the byte of a list's length, which bounds the loop.
    require_bytes(len(data) - start, element.count, what)
    row = _Row(element, order)
    done = 0
    while done < element.count:
        size = row.size(data, start, what)
        alike = row.alike(data, start, size, element.count - done)
        require_bytes(len(data) - start, alike * size, what)
        yield start, alike, size
        done, start = done + alike, start + alike * size
        for _ in range(min(_ODD_ROWS if alike < _ODD_ROWS else 0, element.count - done)):
            size = row.size(data, start, what)
            require_bytes(len(data) - start, size, what)
            yield start, 1, size
            done, start = done + 1, start + size


class _Row:
    """Measure rows with lists, whose sizes depend on their content."""

    def __init__(self, element: _Element, order: str) -> None:
        self._properties = element.properties
        self._parts: list[tuple[int, struct.Struct | None, int]] = []
        """Bytes before a list, its length type, and bytes per value."""
        before = 0
        for prop in element.properties:
            size = np.dtype(prop.type).itemsize
            if prop.length_type:
                length = struct.Struct(order + np.dtype(prop.length_type).char)
                self._parts.append((before, length, size))
                before = 0
            else:
                before += size
        self._parts.append((before, None, 0))

    def size(self, data: bytes, start: int, what: str) -> int:
        """Return the size of the row at ``start``."""
        place = start
        for before, length, size in self._parts:
            place += before
            if length is not None:
                try:
                    (count,) = length.unpack_from(data, place)
                except struct.error:
                    raise DatasetError(f"{what} are cut off") from None
                if count < 0:
                    raise DatasetError(f"a list of length {count}")
                place += length.size + count * size
        return place - start

    def offsets(self, data: bytes, start: int) -> list[int]:
        """Return the offset of each property in the row at ``start``."""
        place, found = start, []
        lists = iter([(length, size) for _, length, size in self._parts if length is not None])
        for prop in self._properties:
            found.append(place - start)
            if prop.length_type:
                length, size = next(lists)
                place += length.size + length.unpack_from(data, place)[0] * size
            else:
                place += np.dtype(prop.type).itemsize
        return found

    def alike(self, data: bytes, start: int, size: int, most: int) -> int:
        """Count rows from ``start`` on with lists of equal lengths, as in most meshes."""
        count = max(1, min(most, (len(data) - start) // size))
        rows = min(count, _ALIKE_ROWS)
        same = np.ones(rows, dtype=bool)
        place = start
        for before, length, value in self._parts:
            place += before
            if length is not None and rows > 1:
                (first,) = length.unpack_from(data, place)
                same &= column(data, length.format, rows, place, size) == first
                place += length.size + first * value
        return rows if same.all() else max(1, int(same.argmin()))


def format_ply(points: Float32) -> bytes:
    """Format a binary little-endian PLY with float x, y, z."""
    header = (
        f"ply\nformat binary_little_endian 1.0\nelement vertex {len(points)}\n"
        "property float x\nproperty float y\nproperty float z\nend_header\n"
    )
    return header.encode("ascii") + points.astype("<f4").tobytes()
