"""Where a study runs: what it is asked for, and the finished parts it never computes again."""

from __future__ import annotations

import hashlib
import json
import os
import platform
import secrets
import shutil
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, field
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from .._native import __version__, instruction_set
from ..errors import ConfigError, SeglocError

if TYPE_CHECKING:
    from ..simulation.suites import TestSet

T = TypeVar("T")
Update = Callable[[int, int], None]

SCALES = ("small", "full")
_DATA, _ENTRY = "data", "entry.json"


@contextmanager
def silent(label: str) -> Iterator[Update]:
    """A progress that shows nothing."""
    del label
    yield lambda done, total: None


def mute(text: str) -> None:
    """Take a remark and say nothing."""


@dataclass(frozen=True)
class Pair:
    """A recording to map, and one to localize in it.

    Attributes
    ----------
    map, query : Path
        Folders of scans.
    map_poses : Path
        Of the scans to map; its frame is the map's.
    poses : Path or None
        Odometry of the queries, by which they are accumulated; without it each scan stands alone.
    truth : Path or None
        True poses of the queries in the map's frame, to score against.
    map_select, select : str or None
        Which scans; see :func:`segloc.datasets.parse_select`.
    every_m : float or None
        Metres of travel between queries; every scan where it is None.
    """

    map: Path
    query: Path
    map_poses: Path
    poses: Path | None = None
    truth: Path | None = None
    map_select: str | None = None
    select: str | None = None
    every_m: float | None = None


@dataclass(frozen=True)
class Workspace:
    """The folder, the data and the means of an evaluation.

    Attributes
    ----------
    out : Path
        The folder of all results; finished parts lie in its folder ``cache``.
    suite, scale : str
        Of :data:`segloc.simulation.suites.SUITES`; "small" or "full".
    data : Path or None
        KITTI odometry 00: keyframes, scans and their poses, as ``benchmarks/kitti00.sh`` reads it.
    sequences : Pair or None
        A recording to map and one to localize in it, of the user's own.
    seed, threads, workers : int
        Of the simulation; of the engine (0: all cores); processes.
    methods : tuple of str or None
        Only these.
    progress : callable
        ``with progress(label) as update: update(done, total)``.
    say : callable
        Takes remarks of one line.
    command : str
        That repeats the work; printed beside the results.
    """

    out: Path
    suite: str = "six"
    scale: str = "small"
    data: Path | None = None
    sequences: Pair | None = None
    seed: int = 0
    threads: int = 1
    workers: int = 1
    methods: tuple[str, ...] | None = None
    progress: Callable[[str], AbstractContextManager[Update]] = field(default=silent)
    say: Callable[[str], None] = field(default=mute)
    command: str = ""

    def __post_init__(self) -> None:
        if self.scale not in SCALES:
            raise ConfigError(f"scale must be one of {', '.join(SCALES)}, not {self.scale!r}")

    @property
    def sets(self) -> tuple[TestSet, ...]:
        """The test sets of the suite.

        Raises
        ------
        ConfigError
            If there is no such suite.
        """
        from ..simulation.suites import SUITES

        if self.suite not in SUITES:
            raise ConfigError(f"suite must be one of {', '.join(SUITES)}, not {self.suite!r}")
        return SUITES[self.suite]

    def facts(self, seconds: float, fingerprints: Mapping[str, str]) -> dict[str, Any]:
        """What a study says of itself: enough to repeat it.

        ``fingerprints`` are those of weights and descriptors, by method.
        """
        packages = ("numpy", "scipy", "small-gicp", "torch", "embreex", "scikit-learn")
        versions = {"segloc": __version__, "python": platform.python_version()}
        return {
            "command": self.command,
            "suite": self.suite,
            "scale": self.scale,
            "seed": self.seed,
            "threads": self.threads,
            "workers": self.workers,
            "data": None if self.data is None else self.data.name,
            "fingerprints": dict(fingerprints),
            "versions": versions | {name: v for name in packages if (v := _version(name))},
            "machine": f"{_processor()}, {os.cpu_count()} cores, {instruction_set()}",
            "seconds": round(seconds, 1),
        }

    def cached(
        self,
        name: str,
        settings: Mapping[str, object],
        compute: Callable[[], T],
        save: Callable[[T, Path], object],
        load: Callable[[Path], T],
    ) -> T:
        """What ``compute`` returns, computed once for a name and settings.

        Parameters
        ----------
        name : str
            Of the part, for people; letters, digits, ``-`` and ``_``.
        settings : dict
            Everything that the result depends on, in values that JSON can hold, fingerprints of
            weights and data included.
        compute : callable
        save : callable
            Writes the value to a path that does not exist yet, as a file or as a folder.
        load : callable
            Reads it back. A part whose files have changed, or that cannot be loaded, is computed
            again.

        Raises
        ------
        SeglocError
            If the folder cannot be written.
        """
        found = self.find(name, settings, load)
        if found is not None:
            return found
        value = compute()
        self.keep(name, settings, value, save)
        return value

    def find(
        self, name: str, settings: Mapping[str, object], load: Callable[[Path], T]
    ) -> T | None:
        """A finished part, or None where there is none or its files are damaged."""
        folder = self._folder(name, settings)
        if not folder.exists():
            return None
        try:
            _check(folder)
            return load(folder / _DATA)
        except (OSError, ValueError, KeyError, TypeError, EOFError, SeglocError) as error:
            self.say(f"{folder}: damaged, computed again ({_line(error)})")
            return None

    def keep(
        self,
        name: str,
        settings: Mapping[str, object],
        value: T,
        save: Callable[[T, Path], object],
    ) -> None:
        """Store a finished part, the whole of it or nothing.

        Raises
        ------
        SeglocError
            If the folder cannot be written.
        """
        entry: dict[str, object] = {"name": name, "settings": settings}
        _store(self._folder(name, settings), entry, lambda path: save(value, path))

    def _folder(self, name: str, settings: Mapping[str, object]) -> Path:
        return self.out / "cache" / f"{name}-{_digest(settings)[:16]}"

    def cached_json(
        self, name: str, settings: Mapping[str, object], compute: Callable[[], Any]
    ) -> Any:
        """:meth:`cached` for a value that JSON can hold; returned as JSON gives it back."""
        value = self.cached(name, settings, compute, save_json, load_json)
        return json.loads(json.dumps(value))


