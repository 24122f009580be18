"""Read and write ASPRS ``.las`` and ``.laz`` with laspy."""

from __future__ import annotations

import io
import mmap
import re
import struct
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import accumulate
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from ...errors import DatasetError, requires
from ...system.budget import check_points
from ...types import Float32, Float64, Scan
from .fields import brief, require_points
from .text import Mapped

if TYPE_CHECKING:
    import laspy

_POINTWISE_CHUNKED, _LAYERED_CHUNKED = 2, 3
_SIZES = {6: 20, 7: 8, 8: 6, 9: 29, 10: 30, 11: 6, 12: 8, 13: 29}  # bytes of items by type
_BYTE10, _BYTE14 = 0, 14  # items of variable size: extra bytes
_LAYERS = {10: 9, 11: 1, 12: 2, 13: 1}  # per item; _BYTE14 has one per byte


def _check_chunks(data: Mapped, stream: BinaryIO, header: _Header, vlr: bytes) -> None:
    """Check the sizes in the chunk table and before each chunk against the file's length.

    data: the whole file
    stream: the same, to read from
    vlr: the record "laszip encoded", which defines the compression

    Raise DatasetError if they are inconsistent, or the compression is unknown.
    """
    compressor, items = _parse_vlr(vlr)
    if any(size != _SIZES.get(kind, size) for kind, size in items) or header.record_size != sum(
        size for _, size in items
    ):
        raise DatasetError("the size of compressed points differs from the header's")
    chunks = _read_chunk_table(data, stream, header, vlr)
    require_points(header.points, sum(count for count, _ in chunks))
    sizes = [size for _, size in chunks]
    if compressor == _LAYERED_CHUNKED:
        starts = accumulate(sizes, initial=header.points_start + 8)
        layers = sum(size if kind == _BYTE14 else _LAYERS.get(kind, 0) for kind, size in items)
        for start, size in zip(starts, sizes, strict=False):
            _check_layers(data, start, size, header.record_size, layers)


def _parse_vlr(vlr: bytes) -> tuple[int, list[tuple[int, int]]]:
    """Return the compressor, and type and size of the items of a point."""
    if len(vlr) < 34:
        raise DatasetError("the laszip record is cut off")
    compressor, count = struct.unpack_from("<H", vlr)[0], struct.unpack_from("<H", vlr, 32)[0]
    if compressor not in (_POINTWISE_CHUNKED, _LAYERED_CHUNKED):
        raise DatasetError(f"unknown compression of points: {compressor}")
    if len(vlr) < 34 + 6 * count:
        raise DatasetError("the laszip record is cut off")
    items = [struct.unpack_from("<HH", vlr, 34 + 6 * i) for i in range(count)]
    if any(kind not in _SIZES and kind not in (_BYTE10, _BYTE14) for kind, _ in items):
        raise DatasetError("points of unknown items")
    return compressor, items


def _read_chunk_table(
    data: Mapped, stream: BinaryIO, header: _Header, vlr: bytes
) -> list[tuple[int, int]]:
    """Return the maximum number of points and the size of each chunk."""
    import lazrs

    start = header.points_start
    if start + 8 > len(data):
        raise _cut_off(header)
    table = struct.unpack_from("<q", data, start)[0]
    if table == -1:  # written as a stream: the offset is at the end
        table = struct.unpack_from("<q", data, len(data) - 8)[0]
    room = table - start - 8
    if room < 0 or table + 8 > len(data):
        raise _cut_off(header)
    if struct.unpack_from("<I", data, table + 4)[0] * header.record_size > room:
        raise DatasetError("more compressed chunks declared than fit the file")
    stream.seek(start)
    chunks: list[tuple[int, int]] = lazrs.read_chunk_table(stream, lazrs.LazVlr(vlr))
    if sum(size for _, size in chunks) > room:
        raise DatasetError("the compressed chunks are larger than the file")
    return chunks


def _cut_off(header: _Header) -> DatasetError:
    return DatasetError(
        f"the header promises {header.points} points, the file ends before the last: copy it again"
    )


