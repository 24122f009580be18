"""Nearest map points against a k-d tree, and what is believed of a query."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from samples.plaza import Plaza, PlazaSequence
from scipy.ndimage import minimum_filter
from scipy.spatial import cKDTree

from segloc import Config, Localizer, Scan, build_map, geometry
from segloc._native import PointIndex, VisibilityCheck
from segloc.frontend.segmentation import Segmentation
from segloc.likelihood import Aligned, Count, Posterior, QueryCloud, VerificationConfig
from segloc.likelihood.registration import Aligner, Alignment
from segloc.localization import Reason
from segloc.map.compact import CompactConfig
from segloc.map.config import MappingConfig
from segloc.proposals.matching import MatchingConfig
from segloc.proposals.occupancy import OccupancyConfig
from segloc.types import Candidate, Float32, Float64, Int64, Pose, Segments


def within_reach(points: Float64, cloud: Float32) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Whether each point is as low as the cloud around it, and whether there is no cloud."""
    cells, own = np.floor(points[:, None, :2] / 4), np.floor(cloud[:, :2] / 4)
    around = (np.abs(cells - own) <= 1).all(axis=2)
    low = np.where(around, cloud[:, 2], np.inf).min(axis=1)
    high = np.where(around, cloud[:, 2], -np.inf).max(axis=1)
    return points[:, 2] <= np.maximum(high, low + 3) + 0.5, ~around.any(axis=1)


@settings(max_examples=25)
@given(st.integers(0, 2**32 - 1), st.integers(1, 500), st.floats(0.05, 1.0), st.floats(0.1, 1.0))
def test_overlap_is_what_a_tree_finds(seed: int, count: int, radius: float, share: float) -> None:
    rng = np.random.default_rng(seed)
    cloud = rng.uniform(-4, 4, (count, 3)).astype(np.float32)
    query = rng.uniform([-9, -9, -5], [9, 9, 9], (200, 3)).astype(np.float32)
    T = geometry.yaw_transform(rng.uniform(-3, 3), tuple(rng.uniform(-2, 2, 3)))
    requested = radius * share
    distance = cKDTree(cloud).query(geometry.transform(T, query))[0]
    if np.abs(distance - requested).min() < 1e-5:  # decided by rounding
        return
    moved = geometry.transform(T, query)
    low, unmapped = within_reach(moved, cloud)
    near = (distance < requested) & low & ~unmapped
    results = (low | unmapped).sum()
    index = PointIndex(cloud, radius)
    for counts in (0.0, 0.25):
        overlap, rmse = index.overlap_rmse(query, T, requested, counts)
        assert index.overlap(query, T[None], requested, counts)[0] == overlap
        assert overlap == (near.sum() + counts * unmapped.sum()) / max(results, 1)
    if near.any():
        assert abs(rmse - np.sqrt((distance[near] ** 2).mean())) < 1e-4


@settings(max_examples=30)
@given(st.integers(0, 2**32 - 1), st.integers(0, 300), st.floats(0.1, 80.0))
def test_points_within_a_circle_between_heights(seed: int, count: int, radius: float) -> None:
    rng = np.random.default_rng(seed)
    cloud = rng.uniform(-60, 60, (count, 3)).astype(np.float32)
    cloud[:, 2] = np.round(cloud[:, 2])
    x, y = rng.uniform(-70, 70, 2)
    low, high = np.sort(rng.integers(-70, 70, 2)).astype(float)
    circle = np.hypot(cloud[:, 0] - x, cloud[:, 1] - y) <= radius
    index = PointIndex(cloud, 0.5)
    every = index.sample(x, y, radius, count + 1)
    assert sorted(map(tuple, every)) == sorted(map(tuple, cloud[circle]))
    expected = np.flatnonzero(circle & (low <= cloud[:, 2]) & (cloud[:, 2] <= high))
    every = index.sample(x, y, radius, count + 1, low, high)
    assert sorted(map(tuple, every)) == sorted(map(tuple, cloud[expected]))
    some = index.sample(x, y, radius, 50, low, high)
    assert len(some) <= 50 and (len(some) > 24 or len(some) == len(expected))
    assert {tuple(p) for p in some} <= {tuple(p) for p in cloud[expected]}


