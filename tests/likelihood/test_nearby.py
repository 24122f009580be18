"""Poses around a candidate: the correlation of clouds, walls by direction, rivals nearby."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from segloc import _native, geometry
from segloc.frontend.segmentation import Segmentation, Segmenter
from segloc.geometry import Separation
from segloc.likelihood import Count, Likelihood, Posterior, VerificationConfig, shipped_model
from segloc.likelihood.nearby import NearbySearch
from segloc.likelihood.next_view import next_view
from segloc.likelihood.observation import MapCloud, close_surface
from segloc.localization import Reason
from segloc.types import Candidate, Float32, LocalCloud, Pose

LAYERS, BELOW, BETWEEN = 8, 3.0, 0.3


BLOCK, COLUMN_M = 4, 4.0


def unmapped(cloud: Float32, T: Pose, cell: float, half: int) -> set[tuple[int, int]]:
    """(y, x) of cells in blocks where the map has nothing in the columns around."""
    columns = {tuple(c) for c in np.floor(cloud[:, :2] / COLUMN_M).astype(int)}
    cells: set[tuple[int, int]] = set()
    for y, x in np.ndindex(2 * half // BLOCK + 1, 2 * half // BLOCK + 1):
        at = np.array([x, y]) * BLOCK - half
        u, v = np.floor((T[:2, 3] + at * cell) / COLUMN_M).astype(int)
        if not any((u + i - 1, v + j - 1) in columns for i, j in np.ndindex(3, 3)):
            block = np.ndindex(BLOCK, BLOCK)
            cells |= {(int(at[1]) + i, int(at[0]) + j) for i, j in block}
    return cells


def occupied(cloud: Float32, T: Pose, cell: float) -> dict[tuple[int, int, int], int]:
    """(layer, y, x) of the map's cells: 4 for those with a point, 2 for the eight about each."""
    cells: dict[tuple[int, int, int], int] = {}
    for x, y, z in cloud - T[:3, 3]:
        low, high = np.floor(z + BELOW - BETWEEN), np.floor(z + BELOW + BETWEEN)
        for layer in range(int(max(low, 0)), int(min(high, LAYERS - 1)) + 1):
            at = np.floor(np.array([y, x]) / cell + 0.5).astype(int)
            for dy, dx in np.ndindex(3, 3):
                key = (layer, int(at[0]) + dy - 1, int(at[1]) + dx - 1)
                cells[key] = max(cells.get(key, 0), 4 if (dy, dx) == (1, 1) else 2)
    return cells


@settings(max_examples=8)
@given(st.integers(0, 2**32 - 1), st.sampled_from([0.25, 0.5, 1.0]))
def test_correlation_counts_cells_that_are_occupied_in_both(seed: int, cell: float) -> None:
    rng = np.random.default_rng(seed)
    most = rng.uniform(0, 14)  # the map may end where the query does not
    cloud = rng.uniform([-14, -14, -5], [most, 14, 8], (300, 3)).astype(np.float32)
    query = rng.uniform([-9, -9, -4], [9, 9, 6], (80, 3)).astype(np.float32)
    T = geometry.yaw_transform(rng.uniform(-3, 3), tuple(rng.uniform(-2, 2, 3)))
    counts, used = _native.PointIndex(cloud, 1.0).correlate(
        query, T, [0.0, 1.3], cell, 3 * cell, 8.0
    )
    assert counts.shape == (2, 7, 7)
    theirs = occupied(cloud, T, cell)
    half = int(np.ceil((8.0 + 5 * cell) / cell)) + 1
    nothing = unmapped(cloud, T, cell, half)
    for h, heading in enumerate((0.0, 1.3)):
        near = query[np.hypot(query[:, 0], query[:, 1]) < 8.0]
        turn = T[:3, :3] @ geometry.yaw_transform(heading)[:3, :3]
        moved = near @ turn.T
        layer = np.floor(moved[:, 2] + BELOW).astype(int)
        y, x = np.floor(moved[:, 1::-1].T / cell + 0.5).astype(int)
        inside = (layer >= 0) & (layer < LAYERS)
        own = set(zip(layer[inside], y[inside], x[inside], strict=True))
        assert used[h] == len(own)
        for i, j in np.ndindex(7, 7):
            moved_on = ((k, v + i - 3, u + j - 3) for k, v, u in own)
            assert counts[h, i, j] == sum(theirs.get(key, key[1:] in nothing) for key in moved_on)


