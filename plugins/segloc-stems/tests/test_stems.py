"""Stems found in clouds of points: where they stand, how thick, and nothing else; poses by them."""

from __future__ import annotations

import math
from functools import cache

import numpy as np
import pytest
from samples import stems
from scipy.spatial import cKDTree
from segloc_lab.padding import mirrored
from segloc_stems import LandmarkLocalizer, LandmarkMap, Landmarks, Stems, find_stems
from segloc_stems.stems import Upright, fit_circles

from segloc import Config, Localizer, Scan, build_map
from segloc.localization import Reason
from segloc.types import Float64, Int64, Pose

HERE = stems.pose(40, 42, 1.0)


@cache
def stand() -> Landmarks:
    """Stems at least two metres apart."""
    dense = stems.stand(3, 300)
    crowded = {b for _, b in cKDTree(dense.positions[:, :2]).query_pairs(2.0)}
    rows = np.setdiff1d(np.arange(300), sorted(crowded))
    assert dense.diameters is not None
    lean = dense.directions[rows]
    return Landmarks(dense.positions[rows], lean, dense.diameters[rows])


def compared(found: Stems, T: Pose, radius_m: float) -> tuple[Float64, Float64, float, float]:
    """Errors of position and diameter; the shares of true stems found, and of found ones true."""
    columns, truth = found.transform(T), stand()
    assert truth.diameters is not None
    distance, which = cKDTree(truth.positions[:, :2]).query(columns[:, :2])
    right = distance < 0.3
    near = np.hypot(*(truth.positions[:, :2] - T[:2, 3]).T) < radius_m
    gap, _ = cKDTree(columns[:, :2]).query(truth.positions[near, :2])
    errors = columns[right, 6] - truth.diameters[which[right]]
    return distance[right], errors, float((gap < 0.3).mean()), float(right.mean())


@pytest.mark.parametrize("tilt_deg", [0.0, 8.0])
def test_stems_of_a_single_scan(tilt_deg: float) -> None:
    T = stems.pose(40, 42, 1.0, tilt=math.radians(tilt_deg))
    points = stems.visible(stems.cylinders(stand()), stand(), T)
    up = T[2, :3]
    found = find_stems(Scan(points, stamp=7.0, gravity=-9.81 * up))
    position, diameter, recall, precision = compared(found, T, 22.0)
    assert recall > 0.95 and precision > 0.95 and found.stamp == 7.0
    assert np.median(position) < 0.05 and np.abs(np.median(diameter)) < 0.05
    assert found.position_std is not None and (found.position_std < 0.1).all()
    leans = np.degrees(np.arccos(np.clip(found.directions @ up, -1, 1)))
    assert np.median(leans) < 5


def test_walls_bushes_and_bare_ground_are_no_stems() -> None:
    rng = np.random.default_rng(0)
    ground = np.column_stack([rng.uniform(-20, 20, (20_000, 2)), rng.normal(0, 0.01, 20_000)])
    along = rng.uniform(-10, 10, 20_000)
    wall = np.column_stack([along, np.full(20_000, 8.0), rng.uniform(0, 4, 20_000)])
    bush = rng.uniform(-1, 1, (6000, 3)) * [1.5, 1.5, 0.8] + [0, -8, 0.8]
    assert not len(find_stems(Scan(ground - [0, 0, 1.5])))
    assert len(find_stems(Scan(np.concatenate([ground, wall, bush]) - [0, 0, 1.5]))) <= 1
    assert not len(find_stems(Scan(np.empty((0, 3)))))


def circle_by_hand(points: Float64) -> tuple[Float64, float]:
    """Kasa's fit of (n, 2) points by least squares."""
    rows = np.column_stack([2 * points, np.ones(len(points))])
    solved = np.linalg.lstsq(rows, (points**2).sum(axis=1), rcond=None)[0]
    return solved[:2], float(np.sqrt(solved[2] + solved[:2] @ solved[:2]))


def test_circles_are_those_of_least_squares() -> None:
    rng = np.random.default_rng(4)
    counts: Int64 = np.array([200, 150, 300])
    centres, radii = rng.uniform(-20, 20, (3, 2)), np.array([0.4, 0.3, 0.5])
    which = np.repeat(np.arange(3), counts)
    turn, height = rng.uniform(-math.pi, math.pi, 650), np.tile([1.0, 2.0, 3.0], 217)[:650]
    ring = np.column_stack([np.cos(turn), np.sin(turn)]) * radii[which, None]
    level = centres[which] + ring + rng.normal(0, 0.005, (650, 2))
    found = fit_circles(Upright(np.column_stack([level, height]), height, counts), False)
    for k in range(3):
        centre, radius = circle_by_hand(level[which == k])
        middle = found.feet[k, :2] + 2.0 * found.slopes[k]  # two metres above ground
        assert np.allclose(middle, centre, atol=0.02)
        assert found.diameters[k] == pytest.approx(2 * radius, abs=0.02)


def equal() -> Landmarks:
    """The stand with upright trees of one size."""
    return Landmarks(stand().positions, diameters=np.full(len(stand()), 0.3))


def seen(trees: Landmarks, T: Pose, seed: int) -> Float64:
    return stems.visible(stems.cylinders(trees, seed), trees, T)


class Walk:
    """Scans along a line through a stand; a ``Sequence``."""

    name, stamps = "stand", None

    def __init__(self, trees: Landmarks) -> None:
        self._trees = trees
        self.poses = np.stack([stems.pose(x, 40.0, 0.0) for x in np.arange(15.0, 66.0, 5.0)])
        self.indices = np.arange(len(self.poses), dtype=np.int64)

    def __len__(self) -> int:
        return len(self.poses)

    def scan(self, i: int) -> Scan:
        return Scan(seen(self._trees, self.poses[i], i), T_odom_sensor=self.poses[i])

    def select(self, selection: object) -> Walk:
        raise NotImplementedError


def test_a_map_of_found_stems_is_localized_in() -> None:
    walk = Walk(stand())
    views = [(find_stems(walk.scan(i)), walk.poses[i]) for i in range(len(walk))]
    localizer = LandmarkLocalizer(LandmarkMap.build(views))
    T = stems.pose(38, 46, 2.5)
    answer = localizer.localize(find_stems(seen(stand(), T, 99)))
    assert answer.localized, answer.message
    assert np.linalg.norm(answer.T_map_sensor[:3, 3] - T[:3, 3]) < 0.3


@pytest.mark.slow
def test_stems_settle_what_segments_leave_open() -> None:
    """Equal trees are equal segments: with few neighbours nothing is found but by stems."""
    config = Config.preset("geo").model_copy(update={"threads": 1})
    config = config.model_copy(
        update={
            "occupancy": config.occupancy.model_copy(update={"enabled": False}),
            "matching": config.matching.model_copy(update={"neighbours": 1, "escalation": 1}),
        }
    )
    prior_map = build_map(Walk(equal()), config)
    T = stems.pose(38, 46, 2.5)
    query = Scan(seen(equal(), T, 99))
    assert not Localizer(prior_map, config).localize(query).localized
    by_stems = config.model_copy(update={"proposers": ("stems",)})
    answer = Localizer(prior_map, by_stems).localize(query)
    assert answer.localized and answer.proposer == "stems", answer.message
    assert np.linalg.norm(answer.T_map_sensor[:3, 3] - T[:3, 3]) < 0.3
    refused = Localizer(mirrored(prior_map), by_stems).localize(query)
    assert refused.reason in (Reason.TOO_UNCERTAIN, Reason.NOT_IN_MAP)
