"""Storage of tiles: a folder, or a URL of fsspec, with a bounded cache on disk."""

from __future__ import annotations

import os
import secrets
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, TypeAlias, TypeVar

from ..errors import MapFormatError, SeglocError, requires
from ..system.files import make_folder, write_bytes
from ..system.locks import exclusive
from ..system.text import one_line
from .index import INDEX, TileFile, digest_of

Answer = TypeVar("Answer")

LEASE, WAIT_S, POLL_S = "writing.lease", 600.0, 0.2
"""File that marks a writer at a URL, and how long other writers wait."""


class Folder:
    """Store in a folder on disk; ``where`` is its path."""

    def __init__(self, where: str) -> None:
        self.where, self._path = where, Path(where)

    def read(self, name: str, most: int) -> bytes:
        """Read a file of at most ``most`` bytes, and one more byte of a longer one.

        Raises
        ------
        OSError
        """
        with (self._path / name).open("rb") as stream:
            return stream.read(most + 1)

    def write(self, name: str, data: bytes) -> None:
        """Write a file atomically."""
        make_folder(self._path)
        write_bytes(self._path / name, data)

    def names(self) -> list[str]:
        """List all files."""
        return sorted(p.name for p in self._path.iterdir()) if self._path.is_dir() else []

    def remove(self, name: str) -> None:
        (self._path / name).unlink(missing_ok=True)

    @contextmanager
    def alone(self) -> Iterator[None]:
        """Exclude other writers in a ``with`` block."""
        make_folder(self._path)
        with exclusive(self._path / INDEX):
            yield


class Remote:
    """Store at a URL of fsspec, with the methods of :class:`Folder`."""

    def __init__(self, where: str) -> None:
        with requires("fsspec", "tiles", f"opening {where}"):
            from fsspec.core import url_to_fs
        try:
            self._files, self._root = url_to_fs(where)
        except (ImportError, ValueError) as error:
            raise SeglocError(f"{where}: cannot be opened: {error}") from error
        self.where = where

    def read(self, name: str, most: int) -> bytes:
        data: Any = self._files.cat_file(f"{self._root}/{name}", start=0, end=most + 1)
        return bytes(data)

    def write(self, name: str, data: bytes) -> None:
        self._make()
        with _writing(f"{self.where}/{name}"):
            self._files.pipe_file(f"{self._root}/{name}", data)

    def names(self) -> list[str]:
        try:
            with _writing(self.where):
                found = self._files.ls(self._root, detail=False)
        except FileNotFoundError:
            return []
        return sorted(str(path).rsplit("/", 1)[-1] for path in found)

    def remove(self, name: str) -> None:
        with _writing(f"{self.where}/{name}"):
            self._files.rm_file(f"{self._root}/{name}")

    @contextmanager
    def alone(self) -> Iterator[None]:
        """Exclude other writers by a lease file."""
        path, mine = f"{self._root}/{LEASE}", secrets.token_hex(8)
        self._make()
        ends = time.monotonic() + WAIT_S
        while not self._lease(path, mine):
            if time.monotonic() > ends:
                raise SeglocError(
                    f"{self.where}: locked by another writer for {WAIT_S:g} s: wait for it, or "
                    f"remove {LEASE} if there is none"
                )
            time.sleep(POLL_S)
        try:
            yield
        finally:
            with suppress(Exception):  # of any library behind fsspec
                if self._files.cat_file(path) == mine.encode():
                    self._files.rm_file(path)

    def _lease(self, path: str, mine: str) -> bool:
        try:
            with _writing(self.where):
                self._files.pipe_file(path, mine.encode(), mode="create")
                return bool(self._files.cat_file(path) == mine.encode())
        except FileExistsError:
            return False

    def _make(self) -> None:
        with _writing(self.where), suppress(NotImplementedError):
            self._files.makedirs(self._root, exist_ok=True)


@contextmanager
def _writing(where: str) -> Iterator[None]:
    """Turn what a store refuses, of any library behind fsspec, into one line.

    That a file is there already, or not, is left as it is.
    """
    try:
        yield
    except (SeglocError, FileExistsError, FileNotFoundError):
        raise
    except Exception as error:
        raise SeglocError(f"{where}: cannot be written: {one_line(error)}") from error


Store: TypeAlias = Folder | Remote


