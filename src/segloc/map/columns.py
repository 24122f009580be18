"""Columns of whole numbers, packed: differences of rows, one plane for each byte, deflated."""

from __future__ import annotations

import zlib
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..types import Int64

WIDTHS = (1, 2, 4, 8)
"""Bytes that a number may take."""


class CodingError(Exception):
    """What was packed does not unpack to what it should; one line."""


def width_of(codes: Int64) -> int:
    """The bytes that numbers need that are not negative."""
    most = int(codes.max(initial=0))
    return next(width for width in WIDTHS if most < 1 << (8 * width - (width == 8)))


def packed(codes: Int64, width: int) -> bytes:
    """(P, C) numbers of so many bytes."""
    numbers = codes.astype(_unsigned(width))
    steps = np.diff(numbers, axis=0, prepend=numbers.dtype.type(0)).view(_signed(width))
    bits = 8 * width - 1
    zigzag = ((steps << 1) ^ (steps >> bits)).view(_unsigned(width))  # small ones, whatever sign
    planes = zigzag.reshape(-1, 1).view(np.uint8).T
    return deflated(planes.tobytes())


def unpacked(data: bytes, rows: int, columns: int, width: int) -> NDArray[Any]:
    """The (rows, columns) unsigned numbers of :func:`packed`.

    Raises
    ------
    CodingError
        If the data do not unpack to so many.
    """
    planes = np.frombuffer(inflated(data, rows * columns * width), np.uint8)
    zigzag = planes.reshape(width, -1).T.copy().view(_unsigned(width)).reshape(rows, columns)
    one = zigzag.dtype.type(1)
    steps = (zigzag >> one) ^ (np.zeros_like(one) - (zigzag & one))
    return np.cumsum(steps, axis=0, dtype=zigzag.dtype)


def deflated(data: bytes) -> bytes:
    """The shorter of two ways to deflate bytes."""
    ways = []
    for strategy in (zlib.Z_DEFAULT_STRATEGY, zlib.Z_FILTERED):
        packer = zlib.compressobj(9, strategy=strategy)
        ways.append(packer.compress(data) + packer.flush())
    return min(ways, key=len)


def inflated(data: bytes, size: int) -> bytes:
    """So many bytes, inflated; never more, whatever the data claim.

    Raises
    ------
    CodingError
    """
    unpacker = zlib.decompressobj()
    try:
        found = unpacker.decompress(data, size + 1)
    except zlib.error as error:
        raise CodingError("it cannot be inflated") from error
    if len(found) != size or not unpacker.eof or unpacker.unused_data:
        raise CodingError(f"it does not inflate to {size} bytes")
    return found


def _unsigned(width: int) -> np.dtype[Any]:
    return np.dtype(f"<u{width}")


def _signed(width: int) -> np.dtype[Any]:
    return np.dtype(f"<i{width}")
