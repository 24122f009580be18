"""Geometric consistency against an exhaustive search, among nine wrong matches in ten."""

from __future__ import annotations

import math
from itertools import combinations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from segloc import _native, geometry
from segloc.proposals.pose import PoseConfig, PoseEstimator
from segloc.types import Matches

RESOLUTION = 0.4


def planted(seed: int, true: int = 6, wrong: int = 54) -> tuple[np.ndarray, np.ndarray, Matches]:
    """Matches of which ``true`` keep their distances but for noise; the others are random.

    Some objects of the query are matched several times, and some segments of the map.
    """
    rng = np.random.default_rng(seed)
    count = true + wrong
    query = rng.uniform([-40, -40, 0], [40, 40, 5], (count // 2, 3))
    rows = np.concatenate([np.arange(true), rng.integers(0, len(query), wrong)])
    T = geometry.yaw_transform(rng.uniform(-math.pi, math.pi), (120.0, -80.0, 2.0))
    place = rng.uniform([60, -140, -2], [180, -20, 6], (count, 3))
    place[:true] = geometry.transform(T, query[:true]) + rng.normal(0, 0.05, (true, 3))
    order = rng.permutation(count)
    columns = np.where(rng.random(count) < 0.1, rng.integers(true, count, count), np.arange(count))
    columns[:true] = np.arange(true)
    zero = np.zeros(count, np.float32)
    matches = Matches(rows[order].astype(np.int64), columns[order].astype(np.int64), zero, zero)
    return query, place, matches


def edges(query: np.ndarray, place: np.ndarray, matches: Matches) -> np.ndarray:
    """Which matches are consistent, by the definition."""
    a, b = query[matches.query], place[matches.map]
    lengths = [np.linalg.norm(p[:, None] - p, axis=2) for p in (a, b)]
    other = (matches.query[:, None] != matches.query) & (matches.map[:, None] != matches.map)
    consistent: np.ndarray = (np.abs(lengths[0] - lengths[1]) <= RESOLUTION) & other
    return consistent


def largest(consistent: np.ndarray) -> int:
    """Size of the largest set that is consistent pair by pair: every set is looked at."""

    def extended(size: int, left: np.ndarray) -> int:
        return max([size, *(extended(size + 1, left[k + 1 :][row[left[k + 1 :]]])
                            for k, row in enumerate(consistent[left]))])  # fmt: skip

    return extended(0, np.arange(len(consistent)))


def sets(query: np.ndarray, place: np.ndarray, matches: Matches) -> list[np.ndarray]:
    objects = np.arange(len(query), dtype=np.int64)
    pairs = (query, place, matches.query, matches.map, objects)
    _, members, offsets = _native.consistent_sets(*pairs, RESOLUTION, 3, 100)
    return np.split(members, offsets[1:-1])


@pytest.mark.parametrize("seed", range(6))
def test_the_largest_set_is_found(seed: int) -> None:
    scene = planted(seed)
    consistent = edges(*scene)
    found = sets(*scene)
    assert len(found[0]) == largest(consistent) >= 6
    assert [len(each) for each in found] == sorted(map(len, found), reverse=True)
    for each in found:
        assert all(consistent[i, j] for i, j in combinations(each, 2))
        joins = consistent[:, each].all(axis=1)
        assert not joins.any(), "a set to which a match could still be added"


def test_the_pose_is_that_of_the_set() -> None:
    tilt = Rotation.from_euler("zyx", [2.0, 0.3, -0.4]).as_matrix()
    T = geometry.rigid(tilt, np.array([5e6, -4e5, 30.0]))
    query, place, matches = planted(3, true=12, wrong=108)
    noise = np.random.default_rng(0).normal(0, 0.05, (12, 3))
    place[:12] = geometry.transform(T, query[:12]) + noise
    place[12:] += T[:3, 3]
    config = PoseConfig(estimator="geometric_consistency")
    first = PoseEstimator(config).estimate(query, place, matches)[0]
    gap = geometry.transform(first.T_map_local, query) - geometry.transform(T, query)
    assert first.inliers == 12 and np.linalg.norm(gap, axis=1).max() < 0.3


def test_places_are_apart_and_too_few_make_none() -> None:
    query, place, matches = planted(2)
    config = PoseConfig(estimator="geometric_consistency", consistency={"min_cluster": 3})
    found = PoseEstimator(config).estimate(query, place, matches)
    assert all(
        config.separation.apart(a.T_map_local, b.T_map_local) for a, b in combinations(found, 2)
    )
    strict = PoseConfig(estimator="geometric_consistency", consistency={"min_cluster": 61})
    assert not PoseEstimator(strict).estimate(query, place, matches)