def reference_visibility(
    structure: Float32,
    ground: Float32,
    prior_map: Float32,
    T: Pose,
    reach: float,
    bin_deg: float,
) -> tuple[int, int]:
    """What ``VisibilityCheck.count`` counts, with 0.4 m to be near and 0.7 m to be behind."""
    shape = round(360 / bin_deg), round(180 / bin_deg) + 1

    def pixels(points: Float32) -> tuple[tuple[Int64, Int64], Float64]:
        x, y, z = points.T.astype(np.float64)
        azimuth = np.degrees(np.arctan2(y, x)) + 180
        elevation = np.degrees(np.arctan2(z, np.hypot(x, y))) + 90
        columns = (azimuth / bin_deg).astype(int) % shape[0]
        return (columns, (elevation / bin_deg).astype(int)), np.sqrt(x * x + y * y + z * z)

    image = np.full(shape, np.inf)
    at, ranges = pixels(np.concatenate([structure, ground]))
    np.minimum.at(image, at, ranges)
    nearest = minimum_filter(image, 3, mode=("wrap", "nearest"))

    moved = geometry.transform(T, prior_map).astype(np.float32)
    moved = moved[(moved.astype(np.float64) ** 2).sum(axis=1) < reach**2]
    cells = np.floor(ground[:, :2] / 3)
    about = (np.abs(np.floor(moved[:, None, :2] / 3) - cells) <= 1).all(axis=2)
    floor = np.where(about, ground[:, 2], -np.inf).max(axis=1, initial=-np.inf)
    results = moved[(floor > -np.inf) & (moved[:, 2] > floor + 0.5)]
    seen = cKDTree(structure).query(results)[0] <= 0.4
    at, ranges = pixels(results)
    behind = nearest[at] > ranges + np.maximum(0.7, 0.05 * ranges)
    return int(seen.sum()), int((~seen & np.isfinite(image[at]) & behind).sum())


@settings(max_examples=15)
@given(st.integers(0, 2**32 - 1), st.integers(1, 300), st.floats(1.0, 8.0), st.floats(5.0, 30.0))
def test_what_of_a_map_is_seen_and_what_violates_free_space(
    seed: int, count: int, bin_deg: float, reach: float
) -> None:
    rng = np.random.default_rng(seed)
    structure = rng.uniform([-25, -25, 0], [25, 25, 4], (count, 3)).astype(np.float32)
    ground = rng.uniform([-25, -25, -2], [25, 25, -1.5], (40, 3)).astype(np.float32)
    T = geometry.yaw_transform(rng.uniform(-3, 3), tuple(rng.uniform(-2, 2, 3)))
    mapped = structure + rng.normal(0, 0.3, structure.shape)
    others = rng.uniform([-25, -25, -2], [25, 25, 4], (200, 3))
    prior_map = geometry.transform(geometry.inverse(T), np.concatenate([mapped, others]))
    prior_map = prior_map.astype(np.float32)
    counts = VisibilityCheck(structure, ground, reach, bin_deg, 0.5).count(prior_map, T, 0.4, 0.7)
    expected = reference_visibility(structure, ground, prior_map, T, reach, bin_deg)
    assert np.abs(np.subtract(counts, expected)).max() <= 1  # one may be decided by rounding


def test_a_place_is_believed_from_the_probability_that_is_asked_for(plaza: Plaza) -> None:
    config = Config.preset("geo")
    prior_map = build_map(PlazaSequence(plaza, steps=6), config)
    scan = plaza.scan(geometry.yaw_transform(0.3, (-8.0, 1.0, 1.7)))
    found = Localizer(prior_map, config).localize(scan)
    assert found.localized and found.confidence == found.places[0].probability
    assert sum(place.probability for place in found.places) + found.not_in_map == pytest.approx(1)
    all_of_it = VerificationConfig(min_confidence=1.0)
    changed = config.model_copy(update={"verification": all_of_it})
    refused = Localizer(prior_map, changed).localize(scan)
    assert not refused.localized and refused.reason is Reason.TOO_UNCERTAIN
    assert refused.T_map_sensor is None and refused.confidence < 1.0


def test_queries_of_few_segments_are_found_by_more_neighbours(plaza: Plaza) -> None:
    every_view = MappingConfig(compact=CompactConfig(enabled=False))
    config = Config.preset("geo").model_copy(update={"mapping": every_view})
    prior_map = build_map(PlazaSequence(plaza, steps=6), config)
    scan = plaza.scan(geometry.yaw_transform(0.3, (-8.0, 1.0, 1.7)))
    rng = np.random.default_rng(0)
    # The nearest is hardly ever right:
    prior_map.vectors[:] += rng.normal(0, 2.5, prior_map.vectors.shape)
    answers = []
    for escalation in (1, 80):
        matching = MatchingConfig(neighbours=1, escalation=escalation, matches=10**6)
        clouds = OccupancyConfig(enabled=False)
        config = Config.preset("geo").model_copy(update={"matching": matching, "occupancy": clouds})
        answers.append(Localizer(prior_map, config).localize(scan))
    lost, found = answers
    assert not lost.localized and lost.confidence < 0.5
    assert found.localized
    assert found.counts["proposed"] == min(80, len(prior_map)) * found.counts["segments"]


