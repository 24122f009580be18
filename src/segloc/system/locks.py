"""Locks between processes that end with their holder: ``flock``, if the system has it."""

from __future__ import annotations

import errno
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from ..errors import SeglocError

try:
    import fcntl
except ImportError:  # Windows: no such locks; `lock_file` returns None
    fcntl = None  # type: ignore[assignment]

_UNABLE = {errno.ENOLCK, errno.EOPNOTSUPP, errno.ENOSYS, errno.EINVAL}


@contextmanager
def exclusive(path: str | Path, waiting: Callable[[], None] | None = None) -> Iterator[None]:
    """Exclude other processes from changing a file while the block reads and replaces it.

    Later callers wait. The lock is on a file ``.NAME.lock`` beside ``path``, removed at the end. A
    killed holder leaves that file without a lock, so it blocks nobody. Threads of one process
    exclude each other, too. Reading, and :func:`.files.replacing` a file that was not read before,
    need no lock. Systems and disks without ``flock`` have none.

    Parameters
    ----------
    path : path
        Need not exist; its folder must.
    waiting : callable, optional
        Called once if another process holds the lock.

    Raises
    ------
    SeglocError
        If the folder cannot be written to.
    """
    target = Path(os.path.realpath(path))
    lock = target.with_name(f".{target.name}.lock")
    try:
        handle = _acquire(lock, waiting)
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        raise SeglocError(f"{path}: cannot be written: {reason}") from error
    try:
        yield
    finally:
        with suppress(OSError):
            lock.unlink()  # while held: waiting processes notice that it is another file
        os.close(handle)


def lock_file(handle: int, *, wait: bool = False) -> bool | None:
    """Lock an open file until it is closed; return False if it is held, None without locks."""
    if fcntl is None:
        return None
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
    except BlockingIOError:
        return False
    except OSError as error:
        if error.errno in _UNABLE:
            return None
        raise
    return True


def process_lives(number: int) -> bool:
    """Return whether a process of that number exists; True if unknown."""
    if os.name != "posix":
        return True
    try:
        os.kill(number, 0)
    except ProcessLookupError:
        return False
    except (OSError, OverflowError):
        return True
    return True


def _acquire(lock: Path, waiting: Callable[[], None] | None) -> int:
    while True:
        handle = os.open(lock, os.O_RDWR | os.O_CREAT | getattr(os, "O_CLOEXEC", 0), 0o666)
        try:
            if lock_file(handle) is False:
                if waiting:
                    waiting()
                waiting = None
                lock_file(handle, wait=True)
            if _still_there(lock, handle):
                return handle
        except BaseException:
            os.close(handle)
            raise
        os.close(handle)


def _still_there(lock: Path, handle: int) -> bool:
    """Return whether the opened file still has that name, or was removed by its last holder."""
    try:
        return os.path.samestat(lock.stat(), os.fstat(handle))
    except FileNotFoundError:
        return False
