"""ROS 1 bags, ROS 2 bags (SQLite, MCAP) and MCAP files, read without ROS.

Formats: wiki.ros.org/Bags/Format/2.0, github.com/ros2/rosbag2, mcap.dev/spec. rosbags opens them;
this module selects the messages that are scans and reads them by position.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from operator import itemgetter
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from ....errors import DatasetError
from ....types import Float64, Int64, Scan
from ..clocks import epoch_unit
from ..recorded import Found
from ..tracks import rising
from ..world_clouds import stand_still
from . import bag_ouster
from .bag_file import BagFile, connections_of, faults_of, open_bag
from .bag_messages import KINDS, defines_times, fields_of, instead_of, scan_of
from .bag_place import place_scans

if TYPE_CHECKING:
    from .rosbags_reader import BagReader

_HEAD = 512  # bytes, enough for a header


@dataclass(frozen=True)
class Headers:
    """std_msgs/Header of N messages."""

    stamps: Float64  # (N,) seconds
    logged: Int64  # (N,) log times [ns], rising, perhaps with repetitions
    ranks: Int64  # (N,) number of earlier messages with the same log time
    frames: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.stamps)

    def part(self, mask: NDArray[np.bool_]) -> Headers:
        """Return the messages of a mask."""
        frames = tuple(name for name, kept in zip(self.frames, mask, strict=True) if kept)
        return Headers(self.stamps[mask], self.logged[mask], self.ranks[mask], frames)


def read_headers(reader: BagReader, topic: str) -> Headers:
    """Read the headers of all messages of a topic, in order of recording.

    Of SQLite and uncompressed ROS 1 bags only the first bytes of each message are read; others are
    read through once, one message in memory at a time.

    Raise DatasetError if a message is too short for a header.
    """
    heads: Iterable[tuple[int, bytes]] | None
    heads = reader.heads(topic, _HEAD) if reader.is2 else _ros1_places(reader, topic)
    if heads is None:
        heads = (
            (time, data[:_HEAD]) for _, time, data in reader.messages(connections_of(reader, topic))
        )
    parse = _parse_cdr if reader.cdr else _parse_ros1
    logged, stamps, frames = [], [], []
    names: dict[str, str] = {}  # interned: one string for all messages
    for k, (time, head) in enumerate(heads):
        try:
            stamp, frame = parse(head)
        except (struct.error, IndexError) as error:
            raise DatasetError(f"message {k} of {topic} has no header: truncated?") from error
        logged.append(time)
        stamps.append(stamp * 1e-9)
        frames.append(names.setdefault(frame, frame))
    times = np.array(logged, dtype=np.int64)
    ranks = np.arange(len(times)) - np.searchsorted(times, times)
    return Headers(np.array(stamps, np.float64), times, ranks, tuple(frames))


def _ros1_places(reader: BagReader, topic: str) -> Iterator[tuple[int, bytes]] | None:
    """Yield first bytes of messages by a ROS 1 bag's index; None if chunks are compressed."""
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
    entries.sort(key=itemgetter(0))
    return ((time, _ros1_head(bag.bio, chunk.datapos + at)) for time, bag, chunk, at in entries)


def _ros1_head(file: BinaryIO, place: int) -> bytes:
    """Return the first bytes of the message at an offset, or after a connection record there."""
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
    """Parse stamp [ns] and frame: uint32 number, two uint32 of time, a string."""
    _, whole, nanoseconds, length = struct.unpack_from("<IIII", head)
    return whole * 10**9 + nanoseconds, _text(head, 16, length)


def _parse_cdr(head: bytes) -> tuple[int, str]:
    """Parse the same in CDR, after four bytes that name the byte order: int32, uint32, a string."""
    order = "<" if head[1] & 1 else ">"
    whole, nanoseconds, length = struct.unpack_from(f"{order}iII", head, 4)
    return whole * 10**9 + nanoseconds, _text(head, 16, length)


def _text(head: bytes, start: int, length: int) -> str:
    if start + length > len(head):
        raise IndexError
    return head[start : start + length].rstrip(b"\0").decode("utf-8", "replace").lstrip("/")


NAME = "bag"
INNER: tuple[str, ...] = ()
_SUFFIXES = (".bag", ".db3", ".mcap")
_PACKED = ".zstd"
_STORAGE = {".bag": "ROS 1 bag", ".db3": "ROS 2 bag, SQLite", ".mcap": "MCAP"}


def recognises(path: Path) -> bool:
    """Return whether the path is a bag, or a folder with one."""
    return bool(bag_paths(path))


