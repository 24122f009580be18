"""Fair timing: interleaved runs of ours and of every rival, and the machine's own speed."""

from __future__ import annotations

import importlib
import multiprocessing
import os
import statistics
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cache
from typing import Any, TypeVar

import numpy as np

from segloc import geometry
from segloc.system.text import quantity
from segloc.types import Float32, Float64, Int64, Pose, Scan

from ..outcomes import pose_error
from ..report import Cell, Table
from ..stages import clock_for

Result = TypeVar("Result")
Runs = Mapping[str, Callable[[], object]]

OURS = "segloc"
"""Name of our own run among the others."""

_BUDGET_S = 2.0
_SETTLE_S = 0.1
_WAKE_S = 0.05
_MIN_RUNS = 2
_BOUND = "bound"
_SGEMM_SIZE = 1024
_COPIED = 1 << 27
_SGEMM_FLOPS = 2.0 * _SGEMM_SIZE**3
_THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


@dataclass(frozen=True)
class Row:
    """What one benchmark measured with one number of threads.

    Attributes
    ----------
    ours_ms : float
        Median; see :func:`interleaved`.
    rivals : dict of str to float
        The same for everything that was run against it, milliseconds.
    bound_ms : float or None
        What the machine cannot go below, measured in the same run; None where nothing tells.
    bound : str
        What the bound is.
    details : dict of str to float
        Parts of our time, or figures beside it; each name ends with its unit.
    skipped : tuple of str
        Rivals that are not installed.
    note : str
        How to read the row.
    """

    name: str
    threads: int
    ours_ms: float
    rivals: dict[str, float] = field(default_factory=dict)
    bound_ms: float | None = None
    bound: str = ""
    details: dict[str, float] = field(default_factory=dict)
    skipped: tuple[str, ...] = ()
    note: str = ""


def interleaved(runs: Runs, threads: int, repeats: int) -> dict[str, float]:
    """Median milliseconds of each run: one of each in turn, again and again, after a warm-up.

    With one thread the time is the processor's, which other work on the machine disturbs less than
    the clock on the wall; with several it is the wall's. Then each run first waits until the idle
    threads of the one before have stopped spinning for work, and goes on for a while untimed, until
    its own threads are awake (a virtual processor takes milliseconds). A run that is slow is
    repeated less often than the others, but at least twice.
    """
    clock = clock_for(threads)
    times: dict[str, list[float]] = {name: [] for name in runs}
    for run in runs.values():
        run()
    for _ in range(repeats):
        for name, run in runs.items():
            if len(times[name]) >= _MIN_RUNS and sum(times[name]) > _BUDGET_S:
                continue
            if threads > 1:
                time.sleep(_SETTLE_S)
                _wake(run)
            start = clock()
            run()
            times[name].append(clock() - start)
    return {name: 1e3 * statistics.median(values) for name, values in times.items()}


def _wake(run: Callable[[], object]) -> None:
    end = time.perf_counter() + _WAKE_S
    while time.perf_counter() < end:
        run()


def row(
    name: str,
    threads: int,
    repeats: int,
    runs: Runs,
    *,
    bound: Bound,
    details: Mapping[str, float] | None = None,
    skipped: tuple[str, ...] = (),
    note: str = "",
) -> Row:
    """Time ``runs``, one of which is :data:`OURS`, in turns with what bounds them.

    NumPy must have been given the same number of threads: see :func:`in_process`.
    """
    times = interleaved({**runs, _BOUND: bound.run()}, threads, repeats)
    limit, ours = times.pop(_BOUND) * bound.share, times.pop(OURS)
    return Row(name, threads, ours, times, limit, bound.text, dict(details or {}), skipped, note)


@dataclass(frozen=True)
class Bound:
    """What work cannot do without: arithmetic at the rate of NumPy's float32 matrix product, or
    bytes at the rate of a copy."""

    what: str
    flops: float = 0.0
    bytes: float = 0.0

    @property
    def text(self) -> str:
        """What the bound is."""
        return f"{self.what} at {'sgemm' if self.flops else 'a copy'}'s rate"

    @property
    def share(self) -> float:
        """The bound over the time of :meth:`run`."""
        return self.flops / _SGEMM_FLOPS if self.flops else self.bytes / _COPIED

    def run(self) -> Callable[[], object]:
        """Return the matrix product, or the copy."""
        return _matrix_product() if self.flops else _copy()