def counted(
    target: _native.Surface, source: _native.Surface, T: Pose, slope: tuple[float, float], m: float
) -> Count:
    """Count the points of a slope that lie on a surface within ``m`` metres, of those near it."""
    off = target.off_plane(source, T, *slope, len(source))
    return Count(int((off < m).sum()), int(np.isfinite(off).sum()))


LEVEL, WALL = (0.9, 2.0), (-1.0, 0.3)


def test_points_on_a_plane_are_told_by_its_slope() -> None:
    rng = np.random.default_rng(0)
    ground = rng.uniform([-5, -5, 0], [5, 5, 0], (900, 3))
    wall = rng.uniform([-5, 5, 0], [5, 5, 4], (500, 3))
    points = np.float32(np.concatenate([ground, wall]))
    target = _native.Surface(points, 1.0, 0.8)
    # Without noise, and lifted: where a normal is known, all of a surface is equally far off.
    source = _native.Surface(points, 1.0, 0.8)
    normals = _native.normals(points, 1.0, 0.8)
    up = np.abs(normals[:, 2])
    T = geometry.rigid(np.eye(3), (0.0, 0.0, 0.15))
    level, steep = up > 0.99, (up < 0.3) & normals.any(axis=1)
    assert level.sum() > 800 and steep.sum() > 350
    assert counted(target, source, T, (0.99, 2.0), 0.1).hits <= 0.02 * level.sum()
    hits, of = counted(target, source, T, (0.99, 2.0), 0.2)
    assert hits >= 0.98 * of and level.sum() >= of >= 0.98 * level.sum()
    hits, of = counted(target, source, T, WALL, 0.1)
    assert hits >= 0.95 * of and steep.sum() >= of >= 0.95 * steep.sum()
    half = len(points) // 2
    off = target.off_plane(source, T, 0.99, 2.0, half)
    assert len(off) == len(source.sampled(half)) == half
    assert np.isfinite(off).sum() == pytest.approx(level.sum() / 2, rel=0.1)
    far = geometry.rigid(np.eye(3), (0.0, 0.0, 9.0))
    off = target.off_plane(source, far, -1.0, 2.0, len(points))
    assert np.isinf(off).any() and not np.isfinite(off).any()


def hall(first: int = -6, last: int = 6, marked: bool = True, seed: int = 3) -> Float32:
    """Pillars 5 m apart between two walls; where ``marked``, something stands in the middle."""
    rng = np.random.default_rng(seed)
    parts = [rng.uniform([-40, y, -1.5], [40, y + 0.05, 4.0], (9000, 3)) for y in (-7.0, 7.0)]
    parts.append(rng.uniform([-40, -7, -1.55], [40, 7, -1.5], (9000, 3)))
    for k in range(first, last + 1):
        for y in (-3.0, 3.0):
            angle = rng.uniform(0, 2 * np.pi, 500)
            ring = np.stack([0.3 * np.cos(angle), 0.3 * np.sin(angle)], axis=1) + (5.0 * k, y)
            parts.append(np.column_stack([ring, rng.uniform(-1.5, 4.0, 500)]))
    if marked:
        parts.append(rng.uniform([0.8, 3.8, -1.5], [4.0, 6.2, 1.5], (2500, 3)))
    return np.concatenate(parts).astype(np.float32)


def scene(cloud: Float32) -> Segmentation:
    near = cloud[np.abs(cloud[:, 0]) < 18.0]
    return Segmenter().segment(LocalCloud(near, np.eye(4)))


def test_a_place_one_period_off_is_found_from_its_alias() -> None:
    index = _native.PointIndex(hall(), 0.5)
    search = NearbySearch(index, Separation())
    points = scene(hall()).structure
    found = search.around(points, geometry.yaw_transform(0.0, (5.0, 0.0, 0.0)))
    assert any(np.abs(T - np.eye(4)).max() < 0.3 for T in found)


def posterior(cloud: Float32, seen: Float32, candidate: Candidate) -> Posterior:
    path = np.zeros((1, 3))
    likelihood = Likelihood(
        MapCloud(cloud, np.zeros(3), Separation(), 0, False, path),
        VerificationConfig(),
        Separation(),
        shipped_model(),
    )
    scorer = likelihood.scorer(likelihood.query(scene(seen)), lambda _: candidate.inliers)
    scorer.add([candidate])
    return scorer.measure(thorough=True)


