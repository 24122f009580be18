"""Gestalt descriptors against a reference of a few lines, and the key poses they stand on."""

from __future__ import annotations

import math

import numpy as np
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from segloc import _native, geometry

RINGS, SECTORS = 4, 8


ROUNDING_M = 2e-5


def reference(points: np.ndarray, radius: float) -> tuple[np.ndarray, bool]:
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
def test_equals_the_reference(seed: int, count: int, radius: float) -> None:
    rng = np.random.default_rng(seed)
    cloud = rng.gamma(2.0, [1.5, 0.5, 1.0], (count, 3))
    turn = geometry.yaw_transform(rng.uniform(-3, 3), tuple(rng.uniform(-30, 30, 3)))
    points = geometry.transform(turn, cloud).astype(np.float32)
    ours = _native.gestalt(points, np.array([0, count]), radius)[0]
    expected, uncertain = reference(points, radius)
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
