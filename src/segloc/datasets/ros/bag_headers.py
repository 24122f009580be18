"""The headers of a topic's messages: when, and in which frame."""

from __future__ import annotations

import sqlite3
import struct
from collections.abc import Iterable, Iterator
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO
from urllib.parse import quote

import numpy as np
from numpy.typing import NDArray

from ...errors import DatasetError
from ...types import Float64, Int64

if TYPE_CHECKING:
    from rosbags.highlevel import AnyReader

_HEAD = 512  # bytes that hold a header


@dataclass(frozen=True)
class Headers:
    """std_msgs/Header of N messages.

    Attributes
    ----------
    stamps : (N,) float64
        Seconds.
    logged : (N,) int64
        When the message was recorded, nanoseconds; rising, perhaps with repetitions.
    ranks : (N,) int64
        How many messages before it were recorded at the same time.
    frames : tuple of N str
    """

    stamps: Float64
    logged: Int64
    ranks: Int64
    frames: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.stamps)

    def with_stamps(self, stamps: Float64) -> Headers:
        """The same messages at other times."""
        return replace(self, stamps=stamps)

    def part(self, mask: NDArray[np.bool_]) -> Headers:
        """Some of the messages."""
        frames = tuple(name for name, kept in zip(self.frames, mask, strict=True) if kept)
        return Headers(self.stamps[mask], self.logged[mask], self.ranks[mask], frames)


def read_headers(reader: AnyReader, paths: tuple[Path, ...], topic: str) -> Headers:
    """The headers of all messages of a topic, in the order of recording.

    SQLite and ROS 1 bags without compression give the first bytes of a message alone; others are
    read through once, one message in memory at a time.

    Raises
    ------
    DatasetError
        If a message is too short to have a header.
    """
    wanted = [item for item in reader.connections if item.topic == topic]
    files = [file for path in paths for file in (path.glob("*.db3") if path.is_dir() else [path])]
    heads: Iterable[tuple[int, bytes]]
    if files and all(file.suffix == ".db3" for file in files) and not _compressed(paths):
        heads = sorted((row for file in files for row in _sqlite_heads(file, topic)), key=_when)
    elif not reader.is2 and (places := _ros1_places(reader, topic)) is not None:
        heads = places
    else:
        heads = ((time, data[:_HEAD]) for _, time, data in reader.messages(wanted))
    parse = _parse_cdr if reader.is2 else _parse_ros1
    logged, stamps, frames = [], [], []
    names: dict[str, str] = {}  # one string for all messages, not one each
    for k, (time, head) in enumerate(heads):
        try:
            stamp, frame = parse(head)
        except (struct.error, IndexError) as error:
            raise DatasetError(f"message {k} of {topic} has no header: cut off?") from error
        logged.append(time)
        stamps.append(stamp * 1e-9)
        frames.append(names.setdefault(frame, frame))
    times = np.array(logged, dtype=np.int64)
    return Headers(np.array(stamps, np.float64), times, _ranks(times), tuple(frames))


def _when(row: tuple[int, bytes]) -> int:
    return row[0]


def _compressed(paths: tuple[Path, ...]) -> bool:
    """Whether the messages of a ROS 2 bag are compressed one by one, as its metadata say."""
    files = [path / "metadata.yaml" for path in paths if path.is_dir()]
    return any("zstd" in file.read_text("utf-8", "replace") for file in files)


def _sqlite_heads(path: Path, topic: str) -> Iterator[tuple[int, bytes]]:
    query = (
        f"SELECT messages.timestamp, substr(messages.data, 1, {_HEAD}) FROM messages "
        "JOIN topics ON messages.topic_id = topics.id WHERE topics.name = ? ORDER BY timestamp"
    )
    uri = f"file:{quote(str(path.resolve()))}?mode=ro&immutable=1"
    with closing(sqlite3.connect(uri, uri=True)) as database:
        yield from database.execute(query, (topic,))


def _ros1_places(reader: AnyReader, topic: str) -> Iterator[tuple[int, bytes]] | None:
    """First bytes of messages by a ROS 1 bag's own index; None where chunks are compressed."""
    from rosbags.rosbag1.reader import decompressors

    entries = [
        (entry.time, bag, bag.chunks[entry.chunk_pos], entry.offset)
        for bag in reader.readers
        for item in bag.connections
        if item.topic == topic
        for entry in bag.indexes[item.id]
    ]
    if any(chunk.decompressor is not decompressors["none"] for _, _, chunk, _ in entries):
        return None
    entries.sort(key=lambda entry: int(entry[0]))
    return ((time, _ros1_head(bag.bio, chunk.datapos + at)) for time, bag, chunk, at in entries)


def _ros1_head(file: BinaryIO, place: int) -> bytes:
    """The first bytes of the message whose record is at a place, or behind one of a connection."""
    file.seek(place)
    while True:
        (length,) = struct.unpack("<I", file.read(4))
        record = file.read(length)
        (size,) = struct.unpack("<I", file.read(4))
        if b"op=\x02" in record:
            return file.read(min(size, _HEAD))
        if b"op=\x07" not in record:
            raise DatasetError(f"no message at byte {place}")
        file.seek(size, 1)


def _parse_ros1(head: bytes) -> tuple[int, str]:
    """Stamp in nanoseconds and frame: uint32 number, two uint32 of time, a string."""
    _, whole, nanoseconds, length = struct.unpack_from("<IIII", head)
    return whole * 10**9 + nanoseconds, _text(head, 16, length)


def _parse_cdr(head: bytes) -> tuple[int, str]:
    """The same in CDR, behind four bytes that name the byte order: int32, uint32, a string."""
    order = "<" if head[1] & 1 else ">"
    whole, nanoseconds, length = struct.unpack_from(f"{order}iII", head, 4)
    return whole * 10**9 + nanoseconds, _text(head, 16, length)


def _text(head: bytes, start: int, length: int) -> str:
    if start + length > len(head):
        raise IndexError
    return head[start : start + length].rstrip(b"\0").decode("utf-8", "replace").lstrip("/")


def _ranks(times: Int64) -> Int64:
    """For each of sorted times, how many equal ones are before it."""
    first = np.searchsorted(times, times, side="left")
    return np.asarray(np.arange(len(times)) - first, dtype=np.int64)


def seconds(time: Any) -> float:
    """A builtin_interfaces/Time, rounded as the stamps of headers are."""
    return float((time.sec * 10**9 + time.nanosec) * 1e-9)