@pytest.mark.parametrize("alias", [(5.0, 0.0), (10.0, np.pi)])
def test_the_better_pose_nearby_is_judged_instead(alias: tuple[float, float]) -> None:
    x, yaw = alias
    wrong = Candidate(geometry.yaw_transform(yaw, (x, 0.0, 0.0)), 3)
    best, *others = (place.T_map_local for place in posterior(hall(), hall(), wrong).places)
    assert np.hypot(*best[:2, 3]) < 0.2 and np.cos(geometry.heading(best)) > 0.99
    assert any(np.hypot(*T[:2, 3]) > 2.0 for T in others)


def test_where_a_place_repeats_itself_nothing_is_believed() -> None:
    for seed in range(3, 9, 2):
        bare, seen = (hall(marked=False, seed=each) for each in (seed, seed + 1))
        found = posterior(bare, seen, Candidate(np.eye(4), 6))
        assert found.reason(0.99) in (Reason.AMBIGUOUS, Reason.TOO_UNCERTAIN)


def test_walls_that_are_off_by_decimetres_are_not_flush() -> None:
    """Rooms that are alike: nearly all points lie near a point of the other, few on its walls."""
    room = np.concatenate([hall(), hall()[:, [1, 0, 2]]])
    map_cloud = _native.voxel_grid(room, 0.3)
    few = np.ascontiguousarray(room[::3])
    surface, query = close_surface(map_cloud), close_surface(_native.voxel_grid(few, 0.3))
    index = _native.PointIndex(map_cloud, 0.5)
    shares = []
    for metres in (0.0, 0.2):
        T = geometry.yaw_transform(0.0, (metres, metres, 0.0))
        share = counted(surface, query, T, WALL, 0.1).share
        assert share is not None
        shares.append((share, float(index.overlap(few[:2000], T[None], 0.3, 0.0)[0])))
    (flush, fits), (off, still_fits) = shares
    assert fits > 0.95 and still_fits > 0.85
    assert flush > 0.85 and off < 0.35
    assert counted(surface, close_surface(room[:2]), np.eye(4), WALL, 0.1).share is None


def test_ground_that_rises_and_falls_otherwise_does_not_fit() -> None:
    x, y = np.random.default_rng(5).uniform(-20, 20, (2, 20_000))
    waves = np.column_stack([x, y, 0.4 * np.sin(x / 3) + 0.4 * np.cos(y / 4)]).astype(np.float32)
    hills = _native.Surface(waves, 1.5, 0.8)
    half = _native.Surface(waves[x < 0], 1.5, 0.8)  # the rest lies beyond the map's end
    shifted = geometry.yaw_transform(0.0, (9.0, 0.0, 0.0))
    for target, T, low, high in ((hills, np.eye(4), 0.99, 1), (half, np.eye(4), 0.95, 1)):
        ground = counted(target, hills, T, LEVEL, 0.2).share
        assert ground is not None and low <= ground <= high
    wrong = counted(hills, hills, shifted, LEVEL, 0.2).share
    assert wrong is not None and wrong < 0.4
    assert counted(hills, _native.Surface(waves[:2], 1.5, 0.8), np.eye(4), LEVEL, 0.2).share is None


def test_the_next_view_is_where_two_places_differ() -> None:
    """Two bays of a hall 10 m apart; a crate stands 14 m beyond one of them."""
    crate = np.random.default_rng(0).uniform([13.0, -6.0, -1.5], [17.0, 6.0, 3.0], (4000, 3))
    cloud = np.concatenate([hall(-12, 12, marked=False), crate.astype(np.float32)])
    path = np.column_stack([np.arange(-38.0, 38.0), np.zeros((76, 2))])
    index = _native.PointIndex(cloud, 0.5)
    one, other = (geometry.yaw_transform(0.0, (x, 0.0, 0.0)) for x in (-20.0, -30.0))
    step = next_view(index, path, one, other)
    assert step is not None

    def alike(metres: float) -> float:
        x = metres * np.cos(np.radians(step.bearing_deg))
        views = [
            cloud[np.hypot(cloud[:, 0] - x - T[0, 3], cloud[:, 1]) < 25.0] for T in (one, other)
        ]
        moved = [views[0] - np.float32([10, 0, 0]), views[1] + np.float32([10, 0, 0])]
        return min(float((cKDTree(cloud).query(points)[0] < 0.5).mean()) for points in moved)

    assert alike(step.metres) < alike(0.0) - 0.1
    assert next_view(index, path, one, one) is None
