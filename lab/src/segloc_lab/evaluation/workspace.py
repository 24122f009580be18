"""Where a study runs: its folder, its means, and the finished parts it never computes again."""

from __future__ import annotations

import json
import os
import platform
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, field
from importlib import metadata
from pathlib import Path
from typing import Any, TypeVar

from segloc._native import __version__, instruction_set
from segloc.errors import SeglocError
from segloc.system.machine import processor
from segloc.system.processes import in_parallel

from . import cache

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
        That repeats the work; printed beside the results.
    executor : Executor or None
        What does the tasks, in place of ``workers`` processes.
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
        """What a study says of itself: enough to repeat it.

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
            "versions": versions | {name: v for name in packages if (v := _version(name))},
            "machine": f"{processor()}, {os.cpu_count()} cores, {instruction_set()}",
            "seconds": round(seconds, 1),
        }

    @property
    def code(self) -> Mapping[str, str]:
        """Fingerprints of the code whose finished parts are taken for one's own; empty: of any."""
        return {}

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

    def cached_each(
        self,
        title: str,
        keys: Sequence[Key],
        work: Callable[[Task], T],
        tasks: Sequence[Task],
        save: Callable[[T, Path], object],
        load: Callable[[Path], T],
    ) -> list[T]:
        """:meth:`cached` for many tasks, each under its (name, settings), done in parallel.

        ``work`` and ``tasks`` are those of :func:`segloc.system.processes.as_finished`; ``title``
        names the progress.
        """
        found = {
            k: part for k, key in enumerate(keys) if (part := self.find(*key, load)) is not None
        }
        left = [k for k in range(len(tasks)) if k not in found]
        with self.progress(title) as update:
            update(0, len(left))
            done = in_parallel(work, [tasks[k] for k in left], self.workers, self.executor)
            for count, (number, value) in enumerate(done, 1):
                found[left[number]] = value
                self.keep(*keys[left[number]], value, save)
                update(count, len(left))
        return [found[k] for k in range(len(tasks))]

    def find(
        self, name: str, settings: Mapping[str, object], load: Callable[[Path], T]
    ) -> T | None:
        """A finished part, or None where there is none or its files are damaged."""
        folder = self.folder(name, settings)
        if not folder.exists():
            return None
        try:
            cache.check(folder)
            return load(folder / cache.DATA)
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
        entry: dict[str, object] = {"name": name, "settings": self._of_code(settings)}
        cache.store(self.folder(name, settings), entry, lambda path: save(value, path))

    def folder(self, name: str, settings: Mapping[str, object]) -> Path:
        """Where a part lies, or will."""
        return self.out / "cache" / f"{name}-{cache.digest(self._of_code(settings))[:16]}"

    def _of_code(self, settings: Mapping[str, object]) -> Mapping[str, object]:
        return {**settings, "code": dict(self.code)} if self.code else settings

    def cached_json(
        self, name: str, settings: Mapping[str, object], compute: Callable[[], Any]
    ) -> Any:
        """:meth:`cached` for a value that JSON can hold; returned as JSON gives it back."""
        value = self.cached(name, settings, compute, cache.save_json, cache.load_json)
        return json.loads(json.dumps(value))


def _line(error: BaseException) -> str:
    return " ".join(str(error).split()) or type(error).__name__


def _version(package: str) -> str | None:
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return None