def _matrix_product() -> Callable[[], object]:
    rng = np.random.default_rng(0)
    a, b = rng.random((2, _SGEMM_SIZE, _SGEMM_SIZE), dtype=np.float32)
    out = np.empty_like(a)
    return lambda: np.matmul(a, b, out=out)


def _copy() -> Callable[[], object]:
    source = np.ones(_COPIED // 2, np.uint8)  # zeros would be one page, read from a cache
    target = np.empty_like(source)
    return lambda: np.copyto(target, source)


@cache
def copy_gb_s() -> float:
    """Return the rate at which this machine copies memory, bytes read and written [GB/s]."""
    return _COPIED / interleaved({"": _copy()}, 1, 7)[""] / 1e6


def optional(*names: str) -> list[Any] | None:
    """The modules of these names, or None if one is not installed."""
    try:
        return [importlib.import_module(name) for name in names]
    except ImportError:
        return None


def in_process(threads: int, work: Callable[..., Result], *arguments: object) -> Result:
    """Run ``work`` in a fresh process where NumPy and its like use that many threads."""
    with (
        _environment(thread_variables(threads)),
        ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool,
    ):
        return pool.submit(work, *arguments).result()


def thread_variables(threads: int) -> dict[str, str]:
    """Return the environment in which NumPy and its like use that many threads."""
    return dict.fromkeys(_THREAD_VARIABLES, str(threads))


@contextmanager
def _environment(changes: Mapping[str, str]) -> Iterator[None]:
    before = {name: os.environ.get(name) for name in changes}
    os.environ.update(changes)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


COLUMNS = ("what", "threads", "ours (ms)", "rivals (times ours)", "bound (ms)")


def table_rows(row: Row) -> list[tuple[str, str, str]]:
    """(what, ms, how many times ours) of ours, of every rival and of the bound."""
    threads = quantity(row.threads, "threads")
    rows = [(f"{row.name}, {threads}", _ms(row.ours_ms), "1.0")]
    rows += [(f"  {name}", _ms(ms), ratio) for name, ms, ratio in rivals_of(row)]
    if row.bound_ms is not None:
        rows.append((f"  bound: {row.bound}", _ms(row.bound_ms), _ratio(row.bound_ms, row.ours_ms)))
    return rows


def rivals_of(row: Row) -> list[tuple[str, float, str]]:
    """(name, ms, how many times ours) of every rival, the fastest first."""
    ordered = sorted(row.rivals.items(), key=lambda item: item[1])
    return [(name, ms, _ratio(ms, row.ours_ms)) for name, ms in ordered]


def _ms(value: float) -> str:
    return f"{value:.2f}" if value < 100 else f"{value:.0f}"


def _ratio(theirs: float, ours: float) -> str:
    return f"{theirs / ours:.1f}" if theirs > ours else f"{theirs / ours:.2f}"


def tables(rows: Sequence[Row]) -> list[Table]:
    """Tabulate kernels beside other software and their bounds; none without rows."""
    told = ((row.name, remark(row)) for row in rows)
    notes = "\n".join(f"- `{name}`: {text}" for name, text in told if text)
    return [Table(COLUMNS, [_kernel(row) for row in rows], notes, "Kernels")] if rows else []


def remark(row: Row) -> str:
    """Return the figures beside a row and its note as text."""
    figures = [f"{name} {value:.4g}" for name, value in row.details.items()]
    return ", ".join([*figures, *([row.note] if row.note else [])])


def _kernel(row: Row) -> tuple[Cell, ...]:
    rivals = "; ".join(f"{name} {ratio}x" for name, _, ratio in rivals_of(row))
    bound = None
    if row.bound_ms is not None:
        bound = (
            f"{row.bound_ms:.3g} ({100 * row.bound_ms / row.ours_ms:.0f} % of ours), {row.bound}"
        )
    ours_ms = float(f"{row.ours_ms:.3g}")  # as many digits as two runs share
    return f"`{row.name}`", row.threads, ours_ms, rivals or None, bound


def segments(count: int, points: int = 256, seed: int = 0) -> Float32:
    """Shells of boxes of the sizes of street furniture, cars and walls, (count, points, 3)."""
    rng = np.random.default_rng(seed)
    half = rng.uniform([0.2, 0.2, 0.5], [4.0, 1.0, 2.0], (count, 1, 3))
    shell = rng.uniform(-1, 1, (count, points, 3))
    face = rng.integers(0, 3, (count, points, 1))
    np.put_along_axis(shell, face, np.sign(np.take_along_axis(shell, face, 2)), 2)
    noisy = shell * half + rng.normal(0, 0.02, shell.shape)
    return noisy.astype(np.float32)


def descriptors(count: int, dim: int = 16, seed: int = 0, spread: float = 1.0) -> Float32:
    """Normally distributed vectors, (count, dim)."""
    rng = np.random.default_rng(seed)
    return rng.normal(0, spread, (count, dim)).astype(np.float32)


class Plaza:
    """Boxes of random sizes on uneven ground, dense with points: a scene that needs no simulator.

    Attributes
    ----------
    points : (N, 3) float64
        World frame, metres; the plaza's middle is the origin.
    """

    def __init__(self, seed: int = 0, objects: int = 300, size_m: float = 200.0) -> None:
        rng = np.random.default_rng([seed, 77])
        ground = rng.uniform(-size_m / 2, size_m / 2, (int(size_m**2), 3))
        ground[:, 2] = 0.2 * np.sin(ground[:, 0] / 6) + rng.normal(0, 0.02, len(ground))
        parts = [ground]
        for x, y in rng.uniform(-size_m / 2, size_m / 2, (objects, 2)):
            half = rng.uniform([0.3, 0.3, 0.8], [4.0, 1.0, 2.5])
            shell = segments(1, 700, int(rng.integers(1 << 31)))[0]
            shell *= half / np.abs(shell).max(axis=0)
            turn = geometry.yaw_transform(rng.uniform(0, np.pi), (x, y, half[2]))
            parts.append(geometry.transform(turn, shell))
        self.points: Float64 = np.vstack(parts)

    def scan(self, T_world_sensor: Pose, seed: int = 0) -> Scan:
        """Every point within 50 m, with 2 cm of noise; posed."""
        points = geometry.transform(geometry.inverse(T_world_sensor), self.points)
        points = points[np.hypot(points[:, 0], points[:, 1]) < 50.0]
        points += np.random.default_rng(seed).normal(0, 0.02, points.shape)
        return Scan(points, stamp=float(seed), T_odom_sensor=T_world_sensor)


def local_cloud() -> Float32:
    """Return at most 45 000 points within 50 m on a plaza, voxelised at 0.2 m, (N, 3)."""
    rng = np.random.default_rng([0, 78])
    shells = segments(100, 900).astype(np.float64) * [1.0, 2.0, 1.0]
    places = rng.uniform(-50, 50, (len(shells), 1, 3)) * [1, 1, 0] + [0, 0, 2.0]
    cloud = (shells + places).reshape(-1, 3)
    _, first = np.unique(np.floor(cloud / 0.2).astype(np.int64), axis=0, return_index=True)
    return np.ascontiguousarray(cloud[np.sort(first)[:45_000]], dtype=np.float32)


@dataclass(frozen=True)
class MatchProblem:
    """Centroid matches of which few are true.

    Attributes
    ----------
    query : (P, 3) float64
    mapped : (M, 3) float64
    match_query, match_map : (N,) int64
        Best match first.
    T_map_local : (4, 4) float64
        The truth.
    """

    query: Float64
    mapped: Float64
    match_query: Int64
    match_map: Int64
    T_map_local: Pose

    def found(self, poses: Float64) -> bool:
        """Whether the first of the poses is the true one, within 1 m and 3 degrees."""
        if len(poses) == 0:
            return False
        metres, degrees = pose_error(poses[0], self.T_map_local)
        return metres < 1.0 and degrees < 3.0


def match_problem() -> MatchProblem:
    """Matches of a query cloud with a map of 1 km by 1 km.

    One percent of the matches are true, at most one per query; true matches tend to come first.
    """
    queries, neighbours, mapped = 300, 25, 50_000
    rng = np.random.default_rng([0, 79])
    query = np.column_stack([rng.uniform(-50, 50, (queries, 2)), rng.uniform(0.5, 4, queries)])
    place = np.column_stack([rng.uniform(-500, 500, (mapped, 2)), rng.uniform(0.5, 4, mapped)])
    T = geometry.yaw_transform(rng.uniform(-np.pi, np.pi), (*rng.uniform(-400, 400, 2), 0.3))
    count = queries * neighbours
    match_query = np.repeat(np.arange(queries), neighbours)
    match_map = rng.integers(0, mapped, count)
    true = rng.choice(queries, round(0.01 * count), replace=False)
    place[true] = geometry.transform(T, query[true]) + rng.normal(0, 0.15, (len(true), 3))
    at = true * neighbours
    match_map[at] = true
    score = rng.normal(0, 1, count)
    score[at] += 1.5
    order = np.argsort(-score)
    return MatchProblem(query, place, match_query[order], match_map[order], T)
