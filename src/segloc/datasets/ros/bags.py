"""ROS 1 bags, ROS 2 bags (SQLite, MCAP) and MCAP files, read without ROS.

Formats: wiki.ros.org/Bags/Format/2.0, github.com/ros2/rosbag2, mcap.dev/spec. They are opened by
the package rosbags; here is which messages are scans, and how one of them is found again.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ...errors import DatasetError
from ...types import Scan
from ..recorded import Found
from ..tracks import rising
from . import bag_ouster
from .bag_file import BagFile, faults_of, opened
from .bag_headers import Headers, read_headers
from .bag_messages import KINDS, defines_times, fields_of, scan_of
from .bag_place import find_place

if TYPE_CHECKING:
    from rosbags.highlevel import AnyReader

NAME = "bag"
INNER: tuple[str, ...] = ()
_SUFFIXES = (".bag", ".db3", ".mcap")
_PACKED = ".zstd"
_STORAGE = {".bag": "ROS 1 bag", ".db3": "ROS 2 bag, SQLite", ".mcap": "MCAP"}


def recognises(path: Path) -> bool:
    """Whether the path is a bag, or a folder that holds one."""
    return bool(bag_paths(path))


def bag_paths(path: Path) -> tuple[Path, ...]:
    """What has to be opened: a file, a ROS 2 bag's folder, or all ROS 1 bags of a folder."""
    if path.is_file():
        return (path,) if path.suffix in _SUFFIXES or _is_packed(path) else ()
    if not path.is_dir():
        return ()
    if (path / "metadata.yaml").is_file():
        return (path,) if _stored(path) else ()
    for suffix in _SUFFIXES:
        if found := sorted(path.glob(f"*{suffix}")):
            return tuple(found)
    return tuple(sorted(file for file in path.glob(f"*{_PACKED}") if _is_packed(file)))


def _is_packed(path: Path) -> bool:
    """Whether a file is one of a ROS 2 bag that is compressed whole."""
    return path.name.endswith(tuple(f"{suffix}{_PACKED}" for suffix in _SUFFIXES))


def _stored(path: Path) -> list[Path]:
    names = [f"*{suffix}{packed}" for suffix in _SUFFIXES[1:] for packed in ("", ".zstd")]
    return sorted(file for name in names for file in path.glob(name))


def find(path: Path, topic: str | None) -> Found:
    """Read the headers of the clouds, and the poses.

    Raises
    ------
    DatasetError
        If the bag or its clouds cannot be read, or there are several topics and none is chosen.
    """
    paths = bag_paths(path)
    if packed := [file.name for file in paths if file.suffix == _PACKED]:
        raise DatasetError(
            f"{path}: {packed[0]} is compressed, and metadata.yaml is missing: unpack it by "
            "`zstd -d`, or write the metadata by `ros2 bag reindex`"
        )
    name = path.resolve().stem if path.is_file() else path.resolve().name
    with opened(paths) as reader:
        chosen = _choose(path, reader, topic)
        if bag_ouster.on(reader, chosen):
            return bag_ouster.find(reader, paths, chosen, name, _kind(paths[0]))
        headers = read_headers(reader, paths, chosen)
        if not len(headers):
            raise DatasetError(f"{path}: no message on {chosen}")
        headers, notes = _in_order(headers, str(path), chosen)
        place = find_place(reader, paths, headers.frames[0], headers.stamps, headers.logged)
        fields = _fields(reader, chosen)
        times_sure = defines_times(reader, chosen, fields)
    return Found(
        name=name,
        format=_kind(paths[0]),
        source=BagSource(paths, chosen, headers),
        indices=np.arange(len(headers)),
        stamps=headers.stamps,
        own_track=lambda: place.tracks.sensor,
        base_track=place.tracks.base,
        T_base_sensor=place.T_base_sensor,
        gravity=place.gravity,
        topic=chosen,
        frame=headers.frames[0],
        fields=fields,
        notes=(*notes, *place.tracks.remarks),
        times_sure=times_sure,
    )


def _kind(path: Path) -> str:
    if path.is_file():
        return _STORAGE[path.suffix]
    return f"ROS 2 bag, {'MCAP' if '.mcap' in _stored(path)[0].name else 'SQLite'}"


def _choose(path: Path, reader: AnyReader, topic: str | None) -> str:
    """The topic with the scans: the one asked for, or the only one of the best kind."""
    groups = [_counts(reader, kinds) for kinds in KINDS]
    counts = {name: count for group in groups for name, count in group.items()}
    if not counts:
        others = sorted({f"{item.topic} ({item.msgtype})" for item in reader.connections})
        raise DatasetError(f"{path}: no topic of scans, only {', '.join(others) or 'nothing'}")
    if topic is not None:
        if topic not in counts:
            raise DatasetError(f"{path}: {topic!r} is no topic of scans: {_listed(counts)}")
        return topic
    filled = [{name: count for name, count in group.items() if count} for group in groups]
    best = next(group for group in [*filled, *groups] if group)
    if len(best) > 1:
        raise DatasetError(f"{path}: several topics, choose one by --topic: {_listed(best)}")
    return next(iter(best))


def _counts(reader: AnyReader, kinds: tuple[str, ...]) -> dict[str, int]:
    """How many messages there are on each topic of some types."""
    counts: dict[str, int] = {}
    for item in reader.connections:
        if item.msgtype in kinds and not bag_ouster.inertial(item):
            counts[item.topic] = counts.get(item.topic, 0) + item.msgcount
    return counts


def _listed(topics: dict[str, int]) -> str:
    return ", ".join(f"{name} ({count})" for name, count in sorted(topics.items()))


def _in_order(headers: Headers, path: str, topic: str) -> tuple[Headers, list[str]]:
    """The messages whose stamps rise, all of one frame."""
    frames = sorted(set(headers.frames))
    if len(frames) > 1:
        second = next(k for k, name in enumerate(headers.frames) if name != headers.frames[0])
        raise DatasetError(
            f"{path}: message {second} of {topic} is in frame {headers.frames[second]!r}, those "
            f"before it in {headers.frames[0]!r}: two sensors on one topic?"
        )
    if not headers.stamps.any():
        note = f"{topic} has no stamps: times are those of recording"
        return headers.with_stamps(np.asarray(headers.logged * 1e-9, np.float64)), [note]
    later = rising(headers.stamps)
    lost = len(later) - int(later.sum())
    if not lost:
        return headers, []
    return headers.part(later), [f"{lost} of {len(later)} messages left out: stamps do not rise"]


def _fields(reader: AnyReader, topic: str) -> str:
    for item, _, data in reader.messages([c for c in reader.connections if c.topic == topic]):
        return fields_of(reader, data, item.msgtype)
    return ""


class BagSource:
    """The clouds of one topic, found again by the time at which they were recorded.

    Parameters
    ----------
    paths : tuple of path
    topic : str
    headers : Headers
        Of the messages that are scans.
    """

    def __init__(self, paths: tuple[Path, ...], topic: str, headers: Headers) -> None:
        self._file, self._topic, self._headers = BagFile(paths), topic, headers

    def __len__(self) -> int:
        return len(self._headers)

    def where(self, k: int) -> str:
        """The message, as errors name it."""
        return f"{self._file.path}: message {k} of {self._topic}"

    def read(self, k: int) -> Scan:
        """The cloud at position k."""
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
        wanted = [item for item in reader.connections if item.topic == self._topic]
        messages = reader.messages(wanted, start=logged, stop=logged + 1)
        for position, (item, _, data) in enumerate(messages):
            if position == rank:
                return data, item.msgtype
        raise DatasetError(f"{self.where(k)}: is not there any more")
