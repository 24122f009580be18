"""What the systems are given and what they answer, as ``.npz`` files of plain arrays.

It needs NumPy alone, so that it can be imported in the environment of any system. A protocol is a
folder: ``views-*.npz`` (what a map may be made of), ``queries.npz`` and, from each system,
``answers-*.npz``.
"""

from __future__ import annotations

import argparse
import time
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

ELSEWHERE = "elsewhere"
"""Group of the queries that were recorded at another place."""


@dataclass
class Clouds:
    """Point clouds with the true pose of each.

    Attributes
    ----------
    poses : (N, 4, 4) float64
        T_map_cloud. A level frame where scans were accumulated, and the sensor's where not.
    scans : (N,) int64
        From how many scans each cloud was gathered.
    within_coverage : (N,) bool
        Whether the map holds the place of a query.
    group : (N,) str
        What is told apart in the tables; the same for all where nothing is.
    points : (M, 3) float32
        Of all clouds, one after another; cloud i is ``points[offsets[i]:offsets[i + 1]]``.
    """

    poses: NDArray[np.float64]
    scans: NDArray[np.int64]
    within_coverage: NDArray[np.bool_]
    group: NDArray[np.str_]
    points: NDArray[np.float32]
    offsets: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.poses)

    def __getitem__(self, i: int) -> NDArray[np.float32]:
        return self.points[self.offsets[i] : self.offsets[i + 1]]

    def save(self, path: Path) -> None:
        _replace(path, **vars(self))

    @classmethod
    def load(cls, path: Path) -> Clouds:
        with np.load(path) as arrays:
            return cls(**arrays)


class Gathering:
    """Clouds that are still being gathered."""

    def __init__(self) -> None:
        self._items: list[tuple[NDArray[np.float32], NDArray[np.float64], int, bool, str]] = []

    def add(
        self,
        points: NDArray[np.float32],
        pose: NDArray[np.float64],
        scans: int = 1,
        within_coverage: bool = True,
        group: str = "all",
    ) -> None:
        self._items.append((points, pose, scans, within_coverage, group))

    def clouds(self) -> Clouds:
        points, poses, scans, within_coverage, group = zip(*self._items, strict=True)
        return Clouds(
            np.stack(poses),
            np.array(scans, dtype=np.int64),
            np.array(within_coverage, dtype=bool),
            np.array(group),
            np.concatenate(points).astype(np.float32),
            np.cumsum([0, *map(len, points)], dtype=np.int64),
        )