def bag_paths(path: Path) -> tuple[Path, ...]:
    """Return the paths to open: a file, a ROS 2 bag's folder, or all ROS 1 bags of a folder."""
    if path.is_file():
        return (path,) if path.suffix in _SUFFIXES or _is_packed(path) else ()
    if not path.is_dir():
        return ()
    if (path / "metadata.yaml").is_file():
        return (path,) if _storage_files(path) else ()
    for suffix in _SUFFIXES:
        if found := sorted(path.glob(f"*{suffix}")):
            return tuple(found)
    return tuple(sorted(file for file in path.glob(f"*{_PACKED}") if _is_packed(file)))


def _is_packed(path: Path) -> bool:
    """Return whether a file belongs to a ROS 2 bag with file compression."""
    return path.name.endswith(tuple(f"{suffix}{_PACKED}" for suffix in _SUFFIXES))


def _storage_files(path: Path) -> list[Path]:
    names = [f"*{suffix}{packed}" for suffix in _SUFFIXES[1:] for packed in ("", ".zstd")]
    return sorted(file for name in names for file in path.glob(name))


def find(path: Path, topic: str | None) -> Found:
    """Read the headers of the scans, and the poses.

    Raise DatasetError if the bag or its scans cannot be read, or there are several topics and none
    is chosen.
    """
    paths = bag_paths(path)
    if packed := [file.name for file in paths if file.suffix == _PACKED]:
        raise DatasetError(
            f"{path}: {packed[0]} is compressed, and metadata.yaml is missing: unpack it with "
            "`zstd -d`, or write the metadata with `ros2 bag reindex`"
        )
    name = path.resolve().stem if path.is_file() else path.resolve().name
    with open_bag(paths) as reader:
        chosen = _choose(path, reader, topic)
        if bag_ouster.on(reader, chosen):
            return bag_ouster.find(reader, paths, chosen, name, _kind(paths[0]))
        headers = read_headers(reader, chosen)
        lost = _missing_messages(reader, chosen, len(headers))
        headers, notes = _in_order(headers, str(path), chosen)
        fields = _fields(reader, chosen)
        found = Found(
            name=name,
            format=_kind(paths[0]),
            source=BagSource(paths, chosen, headers),
            indices=np.arange(len(headers)),
            stamps=headers.stamps,
            topic=chosen,
            frame=headers.frames[0],
            fields=fields,
            notes=(*lost, *notes),
            times_sure=defines_times(reader, chosen),
        )
        found = place_scans(found, reader, paths, headers.stamps, headers.logged)
        if (body := found.body_in_frame) is None:
            return found
        if stand_still(found, body):
            raise DatasetError(
                f"{path}: the clouds of {chosen} are in {found.frame!r}, the frame of "
                f"{body.source}, not in the sensor's: {_raw_topics(reader, chosen, found.frame)}"
            )
        note = (
            f"{chosen} is in {found.frame!r}, in which {body.source} moves: poses not used. Name "
            "the sensor's frame or set local_cloud.mount; if the clouds lie in that frame, use the "
            "raw topic"
        )
        return replace(found, notes=(*found.notes, note))


def _raw_topics(reader: BagReader, topic: str, frame: str) -> str:
    """Return how to get clouds in another frame than that of a topic."""
    others = {}
    for name in _counts(reader, tuple(kind for group in KINDS[:3] for kind in group)):
        first = next(iter(reader.messages(connections_of(reader, name))), None)
        if name != topic and first is not None:
            with suppress(struct.error, IndexError):
                other = (_parse_cdr if reader.cdr else _parse_ros1)(first[2][:_HEAD])[1]
                others[name] = other
    raw = sorted(name for name, other in others.items() if other != frame)
    if raw:
        return f"use --topic {' or '.join(raw)}"
    return "record the sensor's raw topic, or the one in the body's frame"


def _missing_messages(reader: BagReader, topic: str, count: int) -> list[str]:
    """Return a note if a ROS 2 bag's metadata counts more messages than there are."""
    counted = sum(item.msgcount for item in connections_of(reader, topic))
    if count >= counted:
        return []
    return [
        f"{topic}: {count} of {counted} messages by the bag's index are there: the rest was not "
        "written, or lies in files that are missing"
    ]


def _kind(path: Path) -> str:
    if path.is_file():
        return _STORAGE[path.suffix]
    return f"ROS 2 bag, {'MCAP' if '.mcap' in _storage_files(path)[0].name else 'SQLite'}"


