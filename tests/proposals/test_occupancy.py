"""Occupancy search: free cells, storeys, and whole queries."""

from __future__ import annotations

import math

import numpy as np
import pytest
from samples.maps import occupancy
from samples.plaza import Plaza
from segloc_lab.padding import mirrored

from segloc import Config, Localizer, Scan, SegmentMap, geometry
from segloc.proposals.occupancy import OccupancyConfig, OccupancyProposer, storeys
from segloc.proposals.view import free_cells
from segloc.types import Pose


def test_free_cells_are_ground_with_nothing_beside_it() -> None:
    across = np.arange(-60, 60) * 0.25 + 0.1
    ground = np.stack(np.meshgrid(across, across), -1).reshape(-1, 2)
    ground = np.column_stack([ground, np.zeros(len(ground))]).astype(np.float32)
    standing = np.array([[0, 0], [4, 9], [-20, 7]])
    cells, clearance = free_cells(ground, standing, 0.5, 19.5)
    assert 0 < len(cells) <= 256 and (np.diff(clearance.astype(int)) <= 0).all()
    gap = np.abs(cells[:, None] - standing).max(axis=2).min(axis=1)
    np.testing.assert_array_equal(clearance, gap - 1)
    assert clearance.min() >= 1
    assert [len(part) for part in free_cells(ground[:0], standing, 0.5, 19.5)] == [0, 0]


def near(T: Pose, truth: Pose, metres: float = 2.0, degrees: float = 10.0) -> bool:
    delta = geometry.inverse(truth) @ T
    turned = math.degrees(geometry.rotation_angle(delta))
    return bool(np.hypot(*delta[:2, 3]) < metres and turned < degrees)


@pytest.mark.parametrize("yaw", [0.0, 2.0])
def test_the_best_candidate_is_near_the_truth(
    plaza: Plaza, localizer: Localizer, yaw: float
) -> None:
    T = geometry.yaw_transform(yaw, (3.0, -2.0, 1.7))
    scan = plaza.scan(T, seed=5)
    first, again = (occupancy(localizer).propose(localizer.describe(scan)) for _ in range(2))
    best = first[0]
    assert near(best.T_map_local, T) and abs(best.T_map_local[2, 3] - 1.7) < 0.5
    assert best.inliers == 0 and best.fit is not None and 0.5 < best.fit <= 1.0
    fits = [candidate.fit or 0.0 for candidate in first]
    assert fits == sorted(fits, reverse=True)
    assert [c.T_map_local.tolist() for c in first] == [c.T_map_local.tolist() for c in again]


def test_places_far_from_the_path_are_searched_where_the_map_is_small(
    plaza: Plaza, localizer: Localizer
) -> None:
    T = geometry.yaw_transform(1.0, (3.0, 33.0, 1.7))
    query, prior_map = localizer.describe(plaza.scan(T, seed=5)), localizer.prior_map
    found = {}
    for name, work in (("small", 1_200_000), ("large", 20_000)):
        config = OccupancyConfig(work=work)
        proposer = OccupancyProposer(
            prior_map.voxel_cloud, prior_map.trajectory, config, Config().segmentation
        )
        found[name] = proposer.propose(query)
    assert near(found["small"][0].T_map_local, T)
    off = np.array([c.T_map_local[:2, 3] for c in found["large"]])
    assert len(off) and off[:, 1].max() < 4.0 + 20.0 + 6.0


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
        assert occupancy(localizer).propose(localizer.describe(Scan(points))) == []
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
