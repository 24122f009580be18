"""The metric descriptor against closed forms."""

from __future__ import annotations

import math

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from segloc import geometry
from segloc.descriptors import create
from segloc.descriptors.geo import CENTRE, SPREAD
from segloc.types import Segments


def segments_of(*clouds: np.ndarray, height: float = 1.0) -> Segments:
    points = np.vstack(clouds).astype(np.float32)
    offsets = np.cumsum([0, *map(len, clouds)])
    centroids = np.stack([cloud.mean(axis=0) for cloud in clouds])
    return Segments(points, offsets, centroids, np.full(len(clouds), height, np.float32))


def numbers(segments: Segments) -> np.ndarray:
    return create("geo").describe(segments).vectors * SPREAD + CENTRE


def test_a_turned_box_has_its_own_extents_and_spreads() -> None:
    size = np.array([4.0, 1.0, 2.0])
    box = np.random.default_rng(0).uniform(-0.5, 0.5, (40_000, 3)) * size
    for yaw in (0.0, 0.6, 2.0):
        turned = geometry.transform(geometry.yaw_transform(yaw, (30.0, -7, 2)), box)
        (values,) = numbers(segments_of(turned, height=1.5))
        np.testing.assert_allclose(np.exp(values[:3]), size, rtol=0.02)
        np.testing.assert_allclose(
            np.exp(values[3:6]), np.sort(size)[::-1] / math.sqrt(12), rtol=0.02
        )
        assert abs(values[6] - 1.5) < 1e-4


@settings(max_examples=15)
@given(st.integers(0, 99), st.floats(-math.pi, math.pi), st.floats(-40, 40))
def test_turning_moving_and_reordering_change_nothing(seed: int, yaw: float, x: float) -> None:
    rng = np.random.default_rng(seed)
    cloud = rng.normal(0, [3.0, 1.0, 0.7], (200, 3))
    moved = rng.permutation(geometry.transform(geometry.yaw_transform(yaw, (x, 5, 0)), cloud))
    first, second = numbers(segments_of(cloud, moved))
    np.testing.assert_allclose(first, second, atol=2e-3)
