"""Writing files so that a crash or a full disk never leaves half of one."""

from __future__ import annotations

import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

from .errors import SeglocError


@contextmanager
def replacing(path: str | Path) -> Iterator[BinaryIO]:
    """Open a temporary file that takes the place of ``path`` when the block ends well.

    The bytes are on the disk before the rename and the rename is before the return, so at any
    moment ``path`` is either the old file or the whole new one. If the block or the disk fails,
    the temporary file is removed and ``path`` is as it was.

    Raises
    ------
    SeglocError
        If the file cannot be written; names it and the fault.
    """
    target = checked_target(Path(path))
    temporary = target.with_name(f".{target.name}.{os.getpid()}-{secrets.token_hex(4)}.tmp")
    try:
        with temporary.open("xb") as stream:
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