def _choose(path: Path, reader: BagReader, topic: str | None) -> str:
    """Return the chosen topic, or the only one of the preferred message types."""
    groups = [_counts(reader, kinds) for kinds in KINDS]
    counts = {name: count for group in groups for name, count in group.items()}
    if not counts or (topic is not None and topic not in counts):
        _refuse_unread(path, reader, topic)
    if not counts:
        others = sorted({f"{item.topic} ({item.msgtype})" for item in _all_topics(reader)})
        raise DatasetError(f"{path}: no topic of scans; topics: {', '.join(others) or 'none'}")
    if topic is not None:
        if topic not in counts:
            raise DatasetError(f"{path}: no scans on {topic!r}; available: {_list_topics(counts)}")
        return topic
    filled = [{name: count for name, count in group.items() if count} for group in groups]
    best = next(group for group in [*filled, *groups] if group)
    if len(best) > 1:
        raise DatasetError(f"{path}: several topics, choose one with --topic: {_list_topics(best)}")
    return next(iter(best))


def _all_topics(reader: BagReader) -> list[Any]:
    return [*reader.connections, *reader.foreign]


def _refuse_unread(path: Path, reader: BagReader, topic: str | None) -> None:
    """Raise DatasetError if there are clouds of a type that is not read (on the chosen topic)."""
    from .rosbags_reader import serialization

    for item in _all_topics(reader):
        remedy = instead_of(item.msgtype)
        if remedy and topic in (None, item.topic):
            kind = item.msgtype + (f", {serialization(item)}" if item in reader.foreign else "")
            raise DatasetError(f"{path}: {item.topic} ({kind}) is not read: {remedy}")


def _counts(reader: BagReader, kinds: tuple[str, ...]) -> dict[str, int]:
    """Count the messages on each topic of some types."""
    counts: dict[str, int] = {}
    for item in reader.connections:
        if item.msgtype in kinds and not bag_ouster.is_imu(item):
            counts[item.topic] = counts.get(item.topic, 0) + item.msgcount
    return counts


def _list_topics(topics: dict[str, int]) -> str:
    return ", ".join(f"{name} ({count})" for name, count in sorted(topics.items()))


def _in_order(headers: Headers, path: str, topic: str) -> tuple[Headers, list[str]]:
    """Return the messages with rising stamps, all of one frame."""
    if not len(headers):
        raise DatasetError(f"{path}: no messages on {topic}")
    frames = sorted(set(headers.frames))
    if len(frames) > 1:
        second = next(k for k, name in enumerate(headers.frames) if name != headers.frames[0])
        raise DatasetError(
            f"{path}: message {second} of {topic} is in frame {headers.frames[second]!r}, those "
            f"before it in {headers.frames[0]!r}: two sensors on one topic?"
        )
    notes, blank = list[str](), headers.stamps == 0.0
    if blank.all():
        note = f"{topic} has no stamps: using log times"
        return replace(headers, stamps=np.asarray(headers.logged * 1e-9, np.float64)), [note]
    if blank.any() and epoch_unit(headers.stamps[~blank]) is not None:  # no time since a start
        notes.append(f"{blank.sum()} of {len(blank)} messages dropped: no stamps")
        headers = headers.part(~blank)
    later = rising(headers.stamps)
    if lost := len(later) - int(later.sum()):
        notes.append(f"{lost} of {len(later)} messages dropped: stamps do not rise")
        headers = headers.part(later)
    return headers, notes


def _fields(reader: BagReader, topic: str) -> str:
    for item, _, data in reader.messages(connections_of(reader, topic)):
        return fields_of(reader, data, item.msgtype)
    return ""


class BagSource:
    """Scans of one topic, read again by their log time.

    headers: of the messages that are scans
    """

    def __init__(self, paths: tuple[Path, ...], topic: str, headers: Headers) -> None:
        self._file, self._topic, self._headers = BagFile(paths), topic, headers

    def where(self, k: int) -> str:
        return f"{self._file.path}: message {k} of {self._topic}"

    def read(self, k: int) -> Scan:
        stamp = float(self._headers.stamps[k])
        with faults_of(self._file.path):
            data, kind = self._message(k)
            try:
                return scan_of(self._file.reader(), data, kind, stamp, self.where(k))
            except DatasetError as error:
                raise DatasetError(f"{self.where(k)}: {error}") from error

    def _message(self, k: int) -> tuple[bytes, str]:
        reader = self._file.reader()
        logged, rank = int(self._headers.logged[k]), int(self._headers.ranks[k])
        wanted = connections_of(reader, self._topic)
        messages = reader.messages(wanted, start=logged, stop=logged + 1)
        for position, (item, _, data) in enumerate(messages):
            if position == rank:
                return data, item.msgtype
        raise DatasetError(f"{self.where(k)}: missing: the bag has changed since it was opened")
