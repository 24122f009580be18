"""ASPRS ``.las`` and ``.laz``, by laspy."""

from __future__ import annotations

import io
import struct
from dataclasses import dataclass
from itertools import accumulate
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import DatasetError, MissingDependency
from ..system.budget import check_points
from ..types import Float32, Float64, Scan
from .fields import one_line

if TYPE_CHECKING:
    import laspy

_POINTWISE_CHUNKED, _LAYERED_CHUNKED = 2, 3
_SIZES = {6: 20, 7: 8, 8: 6, 9: 29, 10: 30, 11: 6, 12: 8, 13: 29}  # of items, by their type
_BYTE10, _BYTE14 = 0, 14  # items of any size: extra bytes
_LAYERS = {10: 9, 11: 1, 12: 2, 13: 1}  # of items; _BYTE14 has one for each byte


def check_chunks(data: bytes, points_start: int, points: int, record_size: int, vlr: bytes) -> None:
    """Check the sizes in the chunk table and in front of each chunk against the file's length.

    data: the whole file
    points_start: where the points start, at most ``len(data)``
    points: how many the header announces
    record_size: bytes of a point
    vlr: the record "laszip encoded", which says how the points are compressed

    Raise DatasetError if they do not fit, or the compression is of an unknown kind.
    """
    compressor, items = _parse_vlr(vlr)
    if any(size != _SIZES.get(kind, size) for kind, size in items) or record_size != sum(
        size for _, size in items
    ):
        raise DatasetError("the compressed points have another size than the header says")
    chunks = _read_chunk_table(data, points_start, record_size, vlr)
    if sum(count for count, _ in chunks) < points:
        raise DatasetError(f"the compressed chunks hold fewer than {points} points")
    sizes = [size for _, size in chunks]
    if compressor == _LAYERED_CHUNKED:
        starts = accumulate(sizes, initial=points_start + 8)
        layers = sum(size if kind == _BYTE14 else _LAYERS.get(kind, 0) for kind, size in items)
        for start, size in zip(starts, sizes, strict=False):
            _check_layers(data, start, size, record_size, layers)


def _parse_vlr(vlr: bytes) -> tuple[int, list[tuple[int, int]]]:
    """The kind of compressor, and type and size of the items of a point."""
    if len(vlr) < 34:
        raise DatasetError("the laszip record is cut off")
    compressor, count = struct.unpack_from("<H", vlr)[0], struct.unpack_from("<H", vlr, 32)[0]
    if compressor not in (_POINTWISE_CHUNKED, _LAYERED_CHUNKED):
        raise DatasetError(f"points are compressed in the unknown way {compressor}")
    if len(vlr) < 34 + 6 * count:
        raise DatasetError("the laszip record is cut off")
    items = [struct.unpack_from("<HH", vlr, 34 + 6 * i) for i in range(count)]
    if any(kind not in _SIZES and kind not in (_BYTE10, _BYTE14) for kind, _ in items):
        raise DatasetError("points are made of unknown items")
    return compressor, items


def _read_chunk_table(
    data: bytes, points_start: int, record_size: int, vlr: bytes
) -> list[tuple[int, int]]:
    """The most points and the number of bytes of each chunk."""
    import lazrs

    if points_start + 8 > len(data):
        raise DatasetError("the compressed points are cut off")
    table = struct.unpack_from("<q", data, points_start)[0]
    if table == -1:  # written as a stream: the offset stands at the end
        table = struct.unpack_from("<q", data, len(data) - 8)[0]
    room = table - points_start - 8
    if room < 0 or table + 8 > len(data):
        raise DatasetError("the table of compressed chunks is cut off")
    if struct.unpack_from("<I", data, table + 4)[0] * record_size > room:
        raise DatasetError("more compressed chunks are announced than fit")
    source = io.BytesIO(data)
    source.seek(points_start)
    chunks: list[tuple[int, int]] = lazrs.read_chunk_table(source, lazrs.LazVlr(vlr))
    if sum(size for _, size in chunks) > room:
        raise DatasetError("the compressed chunks are larger than the file")
    return chunks


def _check_layers(data: bytes, start: int, size: int, record_size: int, layers: int) -> None:
    """A chunk is its first point, the number of points, the layers' sizes, then the layers."""
    head = record_size + 4 + 4 * layers
    if (
        head > size
        or head + sum(struct.unpack_from(f"<{layers}I", data, start + record_size + 4)) > size
    ):
        raise DatasetError("the layers of a compressed chunk are larger than the chunk")


RESOLUTION = 0.001
"""Metres to which written coordinates are rounded."""

_RECORD_SIZES = (20, 28, 26, 34, 57, 63, 30, 36, 38, 59, 67)  # of point formats 0 to 10
_COMPRESSED = 0x80
_RUST_PANIC = "PanicException"  # of lazrs: no Exception, and no class that could be imported
_CHUNK = 1 << 18  # points decompressed at a time: no header's count is believed


@dataclass(frozen=True)
class _Header:
    """The part of the public header that laspy takes on trust."""

    points_start: int
    num_vlrs: int
    point_format: int
    record_size: int
    points: int
    compressed: bool