def _check_layers(data: Mapped, start: int, size: int, record_size: int, layers: int) -> None:
    """Check a chunk: its first point, the number of points, the layers' sizes, the layers."""
    head = record_size + 4 + 4 * layers
    if (
        head > size
        or head + sum(struct.unpack_from(f"<{layers}I", data, start + record_size + 4)) > size
    ):
        raise DatasetError("the layers of a compressed chunk are larger than the chunk")


RESOLUTION = 0.001
"""Step of written coordinates [m]."""

_RECORD_SIZES = (20, 28, 26, 34, 57, 63, 30, 36, 38, 59, 67)  # of point formats 0 to 10
_COMPRESSED = 0x80
_RUST_PANIC = "PanicException"  # of lazrs: neither an Exception nor importable
_WKT, _GEO_KEYS = 2112, 34735
_FOOT = re.compile(rb'UNIT\s*\[\s*"([^"]*(?:foot|feet|ft)[^"]*)"', re.I)
_LINEAR_UNITS, _FEET = (3076, 4099), (9002, 9003)
"""GeoTIFF keys of horizontal and vertical units, and their codes of feet."""
_CHUNK = 1 << 18  # points decompressed at a time; the header's count is not trusted


@dataclass(frozen=True)
class _Header:
    """Values of the public header that laspy does not check."""

    points_start: int
    num_vlrs: int
    point_format: int
    record_size: int
    points: int
    compressed: bool


def parse_las(data: bytes) -> Scan:
    """Parse the points, in metres, and GPS times unless all are zero."""
    header = _parse_header(data)
    if header.points == 0:
        return Scan(np.empty((0, 3), dtype=np.float32))
    check_points(header.points)
    with _reading(data, io.BytesIO(data), header) as reader:
        points, times = _read_points(reader, header.points)
    return Scan(points, times=times)


def las_parts(path: Path, size: int) -> Iterator[Float64]:
    """Read the points of a file of any length, (N, 3) float64 in metres, ``size`` at a time.

    Raise DatasetError where :func:`parse_las` does.
    """
    with _map_file(path) as (stream, data):
        header = _parse_header(data)
        if not header.points:
            return
        done = 0
        with _reading(data, stream, header) as reader:
            for chunk in reader.chunk_iterator(size):
                done += len(chunk)
                kept = _not_withheld(chunk)
                steps = np.column_stack([kept[axis] for axis in "XYZ"])
                yield steps * reader.header.scales + reader.header.offsets
        require_points(header.points, done)


def point_count(path: Path) -> int:
    """Return the number of points by the header of a file."""
    with _map_file(path) as (_, data):
        return _parse_header(data).points


@contextmanager
def _map_file(path: Path) -> Iterator[tuple[BinaryIO, mmap.mmap]]:
    """Open a file, and map it into memory."""
    if not path.stat().st_size:  # cannot be mapped
        raise DatasetError("not a LAS file")
    with (
        path.open("rb") as stream,
        mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as data,
    ):
        yield stream, data


@contextmanager
def _reading(data: Mapped, stream: BinaryIO, header: _Header) -> Iterator[laspy.LasReader]:
    """Open the points of a file whose header is checked; its compressed chunks are, too.

    Faults of laspy and lazrs are DatasetErrors.
    """
    laspy = import_laspy("reading .las and .laz files")
    stream.seek(0)
    try:
        with (
            np.errstate(all="ignore"),
            laspy.open(
                stream, read_evlrs=False, closefd=False, laz_backend=laspy.LazBackend.Lazrs
            ) as reader,
        ):
            _require_metres(reader.header.vlrs)
            if header.compressed:
                vlr = reader.header.vlrs.get("LasZipVlr")[0].record_data
                place = stream.tell()
                _check_chunks(data, stream, header, vlr)
                stream.seek(place)
            yield reader
    except DatasetError:
        raise
    except BaseException as error:  # damaged bytes raise many kinds
        if isinstance(error, MemoryError):
            raise
        if not (isinstance(error, Exception) or type(error).__name__ == _RUST_PANIC):
            raise
        raise DatasetError(
            f"cannot decode the {header.points} points that the header promises "
            f"({brief(error)}): copy the file again"
        ) from error