def test_fits_that_converge_to_one_pose_are_one_place(
    plaza: Plaza, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = Config.preset("geo")
    localizer = Localizer(build_map(PlazaSequence(plaza, steps=6), config), config)
    truth = geometry.yaw_transform(0.3, (-8.0, 1.0, 1.7))
    query = localizer.describe(plaza.scan(truth))
    T_map_local = truth @ geometry.inverse(query.cloud.T_local_sensor)
    starts = []
    for side in (-1.0, 1.0):
        start = T_map_local.copy()
        start[:2, 3] += side * 1.2, side * 1.2
        starts.append(Candidate(start, 0))
    likelihood = localizer.likelihood
    assert likelihood.separation.apart(*(start.T_map_local for start in starts))

    def unaligned(T: Pose, query: QueryCloud, _: Pose | None) -> Aligned:
        return Aligned(T, 0.5, Count(1, 2))

    # Only the last alignment brings them together:
    monkeypatch.setattr(likelihood.cloud, "aligned", unaligned)
    scorer = likelihood.scorer(likelihood.query(query.scene), lambda T: 0)
    scorer.add(starts)
    near = [
        place
        for place in scorer.measure(thorough=True).places
        if np.linalg.norm(place.T_map_local[:2, 3] - T_map_local[:2, 3]) < 1.0
    ]
    assert len(near) == 1


def test_a_pose_is_sure_beside_places_that_do_not_become_it(
    plaza: Plaza, localizer: Localizer, monkeypatch: pytest.MonkeyPatch
) -> None:
    truth, rng = geometry.yaw_transform(0.3, (-8.0, 1.0, 1.7)), np.random.default_rng(0)
    scan = plaza.scan(truth, seed=7)
    clutter = rng.uniform((-15, -15, -1.2), (15, 15, 2), (12_000, 3)).astype(np.float32)
    points = np.concatenate([scan.points, clutter])
    query = localizer.describe(Scan(points, T_odom_sensor=scan.T_odom_sensor))
    right = truth @ geometry.inverse(query.cloud.T_local_sensor)

    def moved(x: float, y: float, degrees: float = 0.0) -> Candidate:
        T = right @ geometry.yaw_transform(np.radians(degrees))
        T[:2, 3] += x, y
        return Candidate(T, 0)

    likelihood = localizer.likelihood
    monkeypatch.setattr(likelihood.cloud, "around", lambda *_: [])
    becoming = [moved(0, 0, 16), moved(0, 0, -16)]
    elsewhere = [moved(9, 0), moved(0, 9)]

    def measured(*others: Candidate) -> Posterior | None:
        scorer = likelihood.scorer(likelihood.query(query.scene))
        scorer.add([moved(0, 0), *others])
        return scorer.measure_at_once()

    assert measured(*becoming) is None  # beside nothing
    for others in (elsewhere, [*becoming, *elsewhere]):
        posterior = measured(*others)
        assert posterior is not None and posterior.confidence > 0.999
        assert np.linalg.norm(posterior.places[0].T_map_local[:2, 3] - right[:2, 3]) < 0.1


def test_a_corner_lies_on_two_planes(plaza: Plaza) -> None:
    prior_map = build_map(PlazaSequence(plaza, steps=2), Config.preset("geo"))
    likelihood, nothing = Localizer(prior_map).likelihood, np.empty((0, 3), np.float32)
    rng = np.random.default_rng(0)
    one = rng.uniform([3.0, 0.0, -1.0], [3.02, 8.0, 2.0], (4000, 3))
    walls = one, one[:, [1, 0, 2]]

    def share_on_two(*structure: Float64) -> float:
        points = np.concatenate(structure).astype(np.float32)
        scene = Segmentation(
            Segments(nothing, np.zeros(1, np.int64), np.empty((0, 3)), np.empty(0, np.float32)),
            points,
            nothing,
        )
        share = likelihood.query(scene).planes.share
        assert share is not None
        return share

    assert share_on_two(*walls) > 0.95 > 0.75 > share_on_two(*walls, rng.uniform(-8, 8, (8000, 3)))


def test_a_denser_alignment_is_another_pose_if_the_first_hardly_allows_it(
    plaza: Plaza, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = Config.preset("geo")
    localizer = Localizer(build_map(PlazaSequence(plaza, steps=6), config), config)
    query = localizer.describe(plaza.scan(geometry.yaw_transform(0.3, (-8.0, 1.0, 1.7))))
    cloud, seen = localizer.likelihood.cloud, localizer.likelihood.query(query.scene)
    fit = localizer.search(query).fits[0]
    sure, open_turn = np.radians([0.3, 0.3, 5.0]), np.full(3, 0.05)
    loose = replace(fit, covariance=np.diag(np.concatenate([sure, open_turn]) ** 2))
    align = Aligner.align

    def turned(about: int) -> Pose:
        step = np.zeros(6)
        step[about] = np.radians(4.0)

        def moved(self: Aligner, *clouds: Any, **options: Any) -> Alignment | None:
            found = align(self, *clouds, **options)
            assert found is not None
            return replace(found, T_target_source=geometry.displace(found.T_target_source, step))

        monkeypatch.setattr(Aligner, "align", moved)
        return cloud.finest(loose, seen).T_map_local

    roll, _, yaw = range(3)
    assert np.array_equal(turned(roll), fit.T_map_local)
    assert geometry.rotation_angle(geometry.inverse(fit.T_map_local) @ turned(yaw)) > 0.06