def holds_tiles(where: str) -> bool:
    """Return whether a path or URL holds tiles, not a map file.

    Raises
    ------
    MapFormatError
        If it is a folder without tiles.
    """
    folder = Path(where)
    if "://" in where or not folder.is_dir():
        return "://" in where
    if not (folder / INDEX).exists():
        maps = sorted(path.name for path in folder.glob("*.segmap"))
        listed = f"pass one of its maps: {', '.join(maps[:5])}" if maps else "it holds no maps"
        raise MapFormatError(f"{where}: a folder without {INDEX}, so not a tiled map: {listed}")
    return True


def store_of(where: str | Path) -> Store:
    """Return the store of a path or URL.

    Raises
    ------
    MissingDependency
        If it is a URL, and fsspec is not installed.
    SeglocError
        If the URL cannot be opened.
    """
    text = str(where)
    if text.startswith("file://"):
        text = text.removeprefix("file://")
    return Remote(text) if "://" in text else Folder(text)


class Reader:
    """Read the files of a store, and reject those that do not match the index.

    Parameters
    ----------
    store : Store
    cache : path, optional
        Folder for copies of remote files; None to read files in place.
    cache_bytes : int
        Maximum size of the copies; the least recently used are removed first.
    timeout_s : float
        Maximum time for a file.
    """

    def __init__(
        self, store: Store, cache: Path | None, cache_bytes: int, timeout_s: float
    ) -> None:
        self._store, self._cache = store, cache
        self._cache_bytes, self._timeout_s = cache_bytes, timeout_s

    def tile(self, tile: TileFile) -> bytes:
        """Read a tile from the cache or the store.

        Raises
        ------
        MapFormatError
            If the file is missing, takes too long, or does not match the index; names it.
        """
        copy = None if self._cache is None else self._cache / tile.file
        if copy is not None:
            with suppress(OSError):
                data = copy.read_bytes()
                if digest_of(data) == tile.digest:
                    os.utime(copy)
                    return data
        data = self._read_checked(tile)
        if copy is not None:
            self._keep(copy, data)
        return data

    def _read_checked(self, tile: TileFile) -> bytes:
        """Read a tile from the store, with one retry if it is incomplete."""
        for last in (False, True):
            try:
                data = self.fetch(tile.file, tile.bytes)
            except MapFormatError as error:
                if last or isinstance(error.__cause__, (TimeoutError, FileNotFoundError)):
                    raise
                continue
            if len(data) == tile.bytes and digest_of(data) == tile.digest:
                return data
        raise MapFormatError(
            f"{self._store.where}/{tile.file}: damaged: it does not match the index"
        )

    def fetch(self, name: str, most: int) -> bytes:
        """Read a file of at most ``most`` bytes from the store.

        Raises
        ------
        MapFormatError
            If it is missing, takes too long, or cannot be read; names it.
        """
        where = f"{self._store.where}/{name}"
        try:
            return within(self._timeout_s, lambda: self._store.read(name, most))
        except TimeoutError as error:
            raise MapFormatError(f"{where}: no answer within {self._timeout_s:g} s") from error
        except FileNotFoundError as error:
            raise MapFormatError(
                f"{where}: no such file; if the tiles were changed twice since, open them again"
            ) from error
        except Exception as error:  # of any library behind fsspec
            raise MapFormatError(f"{where}: cannot be read: {one_line(error)}") from error

    def _keep(self, copy: Path, data: bytes) -> None:
        """Copy data into the cache; errors such as a full disk are ignored."""
        with suppress(OSError, SeglocError):
            copy.parent.mkdir(parents=True, exist_ok=True)
            write_bytes(copy, data)
            kept = sorted(
                (path for path in copy.parent.iterdir() if path.suffix == ".segmap"),
                key=lambda path: path.stat().st_mtime_ns,
            )
            excess = sum(path.stat().st_size for path in kept) - self._cache_bytes
            for path in kept:
                if excess <= 0 or path == copy:
                    break
                excess -= path.stat().st_size
                path.unlink(missing_ok=True)


def within(seconds: float, work: Callable[[], Answer]) -> Answer:
    """Run ``work`` with a time limit.

    Raises
    ------
    TimeoutError
        If it takes longer; its thread is abandoned.
    """
    answers: list[Answer] = []
    errors: list[BaseException] = []

    def run() -> None:
        try:
            answers.append(work())
        except BaseException as error:
            errors.append(error)

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    thread.join(seconds)
    if errors:
        raise errors[0]
    if not answers:
        raise TimeoutError
    return answers[0]
