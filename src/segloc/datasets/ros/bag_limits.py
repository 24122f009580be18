"""Limits on what chunks and messages of bags unpack to; the package rosbags has none."""

from __future__ import annotations

import bz2
import os
import re
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, BinaryIO, Protocol

from ...errors import DatasetError
from ...system.budget import check_bytes, check_points, most_bytes, most_message_bytes

if TYPE_CHECKING:
    from rosbags.highlevel import AnyReader

MOST_METADATA_BYTES = 1 << 20
"""Of a ROS 2 bag's metadata.yaml, and of what it says of a topic's quality of service."""
MOST_GROWTH = 32
"""Of a file of a bag that is compressed whole; clouds shrink to a half or a third."""
_DEEPEST = 64
_INDEX_ENTRY_BYTES = 12  # ROS 1


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


class _LimitedFile:
    """A compressed file as it is read, up to a number of bytes."""

    def __init__(self, file: BinaryIO, limit: int) -> None:
        self._file, self._limit, self._count = file, limit, 0

    def __enter__(self) -> _LimitedFile:
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()

    def read(self, size: int = -1) -> bytes:
        data = self._file.read(min(size, self._limit + 1) if size >= 0 else self._limit + 1)
        self._count += len(data)
        if self._count > self._limit:
            check_bytes(self._count, "a compressed file with upwards", self._limit)
        return data


class _Zstd:
    """The module of zstd as rosbags sees it, but for what unpacks."""

    def __init__(self, module: Any) -> None:
        self._module = module

    def __getattr__(self, name: str) -> Any:
        return getattr(self._module, name)

    def decompress(self, data: bytes) -> bytes:
        return unpacked(self._module.ZstdDecompressor(), data)

    def open(self, file: BinaryIO, mode: str) -> _LimitedFile:
        """A file to unpack: a recording has no most points, so what it may hold is of its size."""
        limit = max(most_bytes(), MOST_GROWTH * os.fstat(file.fileno()).st_size)
        return _LimitedFile(self._module.open(file, mode), limit)


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


def _counted(read_index: Callable[..., None]) -> Callable[..., None]:
    """Records of a ROS 1 bag's index, each read once: chunks may name the same ones."""

    def counted(reader: Any, place: int, indexes: dict[int, list[Any]]) -> None:
        begin = reader.bio.tell()
        read_index(reader, place, indexes)
        reader.index_bytes = getattr(reader, "index_bytes", 0) + reader.bio.tell() - begin
        if reader.index_bytes > os.fstat(reader.bio.fileno()).st_size:
            raise DatasetError("its index is longer than the file: chunks share records of it")
        check_points(reader.index_bytes // _INDEX_ENTRY_BYTES, "messages in its index")

    return counted


def limit_rosbags() -> None:
    """Put limited functions into the modules of rosbags; it has no setting for them."""
    from rosbags.rosbag1 import Reader
    from rosbags.rosbag2 import reader, storage_mcap, storage_sqlite3

    if isinstance(reader.zstd, _Zstd):
        return
    Reader.read_index_data = _counted(Reader.read_index_data)
    for module in (reader, storage_mcap, storage_sqlite3):
        module.parse_qos = _limited(module.parse_qos)
    zstd = reader.zstd
    storage_mcap.DECOMPRESSORS.update(
        lz4=lambda data, size: unpacked(_lz4(), data, size),
        zstd=lambda data, size: unpacked(zstd.ZstdDecompressor(), data, size),
    )
    reader.zstd = _Zstd(zstd)


def limit_chunks(reader: AnyReader) -> None:
    """Let an opened ROS 1 bag unpack its chunks within the limit.

    Raises
    ------
    DatasetError
        If two of its connections have one number: each would have the messages of both.
    """
    from rosbags.rosbag1.reader import Compression, decompressors

    ours = {
        decompressors[Compression.BZ2.value]: unpack_bz2,
        decompressors[Compression.LZ4.value]: unpack_lz4,
    }
    for bag in () if reader.is2 else reader.readers:
        if len({item.id for item in bag.connections}) < len(bag.connections):
            raise DatasetError("two connections of the bag have one number")
        for place, chunk in bag.chunks.items():
            if chunk.decompressor in ours:
                bag.chunks[place] = chunk._replace(decompressor=ours[chunk.decompressor])
