"""Open bags with rosbags, within limits of memory, and report faults of bags."""

from __future__ import annotations

import bz2
import os
import re
import weakref
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

from ...errors import DatasetError, MissingDependency, SeglocError
from ...io import fields
from ...io.fields import one_line
from ...system.budget import check_bytes, check_points, most_bytes, most_message_bytes

if TYPE_CHECKING:
    from rosbags.highlevel import AnyReader

MAX_METADATA_BYTES = 1 << 20
"""Limit of a ROS 2 bag's metadata.yaml, and of a topic's quality-of-service profile in it."""
MAX_GROWTH = 32
"""Limit of the compression ratio of a bag file; clouds shrink to a half or a third."""
_MAX_DEPTH = 64
_INDEX_ENTRY_BYTES = 12  # ROS 1


_BRACKETS = re.compile(r"[\[\]{}]")


def unpacked(decompressor: Any, data: bytes, size: int | None = None) -> bytes:
    """Decompress data of at most ``size`` bytes, if given.

    Raise DatasetError if the output is larger than that, or than the limit of a message.
    """
    limit = most_message_bytes()
    if size is not None:
        check_bytes(size, "a chunk", limit)
    allowed = limit if size is None else size
    unpacked: bytes = decompressor.decompress(data, allowed + 1)
    if len(unpacked) > allowed:
        if size is None:
            check_bytes(len(unpacked), "a chunk or message", limit)
        raise DatasetError(f"a chunk holds more than its declared {size} bytes")
    return unpacked


def _lz4() -> Any:
    from lz4.frame import LZ4FrameDecompressor

    return LZ4FrameDecompressor()


class _LimitedFile:
    """Compressed file, readable up to a number of bytes."""

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
            check_bytes(self._count, "a compressed file with at least", self._limit)
        return data


class _Zstd:
    """The zstd module for rosbags, with limited decompression."""

    def __init__(self, module: Any) -> None:
        self._module = module

    def __getattr__(self, name: str) -> Any:
        return getattr(self._module, name)

    def decompress(self, data: bytes) -> bytes:
        return unpacked(self._module.ZstdDecompressor(), data)

    def open(self, file: BinaryIO, mode: str) -> _LimitedFile:
        """Open a compressed file; the limit grows with its size, as recordings may be long."""
        limit = max(most_bytes(), MAX_GROWTH * os.fstat(file.fileno()).st_size)
        return _LimitedFile(self._module.open(file, mode), limit)


def check_metadata(text: str, what: str) -> None:
    """Reject YAML that takes minutes to parse: long or deeply nested."""
    check_bytes(len(text), what, MAX_METADATA_BYTES)
    deepest = max((len(line) - len(line.lstrip(" -?")) for line in text.splitlines()), default=0)
    depth = 0
    for mark in _BRACKETS.findall(text):
        depth += 1 if mark in "[{" else -1
        deepest = max(deepest, depth)
    if deepest > _MAX_DEPTH:
        raise DatasetError(f"{what} is nested deeper than {_MAX_DEPTH} levels")


def _limited(parse_qos: Callable[[Any], Any]) -> Callable[[Any], Any]:
    def limited(profiles: Any) -> Any:
        if isinstance(profiles, str):
            check_metadata(profiles, "the quality of service of a topic")
        return parse_qos(profiles)

    return limited