class Answers:
    """One system's answers to the queries of a protocol, kept query by query.

    A system with a decision of its own (``decides``) tells which answers it accepts, and why it
    refuses the others; the threshold of all others is set afterwards (see ``compare.py``).

    Attributes
    ----------
    poses : (N, 4, 4) float64
        NaN without an answer.
    scores : (N,) float64
        Larger for better answers; -inf without one.
    ms, wall_ms : (N,) float64
        Processor time, and time by the clock.
    queried, accepted : (N,) bool
    reasons : (N,) str
        Why a query was refused; "" where it was not.
    map_bytes : float
        Size of what the system keeps of the map; NaN if unknown.
    trained : str
        What it was trained on.
    key : int
        Identifies queries, maps, settings and code.
    """

    def __init__(self, count: int, *, decides: bool = False, trained: str = "-", key: int = 0):
        self.poses = np.full((count, 4, 4), np.nan)
        self.scores = np.full(count, -np.inf)
        self.ms, self.wall_ms = np.zeros(count), np.zeros(count)
        self.queried = np.zeros(count, dtype=bool)
        self.accepted = np.zeros(count, dtype=bool)
        self.reasons = np.full(count, "", dtype="<U40")
        self.decides = np.array(decides)
        self.map_bytes = np.array(np.nan)
        self.trained = np.array(trained)
        self.key = np.array(key)

    @classmethod
    def resume(
        cls,
        folder: Path,
        system: str,
        queries: Clouds,
        settings: str,
        *,
        decides: bool = False,
        trained: str = "nothing",
    ) -> Answers:
        """Return the answers kept of the same queries and settings; none without any."""
        form = settings + " ".join(vars(cls(0))) + _sources()
        key = zlib.crc32(form.encode())
        for part in (queries.poses, queries.offsets, queries.points):
            key = zlib.crc32(part.tobytes(), key)
        for file in sorted(folder.glob("views-*.npz")):
            key = zlib.crc32(file.read_bytes(), key)
        path = answers_path(folder, system)
        if path.exists() and int((kept := cls.load(path)).key) == key:
            return kept
        return cls(len(queries), decides=decides, trained=trained, key=key)

    def pending(self, every: int) -> list[int]:
        """Return which queries are still to be answered."""
        return [q for q in range(0, len(self.queried), every) if not self.queried[q]]

    @contextmanager
    def timed(self, query: int) -> Iterator[None]:
        """Add the time spent on a query."""
        start, spent = time.perf_counter(), time.process_time()
        yield
        self.ms[query] += 1e3 * (time.process_time() - spent)
        self.wall_ms[query] += 1e3 * (time.perf_counter() - start)

    def give(self, query: int, pose: NDArray[np.float64], score: float) -> None:
        """Keep an answer."""
        self.poses[query], self.scores[query] = pose, score

    def save(self, folder: Path, system: str, done: int) -> None:
        """Write the file anew, with one more query done."""
        self.queried[done] = True
        _replace(answers_path(folder, system), **vars(self))

    @classmethod
    def load(cls, path: Path) -> Answers:
        with np.load(path) as arrays:
            answers = cls(len(arrays["scores"]))
            for name, array in arrays.items():
                setattr(answers, name, array)
        return answers


def _sources() -> str:
    """Return a digest of the code of all systems, by which their answers are known."""
    sources = [path.read_bytes() for path in sorted(Path(__file__).parent.glob("*.py"))]
    return f"{zlib.crc32(b''.join(sources)):x}"


def answers_path(folder: Path, system: str) -> Path:
    """Return the file of a system's answers."""
    return folder / f"answers-{system}.npz"


def _replace(path: Path, **arrays: Any) -> None:
    """Write arrays to a file that is complete whenever it exists."""
    part = path.with_name(f".{path.name}")
    np.savez(part, **arrays)
    part.replace(path)


def settings_of(options: argparse.Namespace) -> str:
    """Return the options that answers depend on, as text."""
    return str(sorted((k, v) for k, v in vars(options).items() if k not in ("folders", "every")))


def opened(
    folder: Path, options: argparse.Namespace, *systems: str
) -> tuple[Clouds, Clouds, list[Answers], list[int]]:
    """Return the views, the queries, the stored answers of each system, and the pending queries."""
    queries, settings = Clouds.load(folder / "queries.npz"), settings_of(options)
    answers = [Answers.resume(folder, system, queries, settings) for system in systems]
    views = Clouds.load(folder / f"views-{options.views}.npz")
    return views, queries, answers, answers[-1].pending(options.every)


def near(points: NDArray[np.float32], radius_m: float) -> NDArray[np.float32]:
    """Return the points near the sensor, which is at the origin."""
    return np.ascontiguousarray(points[(points[:, :2] ** 2).sum(axis=1) < radius_m**2])


def run(
    parser: argparse.ArgumentParser,
    answer: Callable[[Path, argparse.Namespace], None],
    views: str | None = "scan",
) -> None:
    """Answer the protocols that the command line names, by options that all systems share.

    ``views`` are those that a system takes by default; None if it has an option of its own.
    """
    parser.add_argument("folders", nargs="+", type=Path)
    if views is not None:
        parser.add_argument("--views", default=views, help="long, short or scan")
    parser.add_argument("--every", type=int, default=1, help="answer every N-th query only")
    options = parser.parse_args()
    for folder in options.folders:
        answer(folder, options)
