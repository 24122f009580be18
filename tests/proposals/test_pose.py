"""Pose from matches: consensus, PROSAC and RANSAC against known poses and a reference."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from segloc import geometry
from segloc.proposals.pose import PoseConfig, PoseEstimator
from segloc.types import Candidate, Matches

ESTIMATORS = ["consensus", "prosac", "ransac", "geometric_consistency"]


def scene(
    seed: int,
    *,
    segments: int = 60,
    neighbours: int = 20,
    true: int = 12,
    T: np.ndarray | None = None,
    origin: float = 0.0,
) -> tuple[np.ndarray, np.ndarray, Matches, np.ndarray]:
    """Centroids, matches of which ``true`` are right, and the pose that those agree on."""
    rng = np.random.default_rng(seed)
    query = rng.uniform([-40, -40, 0], [40, 40, 5], (segments, 3))
    if T is None:
        T = geometry.yaw_transform(
            rng.uniform(-math.pi, math.pi), tuple(rng.uniform(-200, 200, 3) * [1, 1, 0.05] + origin)
        )
    count = segments * neighbours
    prior_map = rng.uniform([-300, -300, -10], [300, 300, 10], (count, 3)) + origin
    rows = np.repeat(np.arange(segments), neighbours)
    right = rng.choice(segments, true, replace=False) * neighbours
    prior_map[right] = geometry.transform(T, query[rows[right]]) + rng.normal(0, 0.1, (true, 3))
    score = rng.normal(0, 1, count)
    score[right] += 1.5
    order = np.argsort(-score)
    matches = Matches(
        rows[order].astype(np.int64),
        order.astype(np.int64),
        (-score[order]).astype(np.float32),
        score[order].astype(np.float32),
    )
    return query, prior_map, matches, T


def error(found: Candidate, T: np.ndarray, query: np.ndarray) -> float:
    """Largest displacement of any query centroid, metres."""
    gap = geometry.transform(found.T_map_local, query) - geometry.transform(T, query)
    return float(np.linalg.norm(gap, axis=1).max())


@pytest.mark.parametrize("estimator", ESTIMATORS)
@pytest.mark.parametrize("seed", range(2))
def test_the_true_pose_comes_first(estimator: str, seed: int) -> None:
    # Unordered samples of three need far more of the matches to be right.
    query, prior_map, matches, T = scene(seed, neighbours=4 if estimator == "ransac" else 20)
    found = PoseEstimator(PoseConfig(estimator=estimator)).estimate(query, prior_map, matches)
    assert error(found[0], T, query) < 0.5
    assert 10 <= found[0].inliers <= 14
    for hypothesis in found:
        R = hypothesis.T_map_local[:3, :3]
        np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-9)
        assert np.linalg.det(R) > 0


@pytest.mark.parametrize("estimator", ["consensus", "prosac", "geometric_consistency"])
def test_utm_coordinates_lose_no_precision(estimator: str) -> None:
    query, prior_map, matches, T = scene(3, origin=5e6)
    found = PoseEstimator(PoseConfig(estimator=estimator)).estimate(query, prior_map, matches)
    assert error(found[0], T, query) < 0.5


def reference_support(query: np.ndarray, prior_map: np.ndarray, matches: Matches) -> int:
    """Most distinct query segments that any two agreeing matches put on the map."""
    q, m, best = query[matches.query], prior_map[matches.map], 0
    for i in range(len(matches)):
        for j in range(i):
            a, b = (q[j] - q[i])[:2], (m[j] - m[i])[:2]
            la, lb = np.hypot(*a), np.hypot(*b)
            if la < 3 or abs(la - lb) > 0.5 or matches.query[i] == matches.query[j]:
                continue
            yaw = math.atan2(a[0] * b[1] - a[1] * b[0], a @ b)
            T = geometry.yaw_transform(yaw)
            T[:3, 3] = (m[i] + m[j] - geometry.transform(T, q[i : i + 1])[0] * 2) / 2 - (
                geometry.transform(T, (q[j] - q[i])[None])[0] / 2
            )
            near = np.linalg.norm((geometry.transform(T, q) - m)[:, :2], axis=1) < 0.6
            near &= np.abs(geometry.transform(T, q)[:, 2] - m[:, 2]) < 1.0
            best = max(best, len(np.unique(matches.query[near])))
    return best


@pytest.mark.parametrize("seed", range(2))
def test_consensus_finds_what_an_exhaustive_search_finds(seed: int) -> None:
    query, prior_map, matches, _ = scene(seed, segments=25, neighbours=6, true=5)
    found = PoseEstimator(PoseConfig(distinct_radius=0.0)).estimate(query, prior_map, matches)
    assert found[0].inliers >= reference_support(query, prior_map, matches)


def test_two_equal_places_are_both_reported() -> None:
    query, prior_map, matches, T = scene(1, true=10)
    twin = T.copy()
    twin[:2, 3] += [120.0, 0]
    first = len(prior_map)
    mine = matches.query[:60:6]
    prior_map = np.vstack([prior_map, geometry.transform(twin, query[np.unique(mine)])])
    extra = np.arange(first, len(prior_map))
    both = Matches(
        np.concatenate([np.unique(mine), matches.query]),
        np.concatenate([extra, matches.map]),
        np.concatenate([np.zeros(len(extra), np.float32), matches.distance]),
        np.concatenate([np.full(len(extra), 9, np.float32), matches.score]),
    )
    found = PoseEstimator().estimate(query, prior_map, both)
    assert min(error(h, T, query) for h in found[:2]) < 0.5
    assert min(error(h, twin, query) for h in found[:2]) < 0.5


def test_close_segments_are_one_object() -> None:
    query, prior_map, matches, T = scene(2, true=10)
    doubled = np.vstack([query, query + np.array([0.2, 0.1, 0.6])])
    again = Matches(
        np.concatenate([matches.query, matches.query + len(query)]),
        np.concatenate([matches.map, matches.map]),
        np.concatenate([matches.distance, matches.distance]),
        np.concatenate([matches.score, matches.score]),
    )
    once = PoseEstimator().estimate(query, prior_map, matches)[0]
    twice = PoseEstimator().estimate(doubled, prior_map, again)[0]
    assert twice.inliers == once.inliers and error(twice, T, query) < 0.5


@settings(max_examples=10)
@given(
    st.integers(0, 1000),
    st.floats(-math.pi, math.pi),
    st.tuples(st.floats(-500, 500), st.floats(-500, 500), st.floats(-5, 5)),
)
def test_a_turned_query_gives_the_turned_pose(
    seed: int, yaw: float, t: tuple[float, float, float]
) -> None:
    query, prior_map, matches, T = scene(seed % 5)
    T_new_old = geometry.yaw_transform(yaw, t)
    moved = geometry.transform(T_new_old, query)
    found = PoseEstimator().estimate(moved, prior_map, matches)
    assert error(found[0], T @ geometry.inverse(T_new_old), moved) < 0.5


@pytest.mark.parametrize("estimator", ESTIMATORS)
def test_same_input_same_bits_for_any_number_of_threads(estimator: str) -> None:
    query, prior_map, matches, _ = scene(4)
    runs = [
        PoseEstimator(PoseConfig(estimator=estimator), threads=n).estimate(
            query, prior_map, matches
        )
        for n in (1, 2, 8, 1)
    ]
    for run in runs[1:]:
        assert [h.inliers for h in run] == [h.inliers for h in runs[0]]
        for a, b in zip(run, runs[0], strict=True):
            np.testing.assert_array_equal(a.T_map_local, b.T_map_local)


@pytest.mark.parametrize("estimator", ESTIMATORS)
def test_degenerate_matches_give_no_pose_or_a_rigid_one(estimator: str) -> None:
    find = PoseEstimator(PoseConfig(estimator=estimator)).estimate
    nothing = Matches(*(np.empty(0, t) for t in (np.int64, np.int64, np.float32, np.float32)))
    assert find(np.empty((0, 3)), np.empty((0, 3)), nothing) == []
    count = np.arange(30, dtype=np.int64)
    zero = np.zeros(30, np.float32)
    same = Matches(count, count, zero, zero)
    line = np.linspace([0, 0, 0], [60.0, 0, 0], 30)
    for points in (np.zeros((30, 3)), line, np.full((30, 3), 1e6)):
        for hypothesis in find(points, points, same):
            assert np.isfinite(hypothesis.T_map_local).all()
            assert abs(np.linalg.det(hypothesis.T_map_local[:3, :3]) - 1) < 1e-9


@pytest.mark.parametrize("spread_m", [0.0, 30.0, 3000.0])
def test_agreement_counts_the_objects_that_fit_anywhere(spread_m: float) -> None:
    """Far matches are skipped, and never one that fits: as by measuring all of them."""
    rng = np.random.default_rng(3)
    query = rng.uniform(-40, 40, (80, 3))
    T = geometry.yaw_transform(1.0, (spread_m / 2, -5.0, 1.0))
    place = rng.uniform(-1, 1, (2000, 3)) * [spread_m, 50, 2]
    place[:80] = geometry.transform(T, query) + rng.normal(0, 0.3, (80, 3))
    rows, columns = np.arange(4000) % 80, rng.integers(0, 2000, 4000)
    columns[:80] = np.arange(80)
    none = np.zeros(4000, np.float32)
    config = PoseConfig()
    agreement = PoseEstimator(config).agreement(query, place, Matches(rows, columns, none, none))
    near = np.linalg.norm(query[:, None, :2] - query[:, :2], axis=2) < config.distinct_radius
    objects = np.arange(80)
    for k in range(80):
        objects[k] = objects[near[k].argmax()] if near[k].argmax() < k else k
    for x in (0.0, 0.4, 20.0, 1e4):
        moved = T.copy()
        moved[0, 3] += x
        off = place[columns] - geometry.transform(moved, query[rows])
        fits = np.hypot(off[:, 0], off[:, 1]) < config.inlier_tolerance
        fits &= np.abs(off[:, 2]) < config.height_tolerance
        assert agreement(moved) == len(np.unique(objects[rows[fits]]))
