"""Hand-made descriptors against closed forms and against NumPy."""

from __future__ import annotations

import math

import numpy as np
import pytest
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


GRID = 64


def reference_esf(points: np.ndarray, triples: int, seed: int) -> np.ndarray:
    """The ensemble of shape functions in NumPy, one triangle after another."""
    points = points[np.lexsort(points.T[::-1])].astype(np.float64)
    points -= points.mean(axis=0)
    points = (points * (32 / np.linalg.norm(points, axis=1).max())).astype(np.float32)
    down = np.where(points < 0, np.floor(points), np.ceil(points) - 1).astype(int)
    voxels = np.clip(down + 32, 0, 63)
    grid = np.zeros((GRID + 2,) * 3, bool)
    for x, y, z in voxels + 1:
        grid[x - 1 : x + 2, y - 1 : y + 2, z - 1 : z + 2] = True
    grid = grid[1:-1, 1:-1, 1:-1]
    h = np.zeros((10, 64))
    sides, areas = [], []
    for n in range(2 * triples):
        a, b, c = sorted(_draw(seed + 3 * n + k + 1, len(points)) for k in range(3))
        p, q, r = points[[a, b, c]].astype(np.float64)
        length = [np.linalg.norm(p - q), np.linalg.norm(p - r), np.linalg.norm(q - r)]
        s = sum(length) / 2
        heron = s * math.prod(s - side for side in length)
        if heron <= 0.001:
            continue
        lines = [_line(grid, voxels[i], voxels[j]) for i, j in ((a, b), (a, c), (b, c))]
        for side, (occupied, voxel_count) in zip(length, lines, strict=True):
            kind = 0 if occupied >= voxel_count - 1 else 1 if occupied <= 7 else 2
            sides.append((side, kind))
            if kind == 2:
                h[9, round(occupied / voxel_count * 63)] += 1
        inside, all_ = np.sum(lines, axis=0)
        kind = 1 if inside <= 21 else 0 if all_ - inside < 4 else 2
        areas.append((heron**0.25, kind))
        for (u, v), opposite in (((q - p, r - p), 2), ((r - p, r - q), 0), ((q - p, q - r), 1)):
            cosine = min(1.0, abs(u @ v) / np.linalg.norm(u) / np.linalg.norm(v))
            h[kind, round(math.acos(cosine) / (math.pi / 2) * 63)] += lines[opposite][1] / 32
        if len(areas) == triples:
            break
    for row, values in ((3, areas), (6, sides)):
        largest = max(value for value, _ in values)
        for value, kind in values:
            h[row + kind, round(value / largest * 63)] += 1
    h *= np.array([0.5, 0.5, 0.5, 0.5, 0.5, 1, 0.5, 2, 2, 1])[:, None]
    return (h / h.sum()).reshape(-1)


def _draw(counter: int, count: int) -> int:
    mask = (1 << 64) - 1
    z = counter * 0x9E3779B97F4A7C15 & mask
    z = (z ^ z >> 30) * 0xBF58476D1CE4E5B9 & mask
    z = (z ^ z >> 27) * 0x94D049BB133111EB & mask
    return ((z ^ z >> 31) >> 32) * count >> 32


def _line(grid: np.ndarray, a: np.ndarray, b: np.ndarray) -> tuple[int, int]:
    """Occupied voxels and all voxels of Bresenham's line, its end left out."""
    steps = np.abs(b - a)
    length = max(int(steps.max()), 1)
    i = np.arange(length)[:, None]
    # The voxel i steps on lies (i * step / length) to the side, halves rounded down.
    aside = (2 * i * steps + length - 1) // (2 * length)
    x, y, z = (a + np.sign(b - a) * aside).T
    return int(grid[x, y, z].sum()), length


@pytest.mark.parametrize("count", [40, 700])
def test_shape_functions_are_those_of_the_reference(count: int) -> None:
    """With few points each line is traced once and remembered; with many it is not."""
    rng = np.random.default_rng(count)
    shell = rng.uniform(-1, 1, (count, 3))
    shell[np.arange(count), rng.integers(0, 3, count)] = rng.choice([-1.0, 1.0], count)
    cloud = (shell * [2.5, 1.0, 0.8] + [20, -7, 1]).astype(np.float32)
    ours = _native.esf(cloud, np.array([0, count]), triples=2000, seed=5)[0]
    expected = reference_esf(cloud, 2000, 5)
    # A value on the edge of a bin may fall to either side.
    assert np.abs(ours - expected).sum() < 0.01
    assert abs(ours.sum() - 1) < 1e-5
    other = _native.esf(cloud, np.array([0, count]), triples=2000, seed=6)[0]
    assert np.abs(ours - other).sum() > 0.05


def test_segments_without_triangles_have_no_shape_functions() -> None:
    line = np.linspace([0, 0, 0], [1, 2, 3], 50, dtype=np.float32)
    offsets = np.array([0, 0, 1, 50])
    assert not _native.esf(line, offsets, triples=500).any()


@pytest.mark.parametrize(
    ("points", "offsets", "fault"),
    [
        (np.zeros((4, 2), "f4"), [0, 4], r"points must have shape \(M, 3\)"),
        (np.zeros((4, 3), "f4"), [0, 3], "offsets must end"),
        (np.full((4, 3), np.nan, "f4"), [0, 4], "not finite"),
    ],
)
def test_wrong_input_is_refused(points: np.ndarray, offsets: list[int], fault: str) -> None:
    for kernel in (_native.esf, _native.segment_moments, _native.gestalt):
        with pytest.raises(ValueError, match=fault):
            kernel(points, np.array(offsets))


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


@settings(max_examples=15)
@given(st.integers(0, 99), st.floats(-math.pi, math.pi), st.floats(-40, 40))
def test_turning_moving_and_reordering_change_nothing(seed: int, yaw: float, x: float) -> None:
    rng = np.random.default_rng(seed)
    cloud = rng.normal(0, [3.0, 1.0, 0.7], (200, 3))
    moved = rng.permutation(geometry.transform(geometry.yaw_transform(yaw, (x, 5, 0)), cloud))
    first, second = numbers(packed([cloud, moved]))
    np.testing.assert_allclose(first, second, atol=2e-3)
