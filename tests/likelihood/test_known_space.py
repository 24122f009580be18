"""What the map knows where points of a query fall, against NumPy."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.ndimage import minimum_filter
from scipy.spatial import cKDTree

from segloc import geometry
from segloc._native import KnownSpace, PointIndex
from segloc.likelihood.observation import HIT, MISSED, THROUGH, UNKNOWN
from segloc.types import Float32, Float64

REACH, BIN_DEG, RADIUS, MARGIN, HALF_WIDTH, MOST = 15.0, 3.0, 0.5, 0.7, 0.2, 8


def pixels(d: Float64) -> tuple[Float64, Any, Any]:
    """Ranges, and the rows and columns of a range image."""
    ranges = np.linalg.norm(d, axis=1)
    columns = (np.degrees(np.arctan2(d[:, 1], d[:, 0])) + 180.0) / BIN_DEG
    rows = (np.degrees(np.arctan2(d[:, 2], np.hypot(d[:, 0], d[:, 1]))) + 90.0) / BIN_DEG
    return ranges, rows.astype(int), columns.astype(int) % round(360 / BIN_DEG)


def range_image(d: Float64) -> Float64:
    """The nearest range of each pixel, where each point is as wide as it is."""
    image = np.full((round(180 / BIN_DEG) + 1, round(360 / BIN_DEG)), np.inf)
    height, width = image.shape
    flat = np.hypot(d[:, 0], d[:, 1])
    for r, row, column, across in zip(*pixels(d), flat, strict=True):
        up = int(np.degrees(HALF_WIDTH / max(r, 0.05)) / BIN_DEG + 0.5)
        aside = min(int(np.ceil(up / max(across / max(r, 0.05), 0.1))), width // 2)
        block = np.ix_(
            np.arange(max(row - up, 0), min(row + up, height - 1) + 1),
            np.arange(column - aside, column + aside + 1) % width,
        )
        image[block] = np.minimum(image[block], max(r, 0.05))
    return image


def reference(cloud: Float32, query: Float32, T: Float64, views: Float64) -> NDArray[np.uint8]:
    """What ``KnownSpace.codes`` returns."""
    moved = geometry.transform(T, query.astype(np.float64))
    codes = np.where(cKDTree(cloud).query(moved)[0] <= RADIUS, HIT, UNKNOWN).astype(np.uint8)
    left = codes == UNKNOWN
    away = np.hypot(*(views - T[:3, 3])[:, :2].T)
    near = np.abs(views[:, 2] - T[2, 3]) < 1.5
    for view in views[near][np.argsort(away[near], kind="stable")][:MOST]:
        d = cloud - view
        image = range_image(d[np.linalg.norm(d, axis=1) <= REACH])
        least = minimum_filter(image, 3, mode=("nearest", "wrap"))
        ranges, rows, columns = pixels(moved - view)
        known = left & (ranges < REACH)
        behind = least[rows, columns] > ranges + np.maximum(MARGIN, 0.05 * ranges)
        through = known & np.isfinite(image[rows, columns]) & behind
        codes[through], left = THROUGH, left & ~through
        codes[known & left & (np.abs(image[rows, columns] - ranges) <= MARGIN)] = MISSED
    return codes


@settings(max_examples=10)
@given(st.integers(0, 2**32 - 1), st.integers(1, 1500))
def test_the_same_is_known_by_numpy(seed: int, count: int) -> None:
    rng = np.random.default_rng(seed)
    outward = rng.normal(size=(count, 3))
    shell = outward / np.linalg.norm(outward, axis=1)[:, None] * rng.uniform(7, 14, (count, 1))
    cloud = np.concatenate([shell, rng.uniform(-4, 4, (20, 3))]).astype(np.float32)
    query = rng.uniform(-12, 12, (300, 3)).astype(np.float32)
    T = geometry.yaw_transform(rng.uniform(-3, 3), tuple(rng.uniform(-2, 2, 3)))
    views = rng.uniform(-3, 3, (20, 3))
    known = KnownSpace(PointIndex(cloud, RADIUS), views, REACH, BIN_DEG, MARGIN)
    expected = reference(cloud, query, T, views)
    for _ in range(2):  # from kept images, too
        found = known.codes(query, T, RADIUS)
        assert np.count_nonzero(found != expected) <= 3  # a few may be decided by rounding


def walls(*xs: float) -> Float32:
    """Walls across the way, 12 m wide, as densely as a map has them."""
    y, z = (v.ravel() for v in np.mgrid[-6:6:0.3, -1:2:0.3])
    planes = [np.column_stack([np.full_like(y, x), y, z]) for x in xs]
    return np.concatenate(planes).astype(np.float32)


def codes(cloud: Float32, query: Float32, path: Float64) -> NDArray[np.uint8]:
    return KnownSpace(PointIndex(cloud, 0.5), path, 30.0, 2.0, 0.7).codes(query, np.eye(4), 0.3)


@pytest.mark.parametrize(
    ("query", "code"),
    [
        (walls(8.0), HIT),  # as it was mapped
        (0.4 * walls(10.0), THROUGH),  # before the mapped one
        (walls(12.0), UNKNOWN),  # hidden from the path
        (walls(8.5), MISSED),  # beside it
    ],
)
def test_points_are_known_where_the_path_looked(query: Float32, code: int) -> None:
    path = np.array([[0.0, 0.0, 0.0], [-4.0, 0.0, 0.0]])
    assert (codes(walls(8.0), query, path) == code).mean() > 0.85
    only_hits = codes(walls(8.0), query, path[:0])
    assert set(only_hits) == {HIT if code == HIT else UNKNOWN}
    assert len(codes(walls(8.0), query[:0], path)) == 0


def test_a_wall_beside_the_path_has_no_holes() -> None:
    """Its points are 0.3 m apart, many pixels at such a distance."""
    beside, room = walls(1.0), walls(9.0)
    found = codes(np.concatenate([beside, room]), walls(5.0), np.zeros((1, 3)))
    assert not (found == THROUGH).any()


def test_another_storey_does_not_tell() -> None:
    upstairs = np.array([[0.0, 0.0, 3.0]])
    assert not (codes(walls(8.0), 0.4 * walls(10.0), upstairs) == THROUGH).any()


def test_viewpoints_are_spaced() -> None:
    along = np.column_stack([np.arange(-40.0, 40.0, 0.5), np.zeros((160, 2))])
    kept = geometry.spaced(along, 3.0)
    assert 26 <= len(kept) <= 28 and {tuple(p) for p in kept} <= {tuple(p) for p in along}
