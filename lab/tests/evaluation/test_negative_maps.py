"""Maps in which nothing is to be found: mirrored, mixed up, or repeating themselves."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from samples.plaza import Plaza, PlazaSequence
from scipy.spatial import cKDTree
from segloc_lab.padding import mirrored, remade

from segloc import Config, Localizer, build_map, geometry
from segloc.tools.datasets import open_sequence
from segloc.types import Float64, Scan


@pytest.mark.slow
def test_mirrored_and_shuffled_maps_of_real_scans(kitti: Path) -> None:
    poses = kitti / "keyframes.tum"
    config = Config.preset("profile")
    prior_map = build_map(open_sequence(kitti / "keyframes", poses, "1361:1413"), config)
    queries = open_sequence(kitti / "keyframes", poses, "948:999")
    requested = [range(i - 20, i + 1) for i in (20, 28, 36)] + [
        range(i, i + 1) for i in (10, 25, 40)
    ]
    right = Localizer(prior_map, config)
    order = np.random.default_rng(0).permutation(len(prior_map))
    shuffled = remade(prior_map, vectors=prior_map.vectors[order])
    behind_the_mirror, mixed_up = (Localizer(m, config) for m in (mirrored(prior_map), shuffled))
    for scans in requested:
        query = [queries.scan(k) for k in scans]
        assert len(query) == 1 or right.localize(query).localized
        assert not behind_the_mirror.localize(query).localized
        result = mixed_up.localize(query)  # where centroids alone suffice, it may be found
        if result.T_map_sensor is not None:
            delta = geometry.inverse(queries.poses[scans[-1]]) @ result.T_map_sensor
            assert np.linalg.norm(delta[:3, 3]) < 3


def test_a_mirrored_map_has_its_path_where_the_cloud_is() -> None:
    config = Config.preset("geo")
    before = build_map(PlazaSequence(Plaza(3), steps=4), config)
    after = mirrored(before)
    path, rotations = after.trajectory[:, :3, 3], after.trajectory[:, :3, :3]
    assert np.allclose(np.linalg.det(rotations), 1.0, atol=1e-3)
    assert np.allclose(path * (1, -1, 1), before.trajectory[:, :3, 3])
    ahead = [T[:3, 0] * (1, -1, 1) for T in after.trajectory]  # where the sensor looked
    assert np.allclose(ahead, before.trajectory[:, :3, 0])
    near = [cKDTree(m.cloud + m.origin).query(m.trajectory[:, :3, 3])[0] for m in (before, after)]
    assert np.allclose(*near, atol=1e-3)


def boxes(positions: Float64, rng: np.random.Generator) -> Float64:
    """Equal boxes, 4.4 m by 1.8 m by 1.5 m, as many points as a car would get."""
    shell = rng.uniform(-1, 1, (600, 3))
    face = rng.integers(0, 3, 600)
    shell[np.arange(600), face] = np.sign(shell[np.arange(600), face])
    one = shell * (2.2, 0.9, 0.75) + (0, 0, 0.75)
    return np.concatenate([one + p for p in positions])


class Rows(Plaza):
    """What repeats itself: a car park of equal rows, or a corridor of equal pillars."""

    def __init__(self, positions: Float64) -> None:
        rng = np.random.default_rng(1)
        xy = rng.uniform(-90, 90, (60_000, 2))
        floor = np.column_stack([xy, rng.normal(0, 0.02, 60_000)])
        self.points = np.concatenate([floor, boxes(positions, rng)])


def grid(nx: int, ny: int, dx: float, dy: float) -> Float64:
    x, y = np.meshgrid(np.arange(nx) * dx, np.arange(ny) * dy)
    flat = np.column_stack([x.ravel(), y.ravel(), np.zeros(nx * ny)])
    return np.asarray(flat - flat.mean(axis=0) * (1, 1, 0))


@pytest.mark.slow
@pytest.mark.parametrize("method", ["profile", "geo"])
@pytest.mark.parametrize(
    "positions", [grid(24, 8, 7.0, 12.0), grid(24, 2, 7.0, 8.0)], ids=["car park", "corridor"]
)
def test_a_place_that_repeats_itself_is_not_guessed(positions: Float64, method: str) -> None:
    place = Rows(positions)
    config = Config.preset(method)
    prior_map = build_map(PlazaSequence(place, steps=8), config)
    localizer = Localizer(prior_map, config)
    for k, (x, y, yaw) in enumerate([(-6.0, 3.5, 0.2), (1.0, 3.5, 3.0), (8.0, 3.5, 1.5)]):
        scan: Scan = place.scan(geometry.yaw_transform(yaw, (x, y, 1.7)), posed=False, seed=k + 50)
        result = localizer.localize(scan)
        assert not result.localized, result
