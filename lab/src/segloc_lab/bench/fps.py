"""Farthest-point sampling: 300 segments of 256 points, 160 samples of each."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from segloc.errors import SeglocError
from segloc.system import kernels
from segloc.types import Float32

from . import harness
from .harness import OURS, Bound, Row, optional, row

SEGMENTS, SAMPLES = 300, 160
SUMS = 5
"""Differences, minima and maxima of one update of a point's distance. They share pipes, which start
as many a cycle as those of the products; where products share them, too, an update takes longer."""
BEST = "NumPy, batched, a column an axis"


def fps(threads: int, repeats: int) -> Row:
    """Ours on every instruction set against NumPy and fpsample (settings of exact coverage)."""
    points = harness.segments(SEGMENTS)
    widest = kernels.instruction_set()
    narrower = [isa for isa in ("portable", "avx2", "avx512") if isa != widest]
    runs: dict[str, Any] = {OURS: partial(kernels.fps, points, SAMPLES, threads)}
    for isa in narrower[: ("portable", "avx2", "avx512").index(widest)]:
        runs[f"segloc, {isa}"] = partial(kernels.fps, points, SAMPLES, threads, isa)
    runs["NumPy, a segment at a time"] = partial(per_segment, points, SAMPLES)
    runs["NumPy, batched"] = partial(batched, points, SAMPLES)
    runs[BEST] = partial(batched_columns, points, SAMPLES)
    found = optional("fpsample")
    if found is not None:
        runs |= {f"fpsample {name}": run for name, run in fpsample_runs(found[0], points).items()}
    _check(runs, points)
    bound = Bound("differences and comparisons", flops=2.0 * points[..., 0].size * SAMPLES * SUMS)
    timed = row("fps", threads, repeats, runs, bound=bound, skipped=() if found else ("fpsample",))
    best, limit = timed.rivals[BEST], timed.bound_ms or np.inf
    details = {"NumPy's best over ours": best / timed.ours_ms, "over the bound": best / limit}
    return replace(timed, details=details)


def _check(runs: dict[str, Any], points: Float32) -> None:
    """Every run must be farthest-point sampling; orders may part where distances are equal."""
    for name, run in runs.items():
        if shortfall(points, run()) < 0.999:
            raise SeglocError(f"{name} does not sample the farthest points")


def shortfall(points: Float32, order: np.ndarray) -> float:
    """The worst choice: distance of a sample to those before it, over the largest there was."""
    rows, worst = np.arange(len(points)), np.inf
    cloud = points.astype(np.float64)
    distance = np.square(cloud - cloud[rows, order[:, 0]][:, None]).sum(axis=2)
    for taken in order.T[1:].astype(np.int64):
        worst = min(worst, float((distance[rows, taken] / distance.max(axis=1)).min()))
        squared = np.square(cloud - cloud[rows, taken][:, None]).sum(axis=2)
        np.minimum(distance, squared, out=distance)
    return math.sqrt(worst)


def _first(points: Float32) -> np.ndarray:
    centred = points - points.mean(axis=1, keepdims=True)
    first: np.ndarray = np.square(centred).sum(axis=2).argmax(axis=1)
    return first


def per_segment(points: Float32, samples: int) -> np.ndarray:
    """The textbook's loop: one segment after another, one sample after another."""
    order = np.empty((len(points), samples), np.int64)
    for i, (cloud, first) in enumerate(zip(points, _first(points), strict=True)):
        order[i, 0] = first
        distance = np.full(len(cloud), np.inf, np.float32)
        for s in range(1, samples):
            squared = ((cloud - cloud[order[i, s - 1]]) ** 2).sum(axis=1)
            distance = np.minimum(distance, squared)
            order[i, s] = distance.argmax()
    return order


def batched(points: Float32, samples: int) -> np.ndarray:
    """All segments at once, as the paper has it."""
    order = np.empty((len(points), samples), np.int64)
    order[:, 0] = _first(points)
    distance = np.full(points.shape[:2], np.inf, np.float32)
    rows = np.arange(len(points))
    for s in range(1, samples):
        last = points[rows, order[:, s - 1]]
        distance = np.minimum(distance, ((points - last[:, None]) ** 2).sum(axis=2))
        order[:, s] = distance.argmax(axis=1)
    return order


def batched_columns(points: Float32, samples: int) -> np.ndarray:
    """The same with one array an axis and no temporaries: the best that NumPy was seen to do."""
    x, y, z = (np.ascontiguousarray(points[..., k]) for k in range(3))
    order = np.empty((len(points), samples), np.int64)
    order[:, 0] = _first(points)
    distance = np.full(x.shape, np.inf, np.float32)
    squared, part = np.empty_like(x), np.empty_like(x)
    rows = np.arange(len(points))
    for s in range(1, samples):
        last = order[:, s - 1]
        np.subtract(x, x[rows, last][:, None], out=squared)
        np.multiply(squared, squared, out=squared)
        for axis in (y, z):
            np.subtract(axis, axis[rows, last][:, None], out=part)
            np.multiply(part, part, out=part)
            np.add(squared, part, out=squared)
        np.minimum(distance, squared, out=distance)
        order[:, s] = distance.argmax(axis=1)
    return order


def fpsample_runs(fpsample: Any, points: Float32) -> dict[str, Any]:
    """fpsample's exact samplers over all segments.

    Its two others, ``npdu`` and ``npdu_kdtree``, look at part of the points and take samples as
    near as a hundredth of the farthest distance: they solve another problem.
    """
    samplers = {
        "plain": fpsample.fps_sampling,
        "kdtree": fpsample.bucket_fps_kdtree_sampling,
        **{f"kdline h={h}": partial(fpsample.bucket_fps_kdline_sampling, h=h) for h in (1, 3)},
    }
    first = _first(points)

    def over_all(sampler: Any) -> np.ndarray:
        return np.stack(
            [
                sampler(cloud, SAMPLES, start_idx=int(start))
                for cloud, start in zip(points, first, strict=True)
            ]
        )

    return {name: partial(over_all, sampler) for name, sampler in samplers.items()}