def parse_las(data: bytes) -> Scan:
    """The points, scaled to metres, and GPS times where any is not zero."""
    header = _parse_header(data)
    if header.points == 0:
        return Scan(np.empty((0, 3), dtype=np.float32))
    check_points(header.points)
    laspy = import_laspy("reading .las and .laz files")
    try:
        with (
            np.errstate(all="ignore"),
            laspy.open(
                io.BytesIO(data), read_evlrs=False, laz_backend=laspy.LazBackend.Lazrs
            ) as reader,
        ):
            if header.compressed:
                vlr = reader.header.vlrs.get("LasZipVlr")[0].record_data
                check_chunks(data, header.points_start, header.points, header.record_size, vlr)
            points, times = _read_points(reader, header.points)
    except DatasetError:
        raise
    except BaseException as error:  # many kinds come through where bytes are wrong
        if isinstance(error, MemoryError):
            raise
        if not (isinstance(error, Exception) or type(error).__name__ == _RUST_PANIC):
            raise
        raise DatasetError(f"cannot decode the points: {one_line(error)}") from error
    return Scan(points, times=times)


def import_laspy(purpose: str) -> Any:
    """laspy, if it can read compressed files."""
    try:
        import laspy
        import lazrs  # noqa: F401
    except ImportError as error:
        raise MissingDependency("laspy[lazrs]", "io", purpose) from error
    return laspy


def _parse_header(data: bytes) -> _Header:
    if len(data) < 227 or data[:4] != b"LASF":
        raise DatasetError("not a LAS file")
    minor = data[25]
    header_size, points_start, num_vlrs = struct.unpack_from("<HII", data, 94)
    format_byte, record_size, points = struct.unpack_from("<BHI", data, 104)
    if data[24] != 1 or minor > 4 or header_size < (375 if minor == 4 else 227):
        raise DatasetError(f"not a LAS file of version 1.0 to 1.4: {data[24]}.{minor}")
    if minor == 4 and len(data) >= 375:
        points = struct.unpack_from("<Q", data, 247)[0] or points
    header = _Header(
        points_start, num_vlrs, format_byte & 0x3F, record_size, points, format_byte >= _COMPRESSED
    )
    _check_header(header, header_size, len(data))
    return header


def _check_header(header: _Header, header_size: int, file_size: int) -> None:
    if not header_size + 54 * header.num_vlrs <= header.points_start <= file_size:
        raise DatasetError("the header is cut off or corrupt")
    if header.point_format >= len(_RECORD_SIZES):
        raise DatasetError(f"unknown point format {header.point_format}")
    if header.record_size < _RECORD_SIZES[header.point_format]:
        raise DatasetError(f"point records of {header.record_size} bytes are too short")
    needed = header.points * header.record_size
    if not header.compressed and needed > file_size - header.points_start:
        raise DatasetError(f"{header.points} points need {needed} bytes; the file is cut off")


def _read_points(reader: laspy.LasReader, count: int) -> tuple[Float32, Float64 | None]:
    """The points, (count, 3), and the GPS times where any is not zero."""
    header = reader.header
    timed = "gps_time" in header.point_format.dimension_names
    points = np.empty((count, 3), dtype=np.float32)
    times = np.empty(count) if timed else None
    done = 0
    for chunk in reader.chunk_iterator(_CHUNK):
        rows = slice(done, done + len(chunk))
        for i, axis in enumerate("XYZ"):
            points[rows, i] = chunk.array[axis] * header.scales[i] + header.offsets[i]
        if times is not None:
            times[rows] = chunk.array["gps_time"]
        done += len(chunk)
    if done != count:
        raise DatasetError(f"{count} points announced, {done} found")
    # Most point formats have room for a time whether or not the writer knew one.
    return points, times if times is not None and times.any() else None


def format_laz(
    points: Float32 | Float64, times: Float64 | None = None, *, offset: Float64 | None = None
) -> bytes:
    """A LAZ file with coordinates in steps of ``RESOLUTION``, of a format with times if needed.

    ``offset``, (3,), is near points that lie far from zero, so that their steps are few.

    Raise DatasetError if a coordinate is beyond what 32 bits of such steps can hold, about 2147 km
    from there.
    """
    laspy = import_laspy("writing .laz files")
    origin = np.zeros(3) if offset is None else offset
    steps = np.rint((points.astype(np.float64) - origin) / RESOLUTION)
    if np.abs(steps).max(initial=0) > np.iinfo(np.int32).max:
        raise DatasetError("coordinates beyond 2147 km do not fit a .laz file")
    header = laspy.LasHeader(version="1.2", point_format=0 if times is None else 1)
    header.scales = np.full(3, RESOLUTION)
    header.offsets = origin
    header.creation_date = None  # the same points make the same bytes
    las = laspy.LasData(header)
    las.X, las.Y, las.Z = steps.astype(np.int32).T
    if times is not None:
        las.gps_time = times
    buffer = io.BytesIO()
    las.write(buffer, do_compress=True, laz_backend=laspy.LazBackend.Lazrs)
    return buffer.getvalue()
