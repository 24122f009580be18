"""What must hold of a compressed LAS file before it may be handed to the decompressor.

The decompressor takes memory for whatever number a chunk table or a layer names, and ends the
process where there is not enough.
"""

from __future__ import annotations

import io
import struct
from itertools import accumulate

from ..errors import DatasetError

_POINTWISE_CHUNKED, _LAYERED_CHUNKED = 2, 3
_SIZES = {6: 20, 7: 8, 8: 6, 9: 29, 10: 30, 11: 6, 12: 8, 13: 29}  # of items, by their type
_BYTE10, _BYTE14 = 0, 14  # items of any size: extra bytes
_LAYERS = {10: 9, 11: 1, 12: 2, 13: 1}  # of items; _BYTE14 has one for each byte


def check_chunks(data: bytes, points_start: int, points: int, record_size: int, vlr: bytes) -> None:
    """Check the sizes in the chunk table and in front of each chunk against the file's length.

    Parameters
    ----------
    data : bytes
        The whole file.
    points_start : int
        Where the points start, at most ``len(data)``.
    points : int
        How many the header announces.
    record_size : int
        Bytes of a point.
    vlr : bytes
        The record "laszip encoded", which says how the points are compressed.

    Raises
    ------
    DatasetError
        If they do not fit, or the compression is of an unknown kind.
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
