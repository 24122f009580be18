"""Farthest-point sampling against a plain reference, on every instruction set."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from segloc import _native


def instruction_sets() -> list[str]:
    found = []
    for isa in ("portable", "avx2", "avx512"):
        try:
            found.append(_native.instruction_set(isa))
        except ValueError:
            continue
    return found


ISAS = instruction_sets()


def squared(points: np.ndarray, centre: np.ndarray) -> np.ndarray:
    x, y, z = (points - centre).T
    return (x * x + y * y) + z * z


def reference(points: np.ndarray, samples: int) -> np.ndarray:
    """Max-min order from the point farthest from the centroid; never one point twice."""
    centroid = (np.cumsum(points.astype(np.float64), axis=0)[-1] / len(points)).astype(np.float32)
    distance = np.full(len(points), np.float32(np.finfo(np.float32).max))
    order = [int(np.argmax(squared(points, centroid)))]
    while len(order) < samples:
        distance = np.minimum(distance, squared(points, points[order[-1]]))
        distance[order] = -1.0
        order.append(int(np.argmax(distance)))
    return np.array(order[:samples])


def clouds(count: int, n: int, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return rng.normal(size=(count, n, 3)).astype(np.float32) * np.float32([3, 1, 1])


@pytest.mark.parametrize("isa", ISAS)
@pytest.mark.parametrize(("count", "n", "samples"), [(7, 256, 160), (5, 77, 77), (2, 4500, 300)])
def test_order_is_the_reference(isa: str, count: int, n: int, samples: int) -> None:
    points = clouds(count, n)
    expected = np.stack([reference(cloud, samples) for cloud in points])
    np.testing.assert_array_equal(_native.fps(points, samples, 1, isa), expected)


@pytest.mark.parametrize("isa", ISAS)
def test_ties_of_a_large_cloud(isa: str) -> None:
    points = np.random.default_rng(5).integers(-6, 7, (2, 900, 3)).astype(np.float32)
    expected = np.stack([reference(cloud, 880) for cloud in points])
    np.testing.assert_array_equal(_native.fps(points, 880, 1, isa), expected)


@settings(max_examples=15)
@given(
    arrays.arrays(
        np.int8,
        st.tuples(st.integers(1, 6), st.integers(1, 90), st.just(3)),
        elements=st.integers(-3, 3),
    )
)
def test_ties_and_repeated_points(grid: np.ndarray) -> None:
    """On a coarse grid nearly everything ties; repeated points come last, in order."""
    points = grid.astype(np.float32)
    n = points.shape[1]
    expected = np.stack([reference(cloud, n) for cloud in points])
    for isa in ISAS:
        order = _native.fps(points, n, 1, isa)
        np.testing.assert_array_equal(
            np.sort(order, axis=1), np.tile(np.arange(n), (len(points), 1))
        )
        np.testing.assert_array_equal(order, expected)
