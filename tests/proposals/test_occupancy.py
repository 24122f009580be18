"""Occupancy search: the kernel against a reference, and whole queries."""

from __future__ import annotations

import math

import numpy as np
import pytest
from samples.maps import occupancy
from samples.plaza import Plaza
from segloc_lab.padding import mirrored

from segloc import Config, Localizer, Scan, SegmentMap, _native, geometry
from segloc.proposals.occupancy import OccupancyConfig, free_cells, storeys
from segloc.types import Pose

CELL, LEVELS, YAWS, RANGE_M = 0.5, 4, 24, 15.0
FEWEST_FREE = 64


def scattered(seed: int, count: int = 2000) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    points = (rng.uniform(-25, 25, (count, 3)) * [1, 1, 0]).astype(np.float32)
    return points, rng.integers(1, 256, count).astype(np.uint8)


def reference_scores(
    points: np.ndarray,
    slices: np.ndarray,
    columns: np.ndarray,
    masks: np.ndarray,
    free: np.ndarray,
    yaw: float,
) -> dict[tuple[int, int], tuple[int, float]]:
    """What each window of two by two cells holds at a heading, and that less the cost of what is
    blocked, by looking up every cell."""
    occupied: dict[tuple[int, int], int] = {}
    for (x, y), bits in zip(np.floor(points[:, :2] / CELL).astype(int), slices, strict=True):
        occupied[x, y] = occupied.get((x, y), 0) | int(bits)
    c, s = math.cos(yaw), math.sin(yaw)
    turned = np.array([[c, s], [-s, c]])
    offsets = np.floor(columns.astype(np.float64) @ turned / CELL).astype(int)
    clear = np.floor(free.astype(np.float64) @ turned / CELL).astype(int)
    most = sum(int(mask).bit_count() for mask in masks)
    scores = {}
    for x in range(-16, 16, 2):
        for y in range(-16, 16, 2):
            total = 0
            for (dx, dy), mask in zip(offsets, masks, strict=True):
                window = [(x + dx + i, y + dy + j) for i in (0, 1) for j in (0, 1)]
                found = 0
                for cell in window:
                    found |= occupied.get(cell, 0)
                total += (found & int(mask)).bit_count()
            seen = (occupied.get((x + 1 + dx, y + 1 + dy), 0) for dx, dy in clear)
            blocked = sum((found & 0b1111).bit_count() >= 3 for found in seen)
            scores[x, y] = total, total - 2 * most * blocked / max(len(free), FEWEST_FREE)
    return scores


@pytest.mark.parametrize(("seed", "count"), [(0, 0), (2, 50)])
def test_the_search_finds_what_trying_every_window_finds(seed: int, count: int) -> None:
    points, slices = scattered(seed)
    rng = np.random.default_rng(100 + seed)
    columns = rng.uniform(-9, 9, (40, 2)).astype(np.float32)
    masks = (1 << rng.integers(0, 8, 40)).astype(np.uint8)
    free = rng.uniform(-9, 9, (count, 2)).astype(np.float32)
    clearance = np.sort(rng.integers(1, 6, count))[::-1].astype(np.uint8)
    roots = np.ascontiguousarray(np.mgrid[-2:2, -2:2].reshape(2, -1).T.astype(np.int32))
    search = _native.PoseSearch(points, slices, roots, CELL, LEVELS, RANGE_M)
    poses, scores = search.search(
        columns, masks, free, clearance, yaws=YAWS, leaf_level=1, width=10**6, count=5,
        separation=0.0, separation_deg=0.0,
    )  # fmt: skip
    every = {
        (x, y, k): reached
        for k in range(YAWS)
        for (x, y), reached in reference_scores(
            points, slices, columns, masks, free[clearance >= 2], 2 * math.pi * k / YAWS
        ).items()
    }
    best = sorted((net for _, net in every.values()), reverse=True)
    np.testing.assert_allclose(scores[:3], best[:3], rtol=1e-6)
    assert (np.diff(scores) <= 0).all()
    found = []
    for (x, y, yaw), score in zip(poses, scores, strict=True):  # centred about the window
        held = [
            held
            for (i, j, k), (held, net) in every.items()
            if abs(net - score) < 1e-3
            and math.hypot(CELL * (i + 0.5) - x, CELL * (j + 0.5) - y) < 1.5 * CELL
            and abs(math.remainder(2 * math.pi * k / YAWS - yaw, math.tau)) < 2.01 * math.pi / YAWS
        ]
        assert held
        found.append(max(held))
    most = max(held for held, _ in every.values())
    assert max(found) == most
    if count == 50:
        assert best[0] < most  # what holds the most is blocked
    narrow = search.search(
        columns, masks, free, clearance, yaws=YAWS, leaf_level=1, width=500, count=1,
        separation=0.0, separation_deg=0.0,
    )  # fmt: skip
    assert narrow[1][0] <= scores[0]


