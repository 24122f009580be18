"""What a query is made of: the vertical of a scan, heights above ground, and descriptions."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np

from segloc.descriptors import create
from segloc.descriptors.pointset import POINTS
from segloc.descriptors.profile import KIND, PreparedSegments
from segloc.descriptors.weightfile import read_weights, shipped_weights
from segloc.errors import SeglocError
from segloc.frontend import AttitudeEstimator, SegmentationConfig
from segloc.system import kernels
from segloc.types import Float32

from . import harness
from .harness import OURS, Bound, Row, optional, row
from .works import drive

SEGMENTS = 300
GROUND_M, NEAR_M = 0.3, 50.0
"""Height up to which a point counts as ground, and the range of the points that are compared."""
_MIN_AGREEMENT = 0.9
_NORMALS_RANGE_M, _NORMALS_VOXEL_M = 30.0, 0.25


def scan() -> Float32:
    """Return a full simulated scan of an HDL-64E on a street."""
    driven = drive("hdl64e", 1875)
    return np.ascontiguousarray(driven.scan(len(driven) // 2).points, dtype=np.float32)


def gravity(threads: int, repeats: int) -> Row:
    """The vertical of a full scan. One thread always."""
    points = scan()
    runs: dict[str, Any] = {OURS: partial(AttitudeEstimator().estimate, points)}
    found = optional("small_gicp")
    if found is not None:
        runs["small_gicp, the normals alone"] = partial(normals, found[0], points, threads)
    return row(
        "gravity",
        threads,
        repeats,
        runs,
        bound=Bound("reading its points", bytes=float(points.nbytes)),
        skipped=() if found else ("small-gicp",),
        note="no library estimates the vertical; normals of the same points are part of it",
    )


def normals(small_gicp: Any, points: Float32, threads: int) -> Any:
    """Thin the near points of a scan and find their normals by small_gicp."""
    near = points[(points**2).sum(axis=1) < _NORMALS_RANGE_M**2].astype(np.float64)
    cloud = small_gicp.voxelgrid_sampling(near, _NORMALS_VOXEL_M, num_threads=threads)
    small_gicp.estimate_normals(cloud, num_threads=threads)
    return cloud


def ground(threads: int, repeats: int) -> Row:
    """Heights of all points of a scan above ground; a rival tells ground from the rest. One thread
    always."""
    points, config = scan(), SegmentationConfig()
    grid = config.ground_cell, config.ground_slope, config.ground_step
    runs: dict[str, Any] = {OURS: partial(kernels.heights_above_ground, points, *grid)}
    found = optional("linefit")
    if found is not None:
        fitted = found[0].ground_seg()
        runs["linefit"] = partial(fitted.run, points)
        near = np.hypot(points[:, 0], points[:, 1]) < NEAR_M
        alike = (runs[OURS]() < GROUND_M) == np.asarray(runs["linefit"](), dtype=bool)
        if alike[near].mean() < _MIN_AGREEMENT:
            raise SeglocError(f"linefit finds other ground: {alike[near].mean():.0%} of points")
    bound = Bound("reading its points", bytes=float(points.nbytes))
    return row("ground", threads, repeats, runs, bound=bound, skipped=() if found else ("linefit",))


def description(threads: int, repeats: int) -> Row:
    """Descriptions of 300 segments by the default method."""
    points = harness.segments(SEGMENTS, 400).reshape(-1, 3)
    offsets = np.arange(SEGMENTS + 1, dtype=np.int64) * 400
    heights = np.full(SEGMENTS, 1.0, np.float32)
    descriptor = create("profile", threads)

    def ours() -> Any:
        prepared = kernels.prepare_segments(points, offsets, POINTS)
        return descriptor.encode(PreparedSegments(prepared, heights))

    weights = read_weights(shipped_weights("profile.safetensors"), KIND).tensors.values()
    products = SEGMENTS * sum(each.size for each in weights if each.ndim == 2)
    return row(
        "description",
        threads,
        repeats,
        {OURS: ours},
        bound=Bound("its dense layers", flops=2.0 * products),
        note="no other library computes these numbers; `fps` and `network` have rivals",
    )
