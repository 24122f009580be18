"""Writing files so that a crash or a full disk never leaves half of one.

The order, which :func:`replacing` keeps to:

1. a temporary file ``.NAME.PID-RANDOM.tmp`` is made in the same folder and locked;
2. the bytes are written, and flushed to the disk (fsync of the file);
3. it is renamed to NAME, which takes the place of the old file at once;
4. the rename is flushed to the disk (fsync of the folder).

So NAME is the old file or the whole new one, after a kill at any moment and after a loss of power
too, and once the save has returned it is the new one. What a killed save leaves is removed by the
next save of that file.
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
from .locks import locked, process_lives


@contextmanager
def replacing(path: str | Path, *, sweep: bool = True) -> Iterator[BinaryIO]:
    """Open a temporary file that takes the place of ``path`` when the block ends well.

    At any moment ``path`` is either the old file or the whole new one. If the block or the disk
    fails, the temporary file is removed and ``path`` is as it was.

    Parameters
    ----------
    path : path
    sweep : bool
        Whether to look for what killed saves of that file left, which lists the folder: not worth
        it for each of many files.

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
            locked(stream.fileno())  # until it is closed: says that its writer lives
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


def write_text(path: str | Path, text: str) -> None:
    """Write ``text`` as UTF-8 by way of :func:`replacing`."""
    with replacing(path) as stream:
        stream.write(text.encode())


def checked_target(path: Path) -> Path:
    """The file that ``path`` stands for, if one can be written there.

    Raises
    ------
    SeglocError
        If it is a folder or a device, or its folder does not exist.
    """
    target = Path(os.path.realpath(path))  # a link keeps pointing to the file
    if target.is_dir():
        raise SeglocError(f"{path}: cannot be written: is a directory")
    if target.exists() and not target.is_file():
        raise SeglocError(f"{path}: cannot be written: is not a regular file")
    if not target.parent.is_dir():
        raise SeglocError(f"{path}: cannot be written: there is no folder {target.parent}")
    return target


@contextmanager
def folder_in(parent: str | Path | None, prefix: str) -> Iterator[Path]:
    """A folder for a while, in another; by default in the system's for temporary files.

    Raises
    ------
    SeglocError
        If there is no such other.
    """
    if parent is not None and not Path(parent).is_dir():
        raise SeglocError(f"{parent}: cannot be written: there is no such folder")
    with TemporaryDirectory(prefix=prefix, dir=parent) as made:
        yield Path(made).absolute()


def _remove_stale(target: Path) -> None:
    """Remove the temporary files of saves of ``target`` that were killed.

    Their processes are gone, and so are the locks that these held; on a folder that several
    machines or containers share the lock alone tells.
    """
    pattern = re.compile(re.escape(f".{target.name}.") + r"(\d{1,9})-[0-9a-f]{8}\.tmp")
    with suppress(OSError):
        for path in target.parent.iterdir():
            found = pattern.fullmatch(path.name)
            if found and not process_lives(int(found[1])):
                _remove_unlocked(path)


def _remove_unlocked(path: Path) -> None:
    with suppress(OSError), path.open("rb") as stream:
        if locked(stream.fileno()) is not False:
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
