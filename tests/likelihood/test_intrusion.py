"""What a query shows standing in free space of the map, against NumPy."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import minimum_filter
from scipy.spatial import cKDTree

from segloc import geometry
from segloc._native import PointIndex
from segloc.likelihood import VerificationConfig
from segloc.likelihood.observation import Count, intruding_count, viewpoints
from segloc.types import Float32, Float64

REACH, BIN_DEG, RADIUS, MARGIN, HALF_WIDTH = 15.0, 3.0, 0.5, 0.7, 0.2


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


def reference(cloud: Float32, query: Float32, T: Float64, views: Float64) -> tuple[int, int]:
    """What ``PointIndex.intrusion`` counts."""
    used = np.linalg.norm(query.astype(np.float64), axis=1) <= REACH
    moved = geometry.transform(T, query[used].astype(np.float64))
    far = cKDTree(cloud).query(moved)[0] > RADIUS
    free = np.zeros(len(moved), bool)
    for view in views:
        d = cloud - view
        image = range_image(d[np.linalg.norm(d, axis=1) <= REACH])
        least = minimum_filter(image, 3, mode=("nearest", "wrap"))
        ranges, rows, columns = pixels(moved - view)
        behind = least[rows, columns] > ranges + np.maximum(MARGIN, 0.05 * ranges)
        free |= (ranges < REACH) & np.isfinite(image[rows, columns]) & behind
    return int(used.sum()), int((far & free).sum())


@settings(max_examples=10)
@given(st.integers(0, 2**32 - 1), st.integers(1, 1500))
def test_the_same_points_intrude_by_numpy(seed: int, count: int) -> None:
    rng = np.random.default_rng(seed)
    outward = rng.normal(size=(count, 3))
    shell = outward / np.linalg.norm(outward, axis=1)[:, None] * rng.uniform(7, 14, (count, 1))
    cloud = np.concatenate([shell, rng.uniform(-4, 4, (20, 3))]).astype(np.float32)
    query = rng.uniform(-12, 12, (300, 3)).astype(np.float32)
    T = geometry.yaw_transform(rng.uniform(-3, 3), tuple(rng.uniform(-2, 2, 3)))
    views = rng.uniform(-3, 3, (3, 3))
    found = PointIndex(cloud, RADIUS).intrusion(
        query, T, views, REACH, BIN_DEG, RADIUS, MARGIN, HALF_WIDTH
    )
    expected = reference(cloud, query, T, views)
    assert found[0] == expected[0]
    assert abs(found[1] - expected[1]) <= 2  # one or two may be decided by rounding


def walls(*xs: float) -> Float32:
    """Walls across the way, 12 m wide, as densely as a map has them."""
    y, z = (v.ravel() for v in np.mgrid[-6:6:0.3, -1:2:0.3])
    planes = [np.column_stack([np.full_like(y, x), y, z]) for x in xs]
    return np.concatenate(planes).astype(np.float32)


@pytest.mark.parametrize(
    ("query", "share"),
    [
        (walls(8.0), 0.0),  # as it was mapped
        (np.concatenate([walls(8.0), 0.4 * walls(10.0)]), 0.5),  # one more, before the mapped one
        (walls(8.0, 12.0), 0.0),  # hidden from the path
        (walls(8.3), 0.0),  # no farther off than things are that are the same
    ],
)
def test_what_stands_where_the_path_looked_through_intrudes(query: Float32, share: float) -> None:
    index, path = PointIndex(walls(8.0), 0.5), np.array([[0.0, 0.0, 0.0], [-2.0, 0.0, 0.0]])
    config = VerificationConfig()
    found = intruding_count(index, query, np.eye(4), path, config)
    assert found.of == len(query) and found.share == pytest.approx(share, abs=0.05)
    assert intruding_count(index, query, np.eye(4), path[:0], config).hits == 0
    assert intruding_count(index, query[:0], np.eye(4), path, config) == Count(0, 0)


def test_a_wall_beside_the_path_has_no_holes() -> None:
    """Its points are 0.3 m apart, many pixels at such a distance."""
    beside, room = walls(1.0), walls(9.0)
    index = PointIndex(np.concatenate([beside, room]), 0.5)
    path = np.zeros((1, 3))
    assert intruding_count(index, walls(5.0), np.eye(4), path, VerificationConfig()).hits == 0


def test_a_place_is_looked_at_from_the_path_near_it_on_its_storey() -> None:
    along = np.column_stack([np.arange(-40.0, 40.0, 1.0), np.zeros((80, 2))])
    upstairs = along + [0.0, 0.0, 3.0]
    chosen = viewpoints(np.concatenate([upstairs, along]), np.array([0.4, 0.0, 0.0]))
    assert (chosen[:, 2] == 0.0).all() and chosen[0].tolist() == [0.0, 0.0, 0.0]
    gaps = np.abs(chosen[:, None, 0] - chosen[None, :, 0])[np.triu_indices(len(chosen), 1)]
    assert 2 < len(chosen) <= 8 and gaps.min() > 3.0 and np.abs(chosen[:, 0] - 0.4).max() < 12.0
    assert viewpoints(along, np.array([0.0, 50.0, 0.0])).shape == (0, 3)
