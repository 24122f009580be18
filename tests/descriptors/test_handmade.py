"""Hand-made descriptors against closed forms and against NumPy."""

from __future__ import annotations

import math

import numpy as np
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from samples.segments import packed

from segloc import _native, geometry
from segloc.descriptors import create
from segloc.descriptors.geo import CENTRE, SPREAD
from segloc.descriptors.segmatch import ETH_MAXIMA, eigen_features, eth_features
from segloc.types import Segments


def test_eigenvalue_features_of_line_plane_and_sphere() -> None:
    line = np.linspace([0, 0, 0], [3, 4, 12], 1001)
    grid = np.linspace(-1, 1, 101)
    plane = np.stack([*np.meshgrid(grid, grid), np.zeros((101, 101))], axis=-1).reshape(-1, 3)
    z = 1 - (2 * np.arange(20_000) + 1) / 20_000  # a spiral that covers a sphere evenly
    turn = np.arange(20_000) * math.pi * (3 - math.sqrt(5))
    sphere = np.column_stack(
        [np.sqrt(1 - z**2) * np.cos(turn), np.sqrt(1 - z**2) * np.sin(turn), z]
    )
    third = 1 / 3
    expected = [
        [1, 0, 0, 0, 1, 0, 0],
        [0, 1, 0, 0, 1, math.log(2), 0],
        [0, 0, 1, third, 0, math.log(3), third],
    ]
    features = eigen_features(packed([line, plane, sphere]))
    # Omnivariance is a cube root: it magnifies what rounding leaves of an eigenvalue of zero.
    np.testing.assert_allclose(features, expected, atol=3e-3)


@settings(max_examples=15)
@given(st.integers(0, 10_000), st.integers(4, 300), st.floats(0.01, 50))
def test_moments_are_those_of_numpy(seed: int, count: int, size: float) -> None:
    rng = np.random.default_rng(seed)
    clouds = [
        rng.normal(rng.uniform(-50, 50, 3), rng.uniform(0, size, 3), (count, 3)) for _ in "ab"
    ]
    segments = packed([*clouds])
    means, values = _native.segment_moments(segments.points, segments.offsets)
    for i in range(2):
        points = segments.segment(i).astype(np.float64)
        np.testing.assert_allclose(means[i], points.mean(axis=0), atol=1e-9)
        expected = np.linalg.eigvalsh(np.cov(points.T, bias=True))[::-1]
        np.testing.assert_allclose(values[i], expected, rtol=1e-4, atol=1e-9 + 1e-5 * size**2)


def test_the_variant_of_the_eth_code() -> None:
    rng = np.random.default_rng(0)
    flat, tall = rng.uniform(-1, 1, (2, 500, 3)) * [[[3, 2, 0.5]], [[1, 2, 3]]]
    features = eth_features(packed([flat, tall]))
    e1, e2, e3 = np.linalg.eigvalsh(np.cov(flat.T)) / np.trace(np.cov(flat.T))  # rising
    expected = [
        (e1 - e2) / e1 / ETH_MAXIMA[0],
        e1 * math.log(e1) + e2 * math.log(e2) + e3 * math.log(e3) / ETH_MAXIMA[5],
        0.2,
    ]
    np.testing.assert_allclose(features[0, [0, 5, 7]], expected, rtol=1e-4)
    assert features[1, 7] == 0


def test_segments_without_triangles_have_no_shape_functions() -> None:
    line = np.linspace([0, 0, 0], [1, 2, 3], 50, dtype=np.float32)
    offsets = np.array([0, 0, 1, 50])
    assert not _native.esf(line, offsets, triples=500).any()


# --- Gestalt -----

RINGS, SECTORS = 4, 8


ROUNDING_M = 2e-5


