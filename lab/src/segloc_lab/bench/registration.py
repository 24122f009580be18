"""Aligning a query cloud with a place of the map that is seen for the first time."""

from __future__ import annotations

from typing import Any

import numpy as np

from segloc import geometry
from segloc.errors import SeglocError
from segloc.likelihood.registration import Aligner
from segloc.types import Float32, Float64, Pose

from . import inputs
from .harness import OURS, Row, optional, row

VOXEL_M, CORRESPONDENCE_M, RADIUS_M = 0.8, 1.5, 45.0
TOLERANCE_M = 0.1


def icp(threads: int, repeats: int) -> Row:
    """From a first guess half a metre off, and from raw clouds: both are thinned, and normals are
    found, in every run.
    """
    plaza = inputs.Plaza()
    truth = geometry.yaw_transform(0.4, (3.0, -2.0, 1.5))
    query = _structure(plaza, truth, seed=1)
    mapped = np.concatenate(
        [_placed(plaza, x, y) for x in (-20.0, 0.0, 20.0) for y in (-20.0, 20.0)]
    )
    mapped = mapped[np.hypot(*(mapped[:, :2] - truth[:2, 3]).T) < RADIUS_M]
    guess = truth @ geometry.yaw_transform(0.03, (0.4, -0.3, 0.1))
    runs: dict[str, Any] = {OURS: lambda: ours(mapped, query, guess, threads)}
    rival = optional("small_gicp")
    if rival is not None:
        runs["small_gicp"] = lambda: prepared_and_aligned(rival[0], mapped, query, guess, threads)
    errors = {
        f"{name}, metres off": float(np.linalg.norm((geometry.inverse(truth) @ run())[:3, 3]))
        for name, run in runs.items()
    }
    if max(errors.values()) > TOLERANCE_M:
        raise SeglocError(f"a cloud was not aligned: {errors}")
    skipped = () if rival else ("small_gicp",)
    return row("icp", threads, repeats, runs, details=errors, skipped=skipped)


def ours(mapped: Float32, query: Float32, guess: Pose, threads: int) -> Pose:
    aligner = Aligner(VOXEL_M, CORRESPONDENCE_M, threads)
    aligned = aligner.align(aligner.surface(mapped), aligner.surface(query), guess)
    if aligned is None:
        raise SeglocError("a cloud was not aligned")
    return aligned.T_target_source


def prepared_and_aligned(
    small_gicp: Any, mapped: Float32, query: Float32, guess: Pose, threads: int
) -> Float64:
    target, tree = small_gicp.preprocess_points(
        mapped.astype(np.float64), VOXEL_M, num_threads=threads
    )
    source, _ = small_gicp.preprocess_points(query.astype(np.float64), VOXEL_M, num_threads=threads)
    result = small_gicp.align(
        target,
        source,
        tree,
        guess,
        "GICP",
        max_correspondence_distance=CORRESPONDENCE_M,
        num_threads=threads,
    )
    return np.array(result.T_target_source)


def _structure(plaza: inputs.Plaza, T_world_sensor: Pose, seed: int) -> Float32:
    return np.ascontiguousarray(plaza.scan(T_world_sensor, seed=seed).points)


def _placed(plaza: inputs.Plaza, x: float, y: float) -> Float32:
    """What is seen from a place, in the world."""
    T = geometry.yaw_transform(0.0, (x, y, 1.5))
    return geometry.transform(T, _structure(plaza, T, seed=100 + int(x + y))).astype(np.float32)
