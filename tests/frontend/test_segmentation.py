"""Voxel grid, ground and clusters against short references, and the whole stage on scenes."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from samples.lattice import exact_means
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from segloc import _native
from segloc.frontend.local_cloud import Accumulator
from segloc.frontend.segmentation import (
    SegmentationConfig,
    Segmenter,
    heights_above_ground,
)
from segloc.types import Float32, LocalCloud, Scan


def cloud_of(points: np.ndarray, num_scans: int = 2) -> LocalCloud:
    return LocalCloud(np.ascontiguousarray(points, np.float32), np.eye(4), num_scans)


def reference_labels(points: Float32, radius: float) -> np.ndarray:
    pairs = cKDTree(points).query_pairs(radius, output_type="ndarray")
    links = coo_matrix((np.ones(len(pairs)), pairs.T), shape=(len(points),) * 2)
    return connected_components(links, directed=False)[1]


def partition(members: np.ndarray, offsets: np.ndarray) -> set[frozenset[int]]:
    return {frozenset(part.tolist()) for part in np.split(members, offsets[1:-1]) if len(part)}


@settings(max_examples=30)
@given(st.integers(0, 2**32 - 1), st.integers(1, 400), st.floats(0.05, 3.0))
def test_voxel_grid_is_the_mean_of_each_voxel(seed: int, count: int, size: float) -> None:
    points = np.random.default_rng(seed).uniform(-5, 5, (count, 3)).astype(np.float32)
    expected = exact_means(points.astype(np.float64), size)
    found = _native.voxel_grid(points, size)
    assert found.shape == expected.shape
    np.testing.assert_allclose(found, expected, atol=1e-5)


@settings(max_examples=25)
@given(st.integers(0, 2**32 - 1), st.integers(1, 600), st.floats(0.05, 1.5))
def test_clusters_are_the_connected_components(seed: int, count: int, radius: float) -> None:
    points = np.random.default_rng(seed).uniform(-3, 3, (count, 3)).astype(np.float32)
    labels = reference_labels(points, radius)
    expected = {frozenset(np.flatnonzero(labels == k).tolist()) for k in range(labels.max() + 1)}
    assert partition(*_native.euclidean_clusters(points, radius, 1, count)) == expected
    kept = partition(*_native.euclidean_clusters(points, radius, 2, 5))
    assert kept == {part for part in expected if 2 <= len(part) <= 5}


@settings(max_examples=20)
@given(
    st.integers(0, 2**32 - 1),
    st.integers(0, 600),
    st.lists(st.floats(-3, 3), min_size=1, max_size=4),
    st.floats(0.05, 1.5),
)
def test_segments_above_several_heights_are_the_clusters_above_each(
    seed: int, count: int, cuts: list[float], radius: float
) -> None:
    rng = np.random.default_rng(seed)
    points = rng.uniform(-3, 3, (count, 3)).astype(np.float32)
    heights = (points[:, 2] + rng.uniform(-1, 1, count)).astype(np.float32)
    members, offsets, centroids, means = _native.segments_above(
        points, heights, cuts, radius, 2, 50
    )
    expected = []
    for cut in cuts:
        above = np.flatnonzero(heights > cut)
        rows, ends = _native.euclidean_clusters(points[above], radius, 2, 50)
        expected += [above[rows[a:b]] for a, b in itertools.pairwise(ends)]
    found = [members[a:b] for a, b in itertools.pairwise(offsets)]
    assert [f.tolist() for f in found] == [points[e].tolist() for e in expected]
    for centroid, mean, each in zip(centroids, means, expected, strict=True):
        np.testing.assert_allclose(centroid, points[each].mean(axis=0, dtype=np.float64))
        np.testing.assert_allclose(mean, heights[each].mean(dtype=np.float64), rtol=1e-6)


def hillside(rng: np.random.Generator, slope: float, count: int = 20_000) -> np.ndarray:
    xy = rng.uniform(-30, 30, (count, 2))
    z = slope * xy[:, 0] + 0.3 * np.sin(xy[:, 1] / 4) + rng.normal(0, 0.02, count)
    return np.column_stack([xy, z])


@pytest.mark.parametrize("slope", [0.0, -0.15])
def test_heights_are_those_above_a_sloping_ground(slope: float) -> None:
    rng = np.random.default_rng(0)
    ground = hillside(rng, slope)
    foot = ground[rng.choice(len(ground), 300)]
    above = rng.uniform(0.5, 5, 300)
    points = np.vstack([ground, foot + above[:, None] * [0, 0, 1]]).astype(np.float32)
    heights = _native.heights_above_ground(points, 1.0, 0.2, 0.3)
    assert np.percentile(np.abs(heights[: len(ground)]), 99) < 0.3
    assert np.abs(heights[len(ground) :] - above).max() < 0.4


def test_a_clump_of_mirror_images_below_ground_lifts_nothing() -> None:
    rng = np.random.default_rng(2)
    points = hillside(rng, 0.05)
    ghosts = rng.uniform([6, -3, -2.5], [10, 1, -1.0], (400, 3))
    both = np.vstack([points, ghosts]).astype(np.float32)
    heights = _native.heights_above_ground(both, 1.0, 0.2, 0.3)
    assert np.percentile(np.abs(heights[: len(points)]), 99) < 0.4


def pillars(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Ground with six pillars of different sizes; and where they stand."""
    places = np.array([[5, 5], [-8, 3], [12, -9], [-14, -12], [0, 15], [18, 10.0]])
    parts = [hillside(rng, 0.02, 40_000)]
    for k, (x, y) in enumerate(places):
        size = rng.uniform(-1, 1, (800, 3)) * [0.4 + 0.1 * k, 0.5, 1.2] + [x, y, 1.4 + 0.02 * x]
        parts.append(size)
    return np.vstack(parts), places