def reference_gestalt(points: np.ndarray, radius: float) -> tuple[np.ndarray, bool]:
    """The 66 numbers, and whether rounding could change them: a point in another bin, or a turn."""
    p = points.astype(np.float64) - points.astype(np.float64).mean(axis=0)
    _, axes = np.linalg.eigh(np.cov(p[:, :2].T))
    x_axis = axes[:, 0]  # the minor one
    along = p[:, :2] @ x_axis
    below = 2 * int((along < (along.min() + along.max()) / 2).sum())
    if below < len(p):
        x_axis = -x_axis
    x = p[:, :2] @ x_axis
    y = p[:, :2] @ [-x_axis[1], x_axis[0]]
    reach = np.hypot(x, y)
    rings, sectors = reach / radius * RINGS, np.arctan2(y, x) % math.tau / math.tau * SECTORS
    ring, sector = rings.astype(int), sectors.astype(int) % SECTORS
    gaps = [
        np.abs(rings - np.round(rings)) * radius / RINGS,
        np.abs(sectors - np.round(sectors)) * math.tau / SECTORS * reach,
        np.abs(along - (along.min() + along.max()) / 2),
    ]
    mean, variance = np.zeros((2, RINGS, SECTORS))
    for r in range(RINGS):
        for s in range(SECTORS):
            heights = p[(ring == r) & (sector == s), 2]
            if len(heights):
                mean[r, s], variance[r, s] = heights.mean(), heights.var()
            elif r:
                mean[r, s], variance[r, s] = mean[r - 1, s], variance[r - 1, s]
    low, middle, high = np.linalg.eigvalsh(np.cov(p.T, bias=True))
    total = low + middle + high
    shape = [2 * (middle - low) / total, (high - middle) / total]
    numbers = np.concatenate([mean.ravel(), variance.ravel(), shape])
    return numbers, below == len(p) or bool(np.min(gaps) < ROUNDING_M)


@settings(max_examples=15)
@given(st.integers(0, 10_000), st.integers(20, 400), st.floats(1.0, 8.0))
def test_gestalt_equals_the_reference(seed: int, count: int, radius: float) -> None:
    rng = np.random.default_rng(seed)
    cloud = rng.gamma(2.0, [1.5, 0.5, 1.0], (count, 3))
    turn = geometry.yaw_transform(rng.uniform(-3, 3), tuple(rng.uniform(-30, 30, 3)))
    points = geometry.transform(turn, cloud).astype(np.float32)
    ours = _native.gestalt(points, np.array([0, count]), radius)[0]
    expected, uncertain = reference_gestalt(points, radius)
    assume(not uncertain)
    np.testing.assert_allclose(ours, expected, atol=1e-4)


def test_a_wall_sees_its_own_height() -> None:
    y, z = (a.ravel() for a in np.meshgrid(np.linspace(-4, 4, 161), np.linspace(0, 3, 61)))
    wall = np.column_stack([np.zeros(len(y)), y, z]).astype(np.float32)
    vector = _native.gestalt(wall, np.array([0, len(wall)]), 5.0)[0]
    mean, variance, (planarity, cylindricality) = vector[:32], vector[32:64], vector[64:]
    np.testing.assert_allclose(mean, 0, atol=1e-3)
    # x is the wall's normal, so the wall lies in the sectors next to the y axis.
    np.testing.assert_allclose(variance[variance > 0], 61.0 / 59.0 * 9 / 12, rtol=0.05)
    spreads = 64 / 12, 9 / 12
    assert abs(planarity - 2 * spreads[1] / sum(spreads)) < 0.02
    assert abs(cylindricality - (spreads[0] - spreads[1]) / sum(spreads)) < 0.02


# --- geo -----


def numbers(segments: Segments) -> np.ndarray:
    return create("geo").describe(segments).vectors * SPREAD + CENTRE


def test_a_turned_box_has_its_own_extents_and_spreads() -> None:
    size = np.array([4.0, 1.0, 2.0])
    box = np.random.default_rng(0).uniform(-0.5, 0.5, (40_000, 3)) * size
    for yaw in (0.0, 0.6, 2.0):
        turned = geometry.transform(geometry.yaw_transform(yaw, (30.0, -7, 2)), box)
        (values,) = numbers(packed([turned], height=1.5))
        np.testing.assert_allclose(np.exp(values[:3]), size, rtol=0.02)
        np.testing.assert_allclose(
            np.exp(values[3:6]), np.sort(size)[::-1] / math.sqrt(12), rtol=0.02
        )
        assert abs(values[6] - 1.5) < 1e-4
