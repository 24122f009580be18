"""Where a study runs: its folder, its means, and the finished parts it never computes again."""

from __future__ import annotations

import hashlib
import json
import os
import platform
import secrets
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from segloc import __version__
from segloc.errors import SeglocError
from segloc.system.kernels import instruction_set

from ..parallel import in_parallel
from ..report import code, machine, version_of

T = TypeVar("T")
Task = TypeVar("Task")
Key = tuple[str, Mapping[str, object]]
Update = Callable[[int, int], None]


@contextmanager
def silent(label: str) -> Iterator[Update]:
    """A progress that shows nothing."""
    del label
    yield lambda done, total: None


def mute(text: str) -> None:
    """Take a remark and say nothing."""


@dataclass(frozen=True)
class Workspace:
    """The folder and the means of an evaluation.

    Attributes
    ----------
    out : Path
        The folder of all results; finished parts lie in its folder ``cache``.
    seed, threads, workers : int
        Of whatever is drawn at random; of the engine (0: all cores); processes.
    methods : tuple of str or None
        Only these.
    progress : callable
        ``with progress(label) as update: update(done, total)``.
    say : callable
        Takes remarks of one line.
    command : str
        Command that repeats the work; printed with the results.
    executor : Executor or None
        Runs the tasks instead of ``workers`` processes.
    """

    out: Path
    seed: int = 0
    threads: int = 1
    workers: int = 1
    methods: tuple[str, ...] | None = None
    progress: Callable[[str], AbstractContextManager[Update]] = field(default=silent)
    say: Callable[[str], None] = field(default=mute)
    command: str = ""
    executor: Executor | None = None

    def facts(self, seconds: float, fingerprints: Mapping[str, str]) -> dict[str, Any]:
        """Return the facts that repeat a study.

        ``fingerprints`` are those of weights and descriptors, by method.
        """
        packages = ("numpy", "scipy", "torch", "embreex", "scikit-learn")
        versions = {"segloc": __version__, "python": platform.python_version()}
        return {
            "command": self.command,
            "seed": self.seed,
            "threads": self.threads,
            "workers": self.workers,
            "fingerprints": dict(fingerprints),
            "versions": versions | {name: v for name in packages if (v := version_of(name))},
            "machine": f"{machine()}, {instruction_set()}",
            "seconds": round(seconds, 1),
        }

    @property
    def code(self) -> Mapping[str, str]:
        """Fingerprint of the code that stored parts depend on."""
        return {"trees": code()}

    def cached(
        self,
        name: str,
        settings: Mapping[str, object],
        compute: Callable[[], T],
        save: Callable[[T, Path], object],
        load: Callable[[Path], T],
    ) -> T:
        """Return what ``compute`` returns, computed once for a name and settings.

        Parameters
        ----------
        name : str
            Letters, digits, ``-`` and ``_``.
        settings : dict
            Everything that the result depends on, in values that JSON can hold, fingerprints of
            weights and data included.
        save : callable
            Writes the value to a path that does not exist yet, as a file or as a folder.
        load : callable
            Reads it back. A part that cannot be loaded is computed again.
        """
        found = self.find(name, settings, load)
        if found is not None:
            return found
        value = compute()
        self.keep(name, settings, value, save)
        return value

    def cached_each(
        self,
        title: str,
        keys: Sequence[Key],
        work: Callable[[Task], T],
        tasks: Sequence[Task],
        save: Callable[[T, Path], object],
        load: Callable[[Path], T],
    ) -> list[T]:
        """Do :meth:`cached` for many tasks, each under its (name, settings), in parallel."""
        found = {
            k: part for k, key in enumerate(keys) if (part := self.find(*key, load)) is not None
        }
        left = [k for k in range(len(tasks)) if k not in found]
        for number, value in self.each(title, work, [tasks[k] for k in left]):
            found[left[number]] = value
            self.keep(*keys[left[number]], value, save)
        return [found[k] for k in range(len(tasks))]

    def each(
        self, title: str, work: Callable[[Task], T], tasks: Sequence[Task]
    ) -> Iterator[tuple[int, T]]:
        """Yield the number and result of each task, done in parallel, and show how many are."""
        if not tasks:
            return
        with self.progress(title) as update:
            update(0, len(tasks))
            found = in_parallel(work, tasks, self.workers, self.executor)
            for done, result in enumerate(found, start=1):
                yield result
                update(done, len(tasks))

    def find(
        self, name: str, settings: Mapping[str, object], load: Callable[[Path], T]
    ) -> T | None:
        """Load a stored part; None where there is none or it cannot be loaded."""
        path = self.folder(name, settings)
        if not path.exists():
            return None
        try:
            return load(path)
        except (OSError, ValueError, KeyError, TypeError, EOFError, SeglocError) as error:
            self.say(f"{path}: damaged, computed again ({' '.join(str(error).split())})")
            return None

    def keep(
        self, name: str, settings: Mapping[str, object], value: T, save: Callable[[T, Path], object]
    ) -> None:
        """Store a part."""
        store(self.folder(name, settings), lambda path: save(value, path))

    def cached_json(
        self, name: str, settings: Mapping[str, object], compute: Callable[[], Any]
    ) -> Any:
        """Do :meth:`cached` for a value that JSON can hold; return it as JSON gives it back."""
        value = self.cached(name, settings, compute, save_json, load_json)
        return json.loads(json.dumps(value))

    def folder(self, name: str, settings: Mapping[str, object]) -> Path:
        """Return where a part is stored."""
        depends = {"segloc": __version__, "code": dict(self.code), **settings}
        digest = hashlib.sha256(json.dumps(depends, sort_keys=True).encode()).hexdigest()
        return self.out / "cache" / f"{name}-{digest[:16]}"


def store(path: Path, save: Callable[[Path], object]) -> None:
    """Write a file or a folder, the whole of it or nothing."""
    temporary = path.with_name(f".{path.name}.{os.getpid()}-{secrets.token_hex(4)}.tmp")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        save(temporary)
        remove(path)
        temporary.replace(path)
    except OSError as error:
        where = error.filename or path
        raise SeglocError(f"{where}: cannot be written: {error.strerror or error}") from error
    finally:
        remove(temporary)


def remove(path: Path) -> None:
    """Remove a file or a folder, if it is there."""
    if path.is_dir():
        shutil.rmtree(path, ignore_errors=True)
    else:
        path.unlink(missing_ok=True)


def save_json(value: Any, path: Path) -> None:
    """Write a value that JSON can hold."""
    path.write_text(json.dumps(value, allow_nan=False), "utf-8")


def load_json(path: Path) -> Any:
    """Read what :func:`save_json` wrote."""
    return json.loads(path.read_text("utf-8"))


def save_arrays(arrays: Mapping[str, NDArray[Any]], path: Path) -> None:
    """Write arrays by name."""
    with path.open("wb") as stream:
        np.savez_compressed(stream, **arrays)  # type: ignore[arg-type]


def load_arrays(path: Path) -> dict[str, NDArray[Any]]:
    """Read what :func:`save_arrays` wrote."""
    with path.open("rb") as stream, np.load(stream, allow_pickle=False) as file:
        return dict(file)
