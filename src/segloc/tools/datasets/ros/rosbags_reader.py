"""Reader of bags by rosbags: its limits, and what it refuses although it can be read.

All that touches the internals of rosbags is here; `pyproject.toml` bounds its version.
"""

from __future__ import annotations

import bz2
import os
import struct
from collections.abc import Callable, Collection, Iterator
from importlib.metadata import version
from pathlib import Path
from typing import Any, BinaryIO
from urllib.parse import quote

from rosbags.highlevel import AnyReader
from rosbags.interfaces import Connection, MessageDefinition, MessageDefinitionFormat
from rosbags.rosbag1 import Reader as Ros1Reader
from rosbags.rosbag1.reader import Compression, decompressors
from rosbags.rosbag2 import reader as rosbag2_reader
from rosbags.rosbag2 import storage_mcap, storage_sqlite3
from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore

from ....errors import DatasetError
from ....system.budget import check_bytes, check_points, most_bytes, most_message_bytes
from .bag_metadata import check_metadata

TRIED = ("0.11.9",)
"""Versions of rosbags that its tests have passed with."""
MAX_GROWTH = 32
"""Limit of the compression ratio of a bag file; clouds shrink to a half or a third."""
_INDEX_ENTRY_BYTES = 12  # ROS 1


def decompress(decompressor: Any, data: bytes, size: int | None = None) -> bytes:
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


class _Proxy:
    """A module or file for rosbags, of which a few names are replaced."""

    def __init__(self, real: Any) -> None:
        self._real = real

    def __getattr__(self, name: str) -> Any:
        return getattr(self._real, name)


class _Zstd(_Proxy):
    """The zstd module for rosbags, with limited decompression."""

    def decompress(self, data: bytes) -> bytes:
        return decompress(self._real.ZstdDecompressor(), data)

    def open(self, file: BinaryIO, mode: str) -> _LimitedFile:
        """Open a compressed file; the limit grows with its size, as recordings may be long."""
        limit = max(most_bytes(), MAX_GROWTH * os.fstat(file.fileno()).st_size)
        return _LimitedFile(self._real.open(file, mode), limit)


def _limit_profiles(parse_qos: Callable[[Any], Any]) -> Callable[[Any], Any]:
    def parse_limited(profiles: Any) -> Any:
        if isinstance(profiles, str):
            check_metadata(profiles, "the quality of service of a topic")
        return parse_qos(profiles)

    return parse_limited


