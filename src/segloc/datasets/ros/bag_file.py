"""Bags opened by the package rosbags, and what can go wrong with them."""

from __future__ import annotations

import os
import weakref
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from ...errors import DatasetError, MissingDependency, SeglocError
from ...io.fields import one_line
from .bag_limits import MOST_METADATA_BYTES, check_metadata, limit_chunks, limit_rosbags

if TYPE_CHECKING:
    from rosbags.highlevel import AnyReader

_MCAP = b"\x89MCAP0\r\n"
_BEGINNINGS = {".bag": b"#ROSBAG V2.0", ".db3": b"SQLite format 3\0", ".mcap": _MCAP}
_RECOVER = "`mcap recover IN.mcap -o OUT.mcap` writes what is whole"
_DEFINITIONS = {
    "velodyne_msgs/msg/VelodynePacket": "builtin_interfaces/Time stamp\nuint8[1206] data\n",
    "velodyne_msgs/msg/VelodyneScan": (
        "std_msgs/Header header\nvelodyne_msgs/VelodynePacket[] packets\n"
    ),
}
"""Messages of packages beside ROS itself, for bags without definitions."""


@contextmanager
def opened(paths: tuple[Path, ...]) -> Iterator[AnyReader]:
    """A reader of the bag; whatever goes wrong with it is a fault of the bag.

    Raises
    ------
    DatasetError
        If it is cut off, damaged or of a kind that cannot be read.
    MissingDependency
        If the package rosbags is not installed.
    """
    with faults_of(paths[0]):
        _check_beginnings(paths)
    with faults_of(paths[0]), _reader(paths) as reader:
        limit_chunks(reader)
        yield reader


def _check_beginnings(paths: tuple[Path, ...]) -> None:
    """Name what is no bag in other words than those of a parser that lost its way."""
    for path in paths:
        if not path.is_file():
            with (path / "metadata.yaml").open(encoding="utf-8", errors="replace") as text:
                check_metadata(text.read(MOST_METADATA_BYTES + 1), "metadata.yaml")
            continue
        with path.open("rb") as file:
            head = file.read(16)
        if not head:
            raise DatasetError(f"{path}: is empty")
        if not head.startswith(_BEGINNINGS[path.suffix]):
            raise DatasetError(f"{path}: no {path.suffix[1:]} file, by its first bytes")
        if path.suffix == ".mcap" and not _ends_whole(path):
            raise DatasetError(f"{path}: cut off, its end is missing: {_RECOVER}")


def _ends_whole(path: Path) -> bool:
    """Whether an MCAP file ends as it should: a recorder that was killed writes no end."""
    with path.open("rb") as file:
        file.seek(-min(path.stat().st_size, len(_MCAP)), os.SEEK_END)
        return file.read() == _MCAP


def remedy(path: Path, error: Exception) -> str:
    """What mends a bag that its reader refuses; "" where that isn't known."""
    text = str(error).lower()
    suffixes = {path.suffix} if path.is_file() else {file.suffix for file in path.glob("*.*")}
    if ".mcap" in suffixes and ("index" in text or "magic" in text or "eof" in text):
        return f": {_RECOVER}"
    if ".bag" in suffixes and ("index" in text or "connection" in text):
        return ": `rosbag reindex` mends it"
    if ".db3" in suffixes and "malformed" in text:
        return ": `sqlite3 IN.db3 .recover | sqlite3 OUT.db3` saves what is whole"
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
    # Older ROS 2 bags do not hold the definitions of their messages.
    store = get_typestore(Stores.ROS2_HUMBLE)
    for name, text in _DEFINITIONS.items():
        store.register(get_types_from_msg(text, name))
    return AnyReader(list(paths), default_typestore=store)


@contextmanager
def faults_of(path: Path) -> Iterator[None]:
    """Turn any error into one of the file's: damaged bytes show in any way."""
    try:
        yield
    except DatasetError as error:
        if str(error).startswith(str(path)):
            raise
        raise DatasetError(f"{path}: {error}") from error
    except SeglocError:
        raise
    except MemoryError as error:
        raise DatasetError(f"{path}: not enough memory to read it") from error
    except Exception as error:
        raise DatasetError(
            f"{path}: cannot be read as a bag: {one_line(error)}{remedy(path, error)}"
        ) from error


@contextmanager
def optional(what: str, remarks: list[str]) -> Iterator[None]:
    """Turn any error into a remark: the scans are readable without it."""
    try:
        yield
    except MemoryError:
        raise
    except Exception as error:
        text = str(error) if isinstance(error, SeglocError) else f"{what}: {one_line(error)}"
        remarks.append(f"{text}: not used")


class BagFile:
    """A bag that is opened when it is first read, and by each process for itself.

    Parameters
    ----------
    paths : tuple of path
        What has to be opened.
    """

    def __init__(self, paths: tuple[Path, ...]) -> None:
        self._paths = paths
        self._reader: AnyReader | None = None

    @property
    def path(self) -> Path:
        """The first of its files, which messages name."""
        return self._paths[0]

    def reader(self) -> AnyReader:
        """Open, until this object is let go."""
        if self._reader is None:
            reader = _reader(self._paths)
            reader.open()
            limit_chunks(reader)
            weakref.finalize(self, reader.close)
            self._reader = reader
        return self._reader

    def __getstate__(self) -> dict[str, object]:
        return {"_paths": self._paths, "_reader": None}