def test_the_kernel_refuses_what_it_cannot_use() -> None:
    points, slices = scattered(0)
    roots = np.zeros((1, 2), np.int32)
    with pytest.raises(ValueError, match="one value for each point"):
        _native.PoseSearch(points, slices[:5], roots, CELL, LEVELS, RANGE_M)
    with pytest.raises(ValueError, match="too far apart"):
        apart = np.array([[0, 0], [10**6, 10**6]], np.int32)
        _native.PoseSearch(points, slices, apart, CELL, LEVELS, RANGE_M)
    search = _native.PoseSearch(points, slices, roots, CELL, LEVELS, RANGE_M)
    near, far = np.zeros((2, 2), np.float32), np.full((2, 2), 40, np.float32)
    clearance, requested = np.array([3, 1], np.uint8), (8, 1, 10, 1, 1.0, 1.0)
    with pytest.raises(ValueError, match="columns lie beyond the range"):
        search.search(far, slices[:2], near, clearance, *requested)
    with pytest.raises(ValueError, match="free places lie beyond the range"):
        search.search(near, slices[:2], far, clearance, *requested)
    with pytest.raises(ValueError, match="clearest free places must come first"):
        search.search(near, slices[:2], near, clearance[::-1].copy(), *requested)
    with pytest.raises(ValueError, match="one value for each free place"):
        search.search(near, slices[:2], near, clearance[:1], *requested)


def test_free_cells_are_ground_with_nothing_beside_it() -> None:
    config = OccupancyConfig(cell=0.5, range_m=20.0)
    across = np.arange(-60, 60) * 0.25 + 0.1
    ground = np.stack(np.meshgrid(across, across), -1).reshape(-1, 2)
    ground = np.column_stack([ground, np.zeros(len(ground))]).astype(np.float32)
    standing = np.array([[0, 0], [4, 9], [-20, 7]])
    cells, clearance = free_cells(ground, standing, config)
    assert 0 < len(cells) <= 256 and (np.diff(clearance.astype(int)) <= 0).all()
    gap = np.abs(cells[:, None] - standing).max(axis=2).min(axis=1)
    np.testing.assert_array_equal(clearance, gap - 1)
    assert clearance.min() >= 1
    assert [len(part) for part in free_cells(ground[:0], standing, config)] == [0, 0]


@pytest.fixture(scope="module")
def localizer(plaza_map: SegmentMap) -> Localizer:
    return Localizer(plaza_map)


def near(T: Pose, truth: Pose, metres: float = 2.0, degrees: float = 10.0) -> bool:
    delta = geometry.inverse(truth) @ T
    turned = math.degrees(geometry.rotation_angle(delta))
    return bool(np.hypot(*delta[:2, 3]) < metres and turned < degrees)