def _limit_records(read_index: Callable[..., None]) -> Callable[..., None]:
    """Limit the records of a ROS 1 bag's index: chunks may share records."""

    def read_counted(reader: Any, place: int, indexes: dict[int, list[Any]]) -> None:
        begin = reader.bio.tell()
        read_index(reader, place, indexes)
        reader.index_bytes = getattr(reader, "index_bytes", 0) + reader.bio.tell() - begin
        if reader.index_bytes > os.fstat(reader.bio.fileno()).st_size:
            raise DatasetError("the index is longer than the file: chunks share records")
        check_points(reader.index_bytes // _INDEX_ENTRY_BYTES, "messages in its index")

    return read_counted


class _Apsw(_Proxy):
    """The apsw module for rosbags, which reads what is left in a killed recorder's -wal, too."""

    def Connection(self, uri: str, flags: int, vfs: str | None = None) -> Any:
        """Open a database to read; nothing is written beside it."""
        path = uri.removeprefix("file:").partition("?immutable")[0]
        wal = Path(f"{path}-wal")
        place = f"file:{quote(path)}"
        lockless = [name for name in self._real.vfs_names() if name.endswith("-none")]
        if vfs is not None or not lockless or not wal.is_file() or not wal.stat().st_size:
            return self._real.Connection(f"{place}?immutable=1", flags=flags, vfs=vfs)
        # Exclusive and without locks, the log's index is in memory and the log stays as it is.
        database = self._real.Connection(f"{place}?mode=ro", flags=flags, vfs=lockless[0])
        database.config(self._real.SQLITE_DBCONFIG_NO_CKPT_ON_CLOSE, 1)
        database.execute("PRAGMA locking_mode = EXCLUSIVE").fetchall()
        return database


_HEADER_START = 17  # of an MCAP file's header: after the magic, a byte and the length
_PROFILE = struct.pack("<I4s", 4, b"ros2")


class _AnyProfile(_Proxy):
    """MCAP file whose header names ROS 2, the only profile that rosbags reads."""

    def read(self, size: int = -1) -> bytes:
        at = self._real.tell()
        data: bytes = self._real.read(size)
        return data if at != _HEADER_START else (_PROFILE + data)[: len(data)]


class _Mcap(storage_mcap.McapReader):  # type: ignore[misc,unused-ignore]
    """MCAP of any profile, with or without an index of messages."""

    bio: Any
    connections: list[Any]

    def _open(self) -> None:
        file = self.bio
        assert file is not None
        self.bio = _AnyProfile(file)
        try:
            super()._open()
        finally:
            self.bio = file
        if bare := [chunk for chunk in self.chunks if not chunk.channel_count]:
            if not any(item.msgcount for item in self.connections):
                self.meta_scan()
                assert self.statistics is not None
                counts = self.statistics.channel_message_counts
                self.connections = [c._replace(msgcount=counts[c.id]) for c in self.connections]
            for chunk in bare:  # otherwise passed over
                chunk.channel_count.update(dict.fromkeys((c.id for c in self.connections), 1))


def _definition(schema: Any) -> MessageDefinition:
    """Return a channel's definition; none for schemas of other systems."""
    known = {"ros1msg": "ros2msg", "ros2msg": "ros2msg", "ros2idl": "ros2idl", "omgidl": "ros2idl"}
    if schema is None or schema.encoding not in known:
        return MessageDefinition(MessageDefinitionFormat.NONE, "")
    is_msg = known[schema.encoding] == "ros2msg"
    kind = MessageDefinitionFormat.MSG if is_msg else MessageDefinitionFormat.IDL
    return MessageDefinition(kind, schema.data)


def _text(file: BinaryIO) -> str:
    """Read a string of an MCAP file; schemas of other systems may hold any bytes."""
    return str(storage_mcap.read_bytes(file), "utf-8", "replace")


def replacements() -> list[tuple[Any, str, Callable[[Any], Any]]]:
    """Return what is replaced in rosbags, which has no settings for it.

    Each is an owner, a name, and what makes the new value of the old one.
    """
    zstd = rosbag2_reader.zstd
    ours = {
        "lz4": lambda data, size: decompress(_lz4(), data, size),
        "zstd": lambda data, size: decompress(zstd.ZstdDecompressor(), data, size),
    }
    return [
        (Ros1Reader, "read_index_data", _limit_records),
        (rosbag2_reader, "parse_qos", _limit_profiles),
        (storage_mcap, "parse_qos", _limit_profiles),
        (storage_sqlite3, "parse_qos", _limit_profiles),
        (storage_mcap, "DECOMPRESSORS", lambda known: {**known, **ours}),
        (storage_mcap, "get_msgdef", lambda _: _definition),
        (storage_mcap, "read_string", lambda _: _text),
        (storage_sqlite3, "apsw", _Apsw),
        (rosbag2_reader, "zstd", _Zstd),
        (rosbag2_reader.Reader, "STORAGE_PLUGINS", lambda known: {**known, ".mcap": _Mcap}),
        (rosbag2_reader.DirectoryReader, "STORAGE_PLUGINS", lambda known: {**known, "mcap": _Mcap}),
    ]


def install(replaced: list[tuple[Any, str, Callable[[Any], Any]]]) -> None:
    """Replace names of rosbags.

    Raises
    ------
    DatasetError
        If this version of rosbags has no such name.
    """
    for owner, name, new in replaced:
        try:
            setattr(owner, name, new(getattr(owner, name)))
        except AttributeError as error:
            raise DatasetError(
                f"rosbags {version('rosbags')} cannot be used, it has no {owner.__name__}.{name}: "
                f"pip install rosbags=={TRIED[-1]}"
            ) from error


install(replacements())


_DEFINITIONS = {
    "velodyne_msgs/msg/VelodynePacket": "builtin_interfaces/Time stamp\nuint8[1206] data\n",
    "velodyne_msgs/msg/VelodyneScan": (
        "std_msgs/Header header\nvelodyne_msgs/VelodynePacket[] packets\n"
    ),
}
"""Messages outside ROS's own packages, for bags without definitions."""


_ZSTD = b"\x28\xb5\x2f\xfd"
"""First bytes of a message that is compressed singly; those of CDR begin with 0."""


class BagReader(AnyReader):  # type: ignore[misc,unused-ignore]
    """Messages of ROS 1 and ROS 2 in bags; a definition is parsed when it is needed.

    Attributes
    ----------
    cdr : bool
        True for ROS 2's serialization, False for ROS 1's.
    foreign : list of Connection
        Channels in other serializations, which are not among ``connections``.
    """

    def __init__(self, paths: Collection[Path]) -> None:
        super().__init__(list(paths))
        self.cdr = self.is2
        self.foreign: list[Connection] = []
        self._stores: dict[str, list[Any]] = {}

    def _open(self) -> None:
        assert self.stack
        for reader in self.readers:
            self.stack.enter_context(reader)
        _limit_chunks(self)
        found = [item for reader in self.readers for item in reader.connections]
        self.cdr = self.is2 and any(map(_is_cdr, found)) | (not any(map(_is_ros1, found)))
        is_read = _is_cdr if self.cdr else _is_ros1
        self.connections = [_with_ros2_type(item) for item in found if is_read(item)]
        self.foreign = [item for item in found if not is_read(item)]

    def messages(
        self, connections: Collection[Any] = (), start: int | None = None, stop: int | None = None
    ) -> Iterator[tuple[Any, int, bytes]]:
        """Yield messages in order of their log times [ns]; none if no connections are given."""
        if not connections:
            return
        for item, logged, data in super().messages(connections, start, stop):
            packed = self.cdr and data[:4] == _ZSTD
            yield item, logged, rosbag2_reader.zstd.decompress(data) if packed else data

    def heads(self, topic: str, size: int) -> list[tuple[int, bytes]] | None:
        """Return log times [ns] and first bytes of a topic's messages, in order.

        None if they cannot be read without the messages: outside SQLite, or compressed.
        """
        found: list[tuple[int, bytes]] = []
        for reader in self.readers:
            storage = getattr(reader, "storage", None)
            for database in getattr(storage, "storages", [storage]):
                if not isinstance(database, storage_sqlite3.Sqlite3Reader):
                    return None
                query = (
                    f"SELECT messages.timestamp, substr(messages.data, 1, {int(size)}) "
                    "FROM messages JOIN topics ON messages.topic_id = topics.id "
                    "WHERE topics.name = ? ORDER BY timestamp"
                )
                assert database.dbconn is not None
                found += database.dbconn.execute(query, (topic,)).fetchall()
        if any(head[:4] == _ZSTD for _, head in found):
            return None
        return sorted(found, key=lambda row: row[0])

    def deserialize(self, rawdata: bytes, typ: str) -> object:
        """Deserialize a message by the bag's definition, or by the standard one of its name."""
        if typ not in self._stores:
            self._stores[typ] = self._stores_of(typ)
        stores = self._stores[typ]
        fault: Exception | None = None
        for k, store in enumerate(stores):
            try:
                read = store.deserialize_cdr if self.cdr else store.deserialize_ros1
                message: object = read(rawdata, typ)
            except Exception as error:  # damaged definitions and messages raise many kinds
                fault = fault or error
            else:
                self._stores[typ] = [store, *stores[:k], *stores[k + 1 :]]
                return message
        raise fault or DatasetError(f"no usable definition of {typ}")

    def _stores_of(self, name: str) -> list[Any]:
        """Return types by the bag's own definitions, then the standard ones."""
        texts = {item.msgdef for item in self.connections if item.msgtype == name}
        stores = []
        for text in sorted(texts, key=lambda each: each.data):
            if text.format == MessageDefinitionFormat.NONE:
                continue
            try:
                store = get_typestore(Stores.EMPTY)
                store.register(_types(text, name))
                stores.append(store)
            except Exception:  # the standard definition may serve
                continue
        standard = get_typestore(Stores.ROS2_HUMBLE if self.cdr else Stores.ROS1_NOETIC)
        for known, text in _DEFINITIONS.items():
            standard.register(get_types_from_msg(text, known))
        return [*stores, standard] if name in standard.fielddefs else stores


def _types(text: MessageDefinition, name: str) -> Any:
    if text.format == MessageDefinitionFormat.MSG:
        return get_types_from_msg(text.data, name)
    line = "=" * 80 + "\n"
    if not text.data.startswith(f"{line}IDL: "):
        return get_types_from_idl(text.data)
    types: dict[str, Any] = {}
    for part in text.data.split(line)[1:]:
        types.update(get_types_from_idl(part.partition("\n")[2]))
    return types


def serialization(item: Any) -> str:
    """Return how a connection's messages are serialized: cdr, ros1, json, protobuf, ..."""
    return str(getattr(item.ext, "serialization_format", "ros1")).lower()


def _is_cdr(item: Any) -> bool:
    return serialization(item) == "cdr"


def _is_ros1(item: Any) -> bool:
    return serialization(item) == "ros1"


def _with_ros2_type(item: Any) -> Any:
    """Return a connection with the type's name as in ROS 2, package/msg/Type."""
    package, _, name = item.msgtype.partition("/")
    return item if not name or "/" in name else item._replace(msgtype=f"{package}/msg/{name}")


def _limit_chunks(reader: AnyReader) -> None:
    """Make an opened ROS 1 bag decompress its chunks within the limit.

    Raise DatasetError if two of its connections share an id: each would yield the messages of
    both.
    """
    ours = {
        decompressors[Compression.BZ2.value]: lambda data: decompress(bz2.BZ2Decompressor(), data),
        decompressors[Compression.LZ4.value]: lambda data: decompress(_lz4(), data),
    }
    for bag in () if reader.is2 else reader.readers:
        if len({item.id for item in bag.connections}) < len(bag.connections):
            raise DatasetError("two connections of the bag share an id")
        for place, chunk in bag.chunks.items():
            if chunk.decompressor in ours:
                bag.chunks[place] = chunk._replace(decompressor=ours[chunk.decompressor])