def import_laspy(purpose: str) -> Any:
    """Return laspy, with support for compressed files."""
    with requires("laspy[lazrs]", "io", purpose):
        import laspy
        import lazrs  # noqa: F401
    return laspy


def _parse_header(data: Mapped) -> _Header:
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
        raise DatasetError("the header is cut off or corrupt: copy the file again")
    if header.point_format >= len(_RECORD_SIZES):
        raise DatasetError(f"unknown point format {header.point_format}")
    if header.record_size < _RECORD_SIZES[header.point_format]:
        raise DatasetError(f"point records of {header.record_size} bytes are too short")
    if not header.compressed:
        require_points(header.points, (file_size - header.points_start) // header.record_size)


def _read_points(reader: laspy.LasReader, count: int) -> tuple[Float32, Float64 | None]:
    """Return the points, (count, 3), and GPS times unless all are zero."""
    header = reader.header
    timed = "gps_time" in header.point_format.dimension_names
    points = np.empty((count, 3), dtype=np.float32)
    times = np.empty(count) if timed else None
    done = last = 0
    for chunk in reader.chunk_iterator(_CHUNK):
        kept = _not_withheld(chunk)
        rows = slice(last, last + len(kept))
        for i, axis in enumerate("XYZ"):
            points[rows, i] = kept[axis] * header.scales[i] + header.offsets[i]
        if times is not None:
            times[rows] = kept["gps_time"]
        done, last = done + len(chunk), last + len(kept)
    require_points(count, done)
    # Most point formats have a time field even if the writer knew no time.
    return points[:last], times[:last] if times is not None and times[:last].any() else None


def _not_withheld(chunk: laspy.ScaleAwarePointRecord) -> NDArray[Any]:
    """Return the points that are not withheld, that is deleted (LAS 1.4 R15, section 2.6)."""
    deleted = np.asarray(chunk["withheld"], dtype=bool)
    points: NDArray[Any] = chunk.array
    return points[~deleted] if deleted.any() else points


def _require_metres(vlrs: Sequence[laspy.VLR]) -> None:
    """Refuse a file whose coordinate system is in feet, by its WKT or GeoTIFF keys."""
    for vlr in vlrs:
        if vlr.user_id != "LASF_Projection":
            continue
        data = vlr.record_data_bytes()
        if vlr.record_id == _WKT and (found := _FOOT.search(data)):
            name = found[1].decode("ascii", "replace")
        elif vlr.record_id == _GEO_KEYS:
            keys = np.frombuffer(data[: len(data) // 8 * 8], "<u2").reshape(-1, 4)[1:]
            units = keys[np.isin(keys[:, 0], _LINEAR_UNITS) & (keys[:, 1] == 0), 3]
            if not np.isin(units, _FEET).any():
                continue
            name = "foot"
        else:
            continue
        raise DatasetError(
            f"the unit of its coordinate system is {name!r}: convert it to metres, as by "
            "`las2las -target_meter` or PDAL"
        )


def format_laz(
    points: Float32 | Float64, times: Float64 | None = None, *, offset: Float64 | None = None
) -> bytes:
    """Format a LAZ file with coordinates in steps of ``RESOLUTION``, with times if given.

    ``offset``, (3,), should lie near the points.

    Raise DatasetError if a coordinate exceeds 32 bits of such steps, about 2147 km from the offset.
    """
    laspy = import_laspy("writing .laz files")
    origin = np.zeros(3) if offset is None else offset
    steps = np.rint((points.astype(np.float64) - origin) / RESOLUTION)
    if np.abs(steps).max(initial=0) > np.iinfo(np.int32).max:
        raise DatasetError("coordinates more than 2147 km from the offset do not fit a .laz file")
    header = laspy.LasHeader(version="1.2", point_format=0 if times is None else 1)
    header.scales = np.full(3, RESOLUTION)
    header.offsets = origin
    header.creation_date = None  # reproducible bytes
    las = laspy.LasData(header)
    las.X, las.Y, las.Z = steps.astype(np.int32).T
    if times is not None:
        las.gps_time = times
    buffer = io.BytesIO()
    las.write(buffer, do_compress=True, laz_backend=laspy.LazBackend.Lazrs)
    return buffer.getvalue()
