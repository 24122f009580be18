"""SegMatch's features against closed forms and against NumPy."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from segloc import _native
from segloc.descriptors.segmatch import ETH_MAXIMA, eigen_features, eth_features
from segloc.types import Segments


def packed(*clouds: np.ndarray) -> Segments:
    points = np.vstack(clouds).astype(np.float32)
    offsets = np.cumsum([0, *map(len, clouds)], dtype=np.int64)
    return Segments(
        points, offsets, np.stack([c.mean(axis=0) for c in clouds]), np.ones(len(clouds), "f4")
    )


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
    features = eigen_features(packed(line, plane, sphere))
    # Omnivariance is a cube root: it magnifies what rounding leaves of an eigenvalue of zero.
    np.testing.assert_allclose(features, expected, atol=3e-3)


@settings(max_examples=15)
@given(st.integers(0, 10_000), st.integers(4, 300), st.floats(0.01, 50))
def test_moments_are_those_of_numpy(seed: int, count: int, size: float) -> None:
    rng = np.random.default_rng(seed)
    clouds = [
        rng.normal(rng.uniform(-50, 50, 3), rng.uniform(0, size, 3), (count, 3)) for _ in "ab"
    ]
    segments = packed(*clouds)
    means, values = _native.segment_moments(segments.points, segments.offsets)
    for i in range(2):
        points = segments.segment(i).astype(np.float64)
        np.testing.assert_allclose(means[i], points.mean(axis=0), atol=1e-9)
        expected = np.linalg.eigvalsh(np.cov(points.T, bias=True))[::-1]
        np.testing.assert_allclose(values[i], expected, rtol=1e-4, atol=1e-9 + 1e-5 * size**2)


def test_the_variant_of_the_eth_code() -> None:
    rng = np.random.default_rng(0)
    flat, tall = rng.uniform(-1, 1, (2, 500, 3)) * [[[3, 2, 0.5]], [[1, 2, 3]]]
    features = eth_features(packed(flat, tall))
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