def test_pillars_become_segments_in_any_order_of_points() -> None:
    rng = np.random.default_rng(2)
    points, places = pillars(rng)
    first = Segmenter().segment(cloud_of(points)).segments
    again = Segmenter().segment(cloud_of(rng.permutation(points))).segments
    assert len(first) == 2 * len(places)  # once above each height cut
    distance = np.linalg.norm(first.centroids[:, None, :2] - places, axis=2)
    assert distance.min(axis=1).max() < 0.1 and set(distance.argmin(axis=1)) == set(range(6))
    np.testing.assert_allclose(first.centroids, again.centroids, atol=1e-5)
    np.testing.assert_array_equal(first.sizes, again.sizes)
    for index in range(len(first)):
        np.testing.assert_allclose(
            first.segment(index).mean(axis=0), first.centroids[index], atol=1e-4
        )


@settings(max_examples=30)
@given(st.integers(0, 2**32 - 1), st.integers(3, 300), st.floats(0.05, 2.0))
def test_spacing_is_the_median_distance_to_the_second_nearest_other(
    seed: int, count: int, least: float
) -> None:
    points = np.random.default_rng(seed).uniform(-5, 5, (count, 3)).astype(np.float32)
    drawn = points[np.arange(min(count, 64)) * count // min(count, 64)]
    distances = np.asarray(cKDTree(points).query(drawn, k=3)[0])
    nearest = np.sort(distances[:, 2])
    expected = max(least, nearest[len(nearest) // 2])
    assert _native.point_spacing(points, least, 64) == pytest.approx(expected, rel=1e-4)


@pytest.mark.parametrize("num_scans", [1, 5])
@pytest.mark.parametrize("voxel", [0.05, 0.3, 1.0])
def test_walls_become_segments_however_coarse_the_cloud(voxel: float, num_scans: int) -> None:
    rng = np.random.default_rng(4)
    places = np.array([[8.0, 0.0], [-8.0, 6.0], [0.0, -14.0]])
    parts = [hillside(rng, 0.0, 80_000)]
    parts += [rng.uniform(-1, 1, (8000, 3)) * [3.0, 0.05, 1.5] + [x, y, 1.6] for x, y in places]
    coarse = _native.voxel_grid(np.concatenate(parts).astype(np.float32), voxel)
    segments = Segmenter().segment(cloud_of(coarse, num_scans)).segments
    assert len(segments) == 2 * len(places)  # once above each height cut
    gap = np.linalg.norm(segments.centroids[:, None, :2] - places, axis=2)
    assert gap.min(axis=1).max() < 0.3 + 1.5 * voxel and set(gap.argmin(axis=1)) == {0, 1, 2}


def test_a_moved_cloud_gives_moved_segments() -> None:
    points, _ = pillars(np.random.default_rng(3))
    shift = np.array([2.0, -3.0, 0.4])  # whole voxels: the lattice stays the same
    first = Segmenter().segment(cloud_of(points)).segments
    moved = Segmenter().segment(cloud_of(points + shift)).segments
    assert len(first) == len(moved)
    gap = cKDTree(moved.centroids).query(first.centroids + shift)[0]
    assert gap.max() < 0.05


@pytest.mark.parametrize("num_scans", [1, 5])
@pytest.mark.parametrize(
    "points",
    [
        np.empty((0, 3)),
        np.zeros((1, 3)),
        np.zeros((3, 3)),
        np.zeros((1000, 3)),
        np.linspace([0, 0, 0], [40, 0, 0], 500),
        np.linspace([0, 0, 0], [0, 0, 20], 500),
        np.full((10, 3), 9e4),
    ],
)
def test_degenerate_clouds_give_few_or_no_segments(points: np.ndarray, num_scans: int) -> None:
    scene = Segmenter().segment(cloud_of(points, num_scans))
    assert len(scene.segments) <= 2
    assert np.isfinite(scene.segments.centroids).all()
    assert np.isfinite(scene.segments.heights).all()


def test_ground_of_a_cloud_tens_of_kilometres_wide() -> None:
    rng = np.random.default_rng(5)
    near = rng.uniform(0.0, 20.0, (4000, 3)) * [1, 1, 0.1]
    far = np.concatenate([near, near + [30_000.0, 41_000.0, 50.0]]).astype(np.float32)
    heights = heights_above_ground(far, SegmentationConfig())
    expected = heights_above_ground(near.astype(np.float32), SegmentationConfig())
    np.testing.assert_allclose(heights[:4000], expected, atol=1e-5)
    assert np.median(np.abs(heights[4000:] - expected)) < 0.1


def test_scans_of_a_few_points_far_apart_are_no_error() -> None:
    segmenter, accumulator = Segmenter(), Accumulator()
    for seed in range(40):
        rng = np.random.default_rng(seed)
        count = rng.integers(8, 40)
        turn, away = rng.uniform(0, 2 * np.pi, count), rng.uniform(5, 49, count)
        points = [away * np.cos(turn), away * np.sin(turn), rng.uniform(-1.7, 8, count)]
        scene = segmenter.segment(accumulator.gather(Scan(np.column_stack(points))))
        assert len(scene.segments) <= count