def save_json(value: Any, path: Path) -> None:
    """Write a value that JSON can hold."""
    path.write_text(json.dumps(value, allow_nan=False), "utf-8")


def load_json(path: Path) -> Any:
    """What :func:`save_json` wrote."""
    return json.loads(path.read_text("utf-8"))


def save_arrays(arrays: Mapping[str, NDArray[Any]], path: Path) -> None:
    """Write arrays by name."""
    with path.open("wb") as stream:
        np.savez_compressed(stream, **arrays)  # type: ignore[arg-type]


def load_arrays(path: Path) -> dict[str, NDArray[Any]]:
    """What :func:`save_arrays` wrote."""
    with np.load(path, allow_pickle=False) as file:
        return dict(file)


def _store(folder: Path, entry: dict[str, object], save: Callable[[Path], object]) -> None:
    """Write an entry of the cache: the whole of it, or nothing."""
    temporary = folder.with_name(f".{folder.name}.{os.getpid()}-{secrets.token_hex(4)}.tmp")
    try:
        temporary.mkdir(parents=True)
        save(temporary / _DATA)
        entry = {**entry, "sha256": _digests(temporary / _DATA)}
        (temporary / _ENTRY).write_text(json.dumps(entry, indent=1, default=str) + "\n", "utf-8")
        if folder.exists():
            shutil.rmtree(folder)
        temporary.replace(folder)
    except OSError as error:
        where = error.filename or folder
        raise SeglocError(f"{where}: cannot be written: {error.strerror or error}") from error
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def _check(folder: Path) -> None:
    entry = load_json(folder / _ENTRY)
    if entry["sha256"] != _digests(folder / _DATA):
        raise ValueError("its files do not match their checksums")


def _digests(path: Path) -> dict[str, str]:
    files = sorted(p for p in path.rglob("*") if p.is_file()) if path.is_dir() else [path]
    return {str(file.relative_to(path.parent)): _file_digest(file) for file in files}


def _file_digest(path: Path) -> str:
    digest = hashlib.sha256()
    with path.open("rb") as stream:
        while block := stream.read(1 << 20):
            digest.update(block)
    return digest.hexdigest()


def _digest(settings: Mapping[str, object]) -> str:
    text = json.dumps({"segloc": __version__, **settings}, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()


def _line(error: BaseException) -> str:
    return " ".join(str(error).split()) or type(error).__name__


def _version(package: str) -> str | None:
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return None


def _processor() -> str:
    from .bench.report import machine

    return machine()
