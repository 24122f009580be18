"""Atomic file writing: a crash or full disk never leaves a partial file.

:func:`replacing` proceeds in this order:

1. create and lock a temporary file ``.NAME.PID-RANDOM.tmp`` in the same folder;
2. write the bytes, and flush them to disk (fsync of the file);
3. rename it to NAME, which replaces the old file atomically;
4. flush the rename to disk (fsync of the folder).

So NAME is always the old file or the complete new one, even after a kill or a loss of power; once
the save has returned it is the new one. The next save of a file removes what a killed save left.
"""

from __future__ import annotations

import os
import re
import secrets
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import BinaryIO

from ..errors import SeglocError
from .locks import lock_file, process_lives

CLOUD_SUFFIXES = (".pcd", ".ply", ".las", ".laz", ".e57", ".xyz")
"""Suffixes of files that hold nothing but a point cloud; these are read of a folder."""


def is_cloud(path: Path) -> bool:
    """Return whether a name is that of a point cloud and of nothing else."""
    return path.suffix.lower() in CLOUD_SUFFIXES


@contextmanager
def replacing(path: str | Path, *, sweep: bool = True) -> Iterator[BinaryIO]:
    """Open a temporary file that replaces ``path`` when the block succeeds.

    ``path`` is always the old file or the complete new one. If the block or the disk fails, the
    temporary file is removed and ``path`` is unchanged.

    Parameters
    ----------
    path : path
    sweep : bool
        True to remove what killed saves of that file left. This lists the folder: not worth it for
        many files.

    Raises
    ------
    SeglocError
        If the file cannot be written; names it and the fault.
    """
    target = checked_target(Path(path))
    if sweep:
        _remove_stale(target)
    temporary = target.with_name(f".{target.name}.{os.getpid()}-{secrets.token_hex(4)}.tmp")
    try:
        with temporary.open("xb") as stream:
            lock_file(stream.fileno())  # until closed: marks the file as being written
            yield stream
            stream.flush()
            os.fsync(stream.fileno())
        temporary.replace(target)
        _sync_folder(target.parent)
    except BaseException as error:
        with suppress(OSError):
            temporary.unlink()
        if isinstance(error, OSError):
            raise SeglocError(f"{path}: cannot be written: {_reason(error)}") from error
        raise


def write_bytes(path: str | Path, data: bytes | memoryview, *, sweep: bool = True) -> None:
    """Write ``data`` with :func:`replacing`."""
    with replacing(path, sweep=sweep) as stream:
        stream.write(data)


def write_text(path: str | Path, text: str) -> None:
    """Write ``text`` as UTF-8 with :func:`replacing`."""
    write_bytes(path, text.encode())


def checked_target(path: Path, *suffixes: str) -> Path:
    """Return the file that ``path`` refers to, if it can be written.

    With ``suffixes``, those of what is written, no other file is replaced: it may be an input.

    Raises
    ------
    SeglocError
        If it is a folder or a device, exists under another suffix, or its folder does not exist or
        must not be written.
    """
    target = Path(os.path.realpath(path))  # keep links
    try:
        exists = target.exists()
    except OSError as error:  # such as of a name that is too long
        raise SeglocError(f"{path}: cannot be written: {_reason(error)}") from error
    if target.is_dir():
        raise SeglocError(f"{path}: cannot be written: is a directory")
    if exists and not target.is_file():
        raise SeglocError(f"{path}: cannot be written: is not a regular file")
    if not target.parent.is_dir():
        raise SeglocError(f"{path}: cannot be written: there is no folder {target.parent}")
    if suffixes and exists and target.suffix.lower() not in suffixes:
        raise SeglocError(
            f"{path}: exists, and is no {suffixes[0]} file by its name: choose another name, or "
            "remove it"
        )
    require_permission(path, target.parent)
    return target


def require_permission(path: Path, folder: Path) -> None:
    """Reject what would be written to a folder without permission to write there.

    Raises
    ------
    SeglocError
    """
    if not os.access(folder, os.W_OK | os.X_OK):
        raise SeglocError(f"{path}: cannot be written: read-only or no permission: {folder}")


def make_folder(path: Path) -> None:
    """Create a folder and those above it, unless it exists.

    Raises
    ------
    SeglocError
        If it cannot be created.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise SeglocError(f"{path}: cannot be created: {_reason(error)}") from error


@contextmanager
def folder_in(parent: str | Path | None, prefix: str) -> Iterator[Path]:
    """Create a temporary folder in another, by default in the system's; removed at the end.

    Raises
    ------
    SeglocError
        If the parent does not exist.
    """
    if parent is not None and not Path(parent).is_dir():
        raise SeglocError(f"{parent}: cannot be written: there is no such folder")
    with TemporaryDirectory(prefix=prefix, dir=parent) as made:
        yield Path(made).absolute()


def _remove_stale(target: Path) -> None:
    """Remove the temporary files of killed saves of ``target``.

    Their processes, and the locks these held, are gone. On a folder that several machines or
    containers share, only the lock is reliable.
    """
    pattern = re.compile(re.escape(f".{target.name}.") + r"(\d{1,9})-[0-9a-f]{8}\.tmp")
    with suppress(OSError):
        for path in target.parent.iterdir():
            found = pattern.fullmatch(path.name)
            if found and not process_lives(int(found[1])):
                _remove_unlocked(path)


def _remove_unlocked(path: Path) -> None:
    with suppress(OSError), path.open("rb") as stream:
        if lock_file(stream.fileno()) is not False:
            path.unlink()


def _sync_folder(folder: Path) -> None:
    if os.name != "posix":
        return
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def _reason(error: OSError) -> str:
    return (error.strerror or str(error)).lower()
