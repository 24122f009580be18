"""Open bags with rosbags, within limits of memory, and report faults of bags."""

from __future__ import annotations

import os
import weakref
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ....errors import DatasetError, MissingDependency, SeglocError, requires
from ...io import fields
from ...io.fields import brief
from .bag_metadata import MAX_METADATA_BYTES, check_metadata

if TYPE_CHECKING:
    from .rosbags_reader import BagReader

_MCAP = b"\x89MCAP0\r\n"
_MAGIC = {".bag": b"#ROSBAG V2.0", ".db3": b"SQLite format 3\0", ".mcap": _MCAP}
_RECOVER = "`mcap recover IN.mcap -o OUT.mcap` saves the intact part"


@contextmanager
def open_bag(paths: tuple[Path, ...]) -> Iterator[BagReader]:
    """Open a bag; any error while it is open is reported as a fault of the bag.

    Raise DatasetError if it is truncated, damaged or unsupported. Raise MissingDependency if
    rosbags is not installed.
    """
    with faults_of(paths[0]):
        _check_magic(paths)
    reader = _reader(paths)
    try:
        reader.open()
    except MissingDependency:
        raise
    except Exception:  # of any library behind rosbags
        with faults_of(_first_faulty(paths)):
            raise
    with faults_of(paths[0]):
        try:
            yield reader
        finally:
            reader.close()


def _first_faulty(paths: tuple[Path, ...]) -> Path:
    """Return the first of several files that cannot be opened, or else the first."""
    for path in paths if len(paths) > 1 else ():
        try:
            with _reader((path,)):
                pass
        except MissingDependency:
            raise
        except Exception:  # of any library behind rosbags
            return path
    return paths[0]


def _reader(paths: tuple[Path, ...]) -> BagReader:
    with requires("rosbags", "ros", "reading bags"):
        from .rosbags_reader import BagReader
    return BagReader(paths)


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
                f"unreadable as a bag: {brief(error)}{remedy(path, error)}"
            ) from error


@contextmanager
def optional(what: str, remarks: list[str]) -> Iterator[None]:
    """Turn any error into a remark: the scans are readable without this part."""
    try:
        yield
    except MemoryError:
        raise
    except Exception as error:
        text = str(error) if isinstance(error, SeglocError) else f"{what}: {brief(error)}"
        remarks.append(f"{text}: not used")


class BagFile:
    """Bag that each process opens on first read.

    paths: files to open
    """

    def __init__(self, paths: tuple[Path, ...]) -> None:
        self._paths = paths
        self._reader: BagReader | None = None

    @property
    def path(self) -> Path:
        """The first file, for messages."""
        return self._paths[0]

    def reader(self) -> BagReader:
        """Return the open reader; it is closed with this object."""
        if self._reader is None:
            reader = _reader(self._paths)
            reader.open()
            weakref.finalize(self, reader.close)
            self._reader = reader
        return self._reader

    def __getstate__(self) -> dict[str, object]:
        return {"_paths": self._paths, "_reader": None}


def seconds(time: Any) -> float:
    """Convert a builtin_interfaces/Time to seconds, rounded as stamps of headers are."""
    return float((time.sec * 10**9 + time.nanosec) * 1e-9)


def fullest_topics(reader: BagReader, msgtype: str) -> list[str]:
    """List the topics of a type that have messages, by falling count."""
    counts: dict[str, int] = {}
    for item in reader.connections:
        if item.msgtype == msgtype and item.msgcount:
            counts[item.topic] = counts.get(item.topic, 0) + item.msgcount
    return sorted(counts, key=lambda name: (-counts[name], name))


def connections_of(reader: BagReader, topic: str) -> list[Any]:
    """List a topic's connections."""
    return [item for item in reader.connections if item.topic == topic]


def messages_of(
    reader: BagReader, topic: str, start: int | None = None, stop: int | None = None
) -> Iterator[tuple[Any, int]]:
    """Yield the deserialised messages of a topic with their log times [ns]."""
    for item, logged, data in reader.messages(connections_of(reader, topic), start, stop):
        yield reader.deserialize(data, item.msgtype), logged
