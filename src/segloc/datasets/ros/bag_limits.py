"""Limits on what chunks and messages of bags unpack to; the package rosbags has none."""

from __future__ import annotations

import bz2
import re
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Protocol

from ...budget import check_bytes, most_message_bytes
from ...errors import DatasetError

if TYPE_CHECKING:
    from rosbags.highlevel import AnyReader

MOST_METADATA_BYTES = 1 << 20
"""Of a ROS 2 bag's metadata.yaml, and of what it says of a topic's quality of service."""
_DEEPEST = 64


_BRACKETS = re.compile(r"[\[\]{}]")


class _Decompressor(Protocol):
    def decompress(self, data: bytes, max_length: int = -1) -> bytes: ...


def unpacked(decompressor: _Decompressor, data: bytes, size: int | None = None) -> bytes:
    """What compressed data hold, at most ``size`` bytes where that is known.

    Raises
    ------
    DatasetError
        If it is more than that, or than a message may have.
    """
    limit = most_message_bytes()
    if size is not None:
        check_bytes(size, "a chunk", limit)
    most = limit if size is None else size
    unpacked = decompressor.decompress(data, most + 1)
    if len(unpacked) > most:
        if size is None:
            check_bytes(len(unpacked), "a chunk or message", limit)
        raise DatasetError(f"a chunk holds more than the {size} bytes that it announces")
    return unpacked


def _lz4() -> _Decompressor:
    from lz4.frame import LZ4FrameDecompressor

    decompressor: _Decompressor = LZ4FrameDecompressor()
    return decompressor


def unpack_bz2(data: bytes) -> bytes:
    """In place of rosbags' own for chunks of ROS 1 bags."""
    return unpacked(bz2.BZ2Decompressor(), data)


def unpack_lz4(data: bytes) -> bytes:
    """In place of rosbags' own for chunks of ROS 1 bags."""
    return unpacked(_lz4(), data)


class _Zstd:
    """The module of zstd as rosbags sees it, but for :func:`decompress`."""

    def __init__(self, module: Any) -> None:
        self._module = module

    def __getattr__(self, name: str) -> Any:
        return getattr(self._module, name)

    def decompress(self, data: bytes) -> bytes:
        return unpacked(self._module.ZstdDecompressor(), data)


def check_metadata(text: str, what: str) -> None:
    """Refuse YAML that takes its parser minutes: long, or nested deep.

    Raises
    ------
    DatasetError
    """
    check_bytes(len(text), what, MOST_METADATA_BYTES)
    deepest = max((len(line) - len(line.lstrip(" -?")) for line in text.splitlines()), default=0)
    depth = 0
    for mark in _BRACKETS.findall(text):
        depth += 1 if mark in "[{" else -1
        deepest = max(deepest, depth)
    if deepest > _DEEPEST:
        raise DatasetError(f"{what} is nested deeper than {_DEEPEST} levels")


def _limited(parse_qos: Callable[[Any], Any]) -> Callable[[Any], Any]:
    def limited(profiles: Any) -> Any:
        if isinstance(profiles, str):
            check_metadata(profiles, "the quality of service of a topic")
        return parse_qos(profiles)

    return limited


def limit_rosbags() -> None:
    """Put limited functions into the modules of rosbags; it has no setting for them."""
    from rosbags.rosbag2 import reader, storage_mcap, storage_sqlite3

    if isinstance(reader.zstd, _Zstd):
        return
    for module in (reader, storage_mcap, storage_sqlite3):
        module.parse_qos = _limited(module.parse_qos)
    zstd = reader.zstd
    storage_mcap.DECOMPRESSORS.update(
        lz4=lambda data, size: unpacked(_lz4(), data, size),
        zstd=lambda data, size: unpacked(zstd.ZstdDecompressor(), data, size),
    )
    reader.zstd = _Zstd(zstd)


def limit_chunks(reader: AnyReader) -> None:
    """Let an opened ROS 1 bag unpack its chunks within the limit."""
    from rosbags.rosbag1.reader import Compression, decompressors

    ours = {
        decompressors[Compression.BZ2.value]: unpack_bz2,
        decompressors[Compression.LZ4.value]: unpack_lz4,
    }
    for bag in () if reader.is2 else reader.readers:
        for place, chunk in bag.chunks.items():
            if chunk.decompressor in ours:
                bag.chunks[place] = chunk._replace(decompressor=ours[chunk.decompressor])
