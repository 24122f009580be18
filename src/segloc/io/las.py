"""ASPRS ``.las`` and ``.laz``, by laspy."""

from __future__ import annotations

import io
import struct
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import DatasetError, MissingDependency
from ..system.budget import check_points
from ..types import Float32, Float64, Scan
from .fields import one_line
from .laz import check_chunks

if TYPE_CHECKING:
    import laspy

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
    laspy = _import_laspy("reading .las and .laz files")
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


def _import_laspy(purpose: str) -> Any:
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

    Raises
    ------
    DatasetError
        If a coordinate is beyond what 32 bits of such steps can hold, about 2147 km from there.
    """
    laspy = _import_laspy("writing .laz files")
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