@pytest.mark.parametrize("yaw", [0.0, 2.0])
def test_the_best_candidate_is_near_the_truth(
    plaza: Plaza, localizer: Localizer, yaw: float
) -> None:
    T = geometry.yaw_transform(yaw, (3.0, -2.0, 1.7))
    scene = localizer.describe(plaza.scan(T, seed=5)).scene
    first, again = (occupancy(localizer).candidates(scene) for _ in range(2))
    best = first[0]
    assert near(best.T_map_local, T) and abs(best.T_map_local[2, 3] - 1.7) < 0.5
    assert best.inliers == 0 and best.fit is not None and 0.5 < best.fit <= 1.0
    fits = [candidate.fit or 0.0 for candidate in first]
    assert fits == sorted(fits, reverse=True)
    assert [c.T_map_local.tolist() for c in first] == [c.T_map_local.tolist() for c in again]


def test_a_query_without_segments_is_localized_by_what_stands(
    plaza: Plaza, localizer: Localizer
) -> None:
    T = geometry.yaw_transform(0.7, (3.0, -2.0, 1.7))
    config = localizer.config
    single = config.segmentation.single.model_copy(update={"min_points": 10**6})
    segmentation = config.segmentation.model_copy(update={"single": single})
    blind = config.model_copy(update={"segmentation": segmentation})
    scan = plaza.scan(T, seed=6)
    result = Localizer(localizer.prior_map, blind).localize(scan)
    assert result.counts["segments"] == 0
    assert result.T_map_sensor is not None and near(result.T_map_sensor, T, 0.2, 1.0)
    off = blind.occupancy.model_copy(update={"enabled": False})
    without = Localizer(localizer.prior_map, blind.model_copy(update={"occupancy": off}))
    assert not without.localize(scan).localized
    behind_a_mirror = Localizer(mirrored(localizer.prior_map), blind)
    assert not behind_a_mirror.localize(scan).localized


def test_little_to_see_gives_no_candidate(localizer: Localizer) -> None:
    rng = np.random.default_rng(0)
    floor = (rng.uniform(-20, 20, (4000, 3)) * [1, 1, 0] - [0, 0, 1.7]).astype(np.float32)
    for points in (np.empty((0, 3), np.float32), np.zeros((1, 3), np.float32), floor):
        scene = localizer.describe(Scan(points)).scene
        assert occupancy(localizer).candidates(scene) == []
    empty = SegmentMap.empty("geo", localizer.prior_map.fingerprint, localizer.prior_map.dim)
    assert not Localizer(empty, Config.preset("geo")).localize(Scan(floor)).localized


def storey(rng: np.random.Generator, z: float) -> tuple[np.ndarray, np.ndarray]:
    """The cloud of a floor, its ceiling and a few posts, and the path of a sensor 0.6 m above."""
    flat = np.mgrid[0:20:0.3, 0:10:0.3].reshape(2, -1).T
    posts = np.repeat(rng.uniform([0, 0], [20, 10], (12, 2)), 9, axis=0)
    heights = np.tile(0.3 * np.arange(1, 10), 12)
    parts = [(flat, np.zeros(len(flat))), (flat, np.full(len(flat), 2.8)), (posts, heights)]
    cloud = np.concatenate([np.column_stack([xy, z + h]) for xy, h in parts])
    path = np.column_stack([np.linspace(1, 19, 30), np.full(30, 5.0), np.full(30, z + 0.6)])
    return cloud.astype(np.float32), path


def test_storeys_are_told_apart_and_hills_are_not() -> None:
    rng = np.random.default_rng(0)
    floors = [storey(rng, z) for z in (0.0, 3.1, 6.2)]
    cloud, path = (np.concatenate(parts) for parts in zip(*floors, strict=True))
    parts = list(storeys(cloud, path))
    assert len(parts) == 3
    for (found, way), (expected, line) in zip(parts, floors, strict=True):
        np.testing.assert_array_equal(found, expected)
        np.testing.assert_array_equal(way, line)
    hill = path.copy()
    hill[:, 0] += np.repeat([0.0, 20.0, 40.0], 30)  # as high, but beside each other
    assert len(list(storeys(cloud, hill))) == 1
    assert len(list(storeys(cloud, np.empty((0, 3))))) == 1