def _counted(read_index: Callable[..., None]) -> Callable[..., None]:
    """Limit the records of a ROS 1 bag's index: chunks may share records."""

    def counted(reader: Any, place: int, indexes: dict[int, list[Any]]) -> None:
        begin = reader.bio.tell()
        read_index(reader, place, indexes)
        reader.index_bytes = getattr(reader, "index_bytes", 0) + reader.bio.tell() - begin
        if reader.index_bytes > os.fstat(reader.bio.fileno()).st_size:
            raise DatasetError("the index is longer than the file: chunks share records")
        check_points(reader.index_bytes // _INDEX_ENTRY_BYTES, "messages in its index")

    return counted


def limit_rosbags() -> None:
    """Replace functions of rosbags by limited ones; it has no setting for limits."""
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
    """Make an opened ROS 1 bag decompress its chunks within the limit.

    Raise DatasetError if two of its connections share an id: each would yield the messages of
    both.
    """
    from rosbags.rosbag1.reader import Compression, decompressors

    ours = {
        decompressors[Compression.BZ2.value]: lambda data: unpacked(bz2.BZ2Decompressor(), data),
        decompressors[Compression.LZ4.value]: lambda data: unpacked(_lz4(), data),
    }
    for bag in () if reader.is2 else reader.readers:
        if len({item.id for item in bag.connections}) < len(bag.connections):
            raise DatasetError("two connections of the bag share an id")
        for place, chunk in bag.chunks.items():
            if chunk.decompressor in ours:
                bag.chunks[place] = chunk._replace(decompressor=ours[chunk.decompressor])


_MCAP = b"\x89MCAP0\r\n"
_MAGIC = {".bag": b"#ROSBAG V2.0", ".db3": b"SQLite format 3\0", ".mcap": _MCAP}
_RECOVER = "`mcap recover IN.mcap -o OUT.mcap` saves the intact part"
_DEFINITIONS = {
    "velodyne_msgs/msg/VelodynePacket": "builtin_interfaces/Time stamp\nuint8[1206] data\n",
    "velodyne_msgs/msg/VelodyneScan": (
        "std_msgs/Header header\nvelodyne_msgs/VelodynePacket[] packets\n"
    ),
}
"""Messages outside ROS's own packages, for bags without definitions."""


@contextmanager
def opened(paths: tuple[Path, ...]) -> Iterator[AnyReader]:
    """Open a bag; any error while it is open is reported as a fault of the bag.

    Raise DatasetError if it is truncated, damaged or unsupported. Raise MissingDependency if
    rosbags is not installed.
    """
    with faults_of(paths[0]):
        _check_magic(paths)
    with faults_of(paths[0]), _reader(paths) as reader:
        limit_chunks(reader)
        yield reader


def _check_magic(paths: tuple[Path, ...]) -> None:
    """Reject files that are no bags with a clear message, before the parser fails on them."""
    for path in paths:
        if not path.is_file():
            with (path / "metadata.yaml").open(encoding="utf-8", errors="replace") as text:
                check_metadata(text.read(MAX_METADATA_BYTES + 1), "metadata.yaml")
            continue
        with path.open("rb") as file:
            head = file.read(16)
        if not head:
            raise DatasetError(f"{path}: empty file")
        if not head.startswith(_MAGIC[path.suffix]):
            raise DatasetError(f"{path}: not a {path.suffix[1:]} file, by its first bytes")
        if path.suffix == ".mcap" and not _ends_whole(path):
            raise DatasetError(f"{path}: cut off, no footer: {_RECOVER}")


def _ends_whole(path: Path) -> bool:
    """Return whether an MCAP file has its footer, which a killed recorder does not write."""
    with path.open("rb") as file:
        file.seek(-min(path.stat().st_size, len(_MCAP)), os.SEEK_END)
        return file.read() == _MCAP


def remedy(path: Path, error: Exception) -> str:
    """Return the command that repairs a bag after a reader's error; "" if none is known."""
    text = str(error).lower()
    suffixes = {path.suffix} if path.is_file() else {file.suffix for file in path.glob("*.*")}
    if ".mcap" in suffixes and ("index" in text or "magic" in text or "eof" in text):
        return f": {_RECOVER}"
    if ".bag" in suffixes and ("index" in text or "connection" in text):
        return ": `rosbag reindex` repairs it"
    if ".db3" in suffixes and "malformed" in text:
        return ": `sqlite3 IN.db3 .recover | sqlite3 OUT.db3` saves the intact part"
    if ".db3" in suffixes and ("metadata" in text or "table" in text):
        return ": `ros2 bag reindex` writes the metadata"
    return ""


def _reader(paths: tuple[Path, ...]) -> AnyReader:
    try:
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_types_from_msg, get_typestore
    except ImportError as error:
        raise MissingDependency("rosbags", "ros", "reading bags") from error
    limit_rosbags()
    # Older ROS 2 bags lack the definitions of their messages.
    store = get_typestore(Stores.ROS2_HUMBLE)
    for name, text in _DEFINITIONS.items():
        store.register(get_types_from_msg(text, name))
    return AnyReader(list(paths), default_typestore=store)


@contextmanager
def faults_of(path: Path) -> Iterator[None]:
    """Report any error as a fault of the file: damaged bytes can raise anything."""
    with fields.faults_of(path):
        try:
            yield
        except (SeglocError, MemoryError):
            raise
        except Exception as error:
            raise DatasetError(
                f"unreadable as a bag: {one_line(error)}{remedy(path, error)}"
            ) from error


@contextmanager
def optional(what: str, remarks: list[str]) -> Iterator[None]:
    """Turn any error into a remark: the scans are readable without this part."""
    try:
        yield
    except MemoryError:
        raise
    except Exception as error:
        text = str(error) if isinstance(error, SeglocError) else f"{what}: {one_line(error)}"
        remarks.append(f"{text}: not used")


class BagFile:
    """Bag that each process opens on first read.

    paths: files to open
    """

    def __init__(self, paths: tuple[Path, ...]) -> None:
        self._paths = paths
        self._reader: AnyReader | None = None

    @property
    def path(self) -> Path:
        """The first file, for messages."""
        return self._paths[0]

    def reader(self) -> AnyReader:
        """Return the open reader; it is closed with this object."""
        if self._reader is None:
            reader = _reader(self._paths)
            reader.open()
            limit_chunks(reader)
            weakref.finalize(self, reader.close)
            self._reader = reader
        return self._reader

    def __getstate__(self) -> dict[str, object]:
        return {"_paths": self._paths, "_reader": None}


def seconds(time: Any) -> float:
    """Convert a builtin_interfaces/Time to seconds, rounded as stamps of headers are."""
    return float((time.sec * 10**9 + time.nanosec) * 1e-9)


def fullest_topics(reader: AnyReader, msgtype: str) -> list[str]:
    """List the topics of a type that have messages, by falling count."""
    counts: dict[str, int] = {}
    for item in reader.connections:
        if item.msgtype == msgtype and item.msgcount:
            counts[item.topic] = counts.get(item.topic, 0) + item.msgcount
    return sorted(counts, key=lambda name: (-counts[name], name))


def connections_of(reader: AnyReader, topic: str) -> list[Any]:
    """List a topic's connections. Check for an empty list: rosbags takes it as all messages."""
    return [item for item in reader.connections if item.topic == topic]


def messages_of(
    reader: AnyReader, topic: str, start: int | None = None, stop: int | None = None
) -> Iterator[tuple[Any, int]]:
    """Yield the deserialised messages of a topic with their log times [ns]."""
    for item, logged, data in reader.messages(connections_of(reader, topic), start, stop):
        yield reader.deserialize(data, item.msgtype), logged
