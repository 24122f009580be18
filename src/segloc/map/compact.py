"""Shrink a map: round its numbers to lattices and drop redundant views of objects."""

from __future__ import annotations

from math import prod
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from scipy.spatial import cKDTree

from ..system.section import Section
from ..types import Float64, Int64
from .coding import cells_and_parts, lattice_points, round_to_lattice, spread_exponents
from .segment_map import SegmentMap, with_parts

CENTROID_EXPONENT, QUALITY_EXPONENT = -6, -6
"""Centroids are rounded to 1/64 m, qualities to 1/64."""
SIZE_BITS = 3
"""Binary digits kept of numbers of points."""
POSITION_EXPONENT, ROTATION_EXPONENT = -7, -12
"""Positions of the trajectory are rounded to 1/128 m, entries of its rotations to 1/4096."""


class CompactConfig(Section):
    """What a compact map keeps."""

    enabled: bool = Field(True, description="false: keep every number as measured")
    bits: int = Field(
        5, ge=2, le=12, description="bits per number of a descriptor, across its usual spread"
    )
    max_views: int = Field(
        2, ge=0, le=1000, description="views of an object kept per session; 0: all"
    )
    same_m: float = Field(
        0.5, gt=0, le=10, description="largest distance between centroids of one object, metres"
    )
    cloud_bits: Literal[0, 1, 2, 4] = Field(
        1, description="bits of a point's position in its voxel, per axis"
    )
    cloud_range_m: float = Field(
        0.0,
        ge=0,
        le=10_000,
        description="range of the cloud kept around the trajectory, metres; 0: all of it",
    )


def compacted(prior_map: SegmentMap, config: CompactConfig) -> SegmentMap:
    """Return the map in fewer bits; idempotent.

    Numbers of descriptors are rounded to a power of two below their spread, points of the cloud to
    the centres of parts of their voxels. Of an object's views in a session the best by quality are
    kept. Segments are sorted so that neighbours follow one another.
    """
    if not config.enabled:
        return prior_map
    placed = _on_lattices(prior_map, config)
    kept = placed.kept(best_views(placed, config), _near_path(placed, config))
    segments = {name: array[_along_curve(kept)] for name, array in kept.columns().items()}
    exponents = spread_exponents(segments["vectors"], 1 << config.bits)
    segments["vectors"] = round_to_lattice(segments["vectors"], exponents).astype(np.float32)
    return with_parts(kept, segments=segments)


def _on_lattices(prior_map: SegmentMap, config: CompactConfig) -> SegmentMap:
    """Return the map with all but its vectors on lattices, on which the selection depends."""
    segments = prior_map.columns()
    segments["centroids"] = _to_step(segments["centroids"], CENTROID_EXPONENT)
    if "quality" in segments:
        quality = _to_step(segments["quality"], QUALITY_EXPONENT)
        segments["quality"] = quality.astype(np.float32)
    segments["sizes"] = _to_digits(segments["sizes"])
    path = prior_map.trajectory.copy()
    path[:, :3, 3] = _to_step(path[:, :3, 3], POSITION_EXPONENT)
    path[:, :3, :3] = _to_step(path[:, :3, :3], ROTATION_EXPONENT)
    origin, voxel = prior_map.origin, prior_map.cloud_voxel
    cells, parts = cells_and_parts(prior_map.cloud, origin, voxel, config.cloud_bits)
    points = lattice_points(cells, parts, origin, voxel, config.cloud_bits)
    return with_parts(prior_map, segments=segments, points=points, trajectory=path)


def best_views(prior_map: SegmentMap, config: CompactConfig) -> NDArray[np.bool_]:
    """Return which segments stay if an object has at most ``max_views`` per session."""
    keep = np.ones(len(prior_map), dtype=bool)
    if config.max_views:
        for session in np.unique(prior_map.session):
            rows = np.flatnonzero(prior_map.session == session)
            keep[rows] = _best_of_session(prior_map, rows, config)
    return keep


def _best_of_session(
    prior_map: SegmentMap, rows: Int64, config: CompactConfig
) -> NDArray[np.bool_]:
    centroids, sizes = prior_map.centroids[rows], prior_map.sizes[rows]
    quality = np.zeros(len(rows)) if prior_map.quality is None else prior_map.quality[rows]
    near = cKDTree(centroids).query_ball_point(centroids, config.same_m)
    taken = np.zeros(len(rows), np.int64)  # kept views near each
    keep = np.zeros(len(rows), dtype=bool)
    for i in np.lexsort((prior_map.stamps[rows], *centroids.T, sizes, quality))[::-1]:
        if taken[i] < config.max_views:
            keep[i] = True
            taken[near[i]] += 1
    return keep


def _near_path(prior_map: SegmentMap, config: CompactConfig) -> NDArray[np.bool_]:
    """Return which points of the cloud lie near the trajectory, seen from above."""
    path = prior_map.trajectory[:, :2, 3] - prior_map.origin[:2]
    if not config.cloud_range_m or not len(path):
        return np.ones(len(prior_map.cloud), dtype=bool)
    found, _ = cKDTree(path).query(
        prior_map.cloud[:, :2], distance_upper_bound=config.cloud_range_m
    )
    return np.isfinite(found)


def _along_curve(prior_map: SegmentMap) -> Int64:
    """Return the order of segments along a curve through cells of 0.5 m, near ones together."""
    if not len(prior_map):
        return np.empty(0, np.int64)
    cells = np.floor(prior_map.centroids / 0.5)
    cells = (cells - cells.min(axis=0)).astype(np.uint64)
    key = np.zeros(len(cells), np.uint64)
    for bit in range(21):
        for axis in range(3):
            one = (cells[:, axis] >> np.uint64(bit)) & np.uint64(1)
            key |= one << np.uint64(3 * bit + axis)
    order: Int64 = np.lexsort((prior_map.stamps, prior_map.session, key))
    return order


def _to_step(numbers: NDArray[Any], exponent: int) -> Float64:
    rows = numbers.reshape(len(numbers), prod(numbers.shape[1:]))
    return round_to_lattice(rows, np.full(rows.shape[1], exponent)).reshape(numbers.shape)


def _to_digits(sizes: NDArray[np.int32]) -> NDArray[np.int32]:
    """Truncate integers to their first binary digits."""
    digits = np.frexp(sizes.astype(np.float64))[1]
    shift = np.maximum(digits - SIZE_BITS, 0)
    cut: NDArray[np.int32] = (sizes >> shift) << shift
    return cut
