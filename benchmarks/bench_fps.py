"""Farthest-point sampling of 300 segments, 256 -> 160 points, on one thread."""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")

from collections.abc import Callable

import numpy as np
from timing import best_ms, instruction_sets, table

from segloc import _native

P, N, S = 300, 256, 160


def naive(points: np.ndarray) -> np.ndarray:
    """One segment in NumPy, as it is usually written."""
    chosen = int(((points - points.mean(axis=0)) ** 2).sum(axis=1).argmax())
    distance = np.full(len(points), np.inf, np.float32)
    order = np.empty(S, np.int64)
    for step in range(S):
        order[step] = chosen
        distance = np.minimum(distance, ((points - points[chosen]) ** 2).sum(axis=1))
        chosen = int(distance.argmax())
    return order


def batched(points: np.ndarray) -> np.ndarray:
    """All segments at once in NumPy, a plane a coordinate, no temporaries: the fastest found."""
    rows = np.arange(len(points))
    x, y, z = (np.ascontiguousarray(points[..., axis]) for axis in range(3))
    chosen = ((points - points.mean(axis=1, keepdims=True)) ** 2).sum(axis=-1).argmax(axis=1)
    distance = np.full(points.shape[:2], np.inf, np.float32)
    total, term = np.empty_like(distance), np.empty_like(distance)
    order = np.empty((len(points), S), np.int64)
    for step in range(S):
        order[:, step] = chosen
        np.subtract(x, x[rows, chosen][:, None], out=total)
        np.multiply(total, total, out=total)
        for plane in (y, z):
            np.subtract(plane, plane[rows, chosen][:, None], out=term)
            np.multiply(term, term, out=term)
            np.add(total, term, out=total)
        np.minimum(distance, total, out=distance)
        chosen = distance.argmax(axis=1)
    return order


def paper(points: np.ndarray) -> np.ndarray:
    """The tensor form that the paper describes: one step for all segments at once."""
    rows = np.arange(len(points))
    chosen = ((points - points.mean(axis=1, keepdims=True)) ** 2).sum(axis=-1).argmax(axis=1)
    distance = np.full(points.shape[:2], np.inf, np.float32)
    order = np.empty((len(points), S), np.int64)
    for step in range(S):
        order[:, step] = chosen
        d = ((points - points[rows, chosen][:, None]) ** 2).sum(axis=-1)
        distance = np.minimum(distance, d)
        chosen = distance.argmax(axis=1)
    return order


def rivals(points: np.ndarray) -> dict[str, float]:
    runs: dict[str, tuple[Callable[[], object], int]] = {
        "NumPy, one segment at a time": (lambda: [naive(p) for p in points], 2),
        "NumPy, batched as in the paper": (lambda: paper(points), 3),
        "NumPy, batched, best found": (lambda: batched(points), 10),
    }
    try:
        import fpsample
    except ImportError:
        print("fpsample is not installed: left out")
    else:
        runs["fpsample, exact"] = (
            lambda: [fpsample.fps_sampling(p, S, start_idx=0) for p in points],
            10,
        )
        runs["fpsample, bucket kd-line h=3"] = (
            lambda: [fpsample.bucket_fps_kdline_sampling(p, S, h=3, start_idx=0) for p in points],
            10,
        )
    return {name: best_ms(run, repeats) for name, (run, repeats) in runs.items()}


def main() -> None:
    points = np.random.default_rng(0).normal(size=(P, N, 3)).astype(np.float32)
    expected = batched(points)
    ours = {}
    for isa in instruction_sets():
        assert (_native.fps(points, S, 1, isa) == expected).all()
        ours[isa] = best_ms(lambda isa=isa: _native.fps(points, S, 1, isa), 200)
    table(f"farthest-point sampling, {P} x {N} -> {S}, one thread", ours, rivals(points))


if __name__ == "__main__":
    main()
