"""The score of a pose, and the posterior of several."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import pytest

from segloc.errors import WeightsError
from segloc.likelihood import (
    Count,
    Evidence,
    Observation,
    Posterior,
    ScoredPose,
    Walls,
    shipped_model,
)
from segloc.likelihood.model import (
    aligned_measures,
    features_of,
    known_odds,
    load_model,
    walls_over,
)
from segloc.localization import Reason

MODEL = shipped_model()
MIN = 0.95


def observed(
    on_map: float,
    seen: float,
    *,
    known: float = 0.9,
    inliers: int = 8,
    on_surface: float = 0.8,
    ground: float = 0.95,
    inside: float = 0.005,
    walls: float = 0.8,
    planes: float = 0.4,
) -> Observation:
    n = round(2000 * known)
    on = round(n * on_map)
    return Observation(
        T_map_local=np.eye(4),
        overlap=on_map,
        seen=Count(round(2000 * seen), 2000),
        rmse=0.1,
        covariance=None,
        known=Evidence(on, n - on, 2000),
        inside=Count(round(600 * inside), 600),
        on_surface=Count(round(900 * on_surface), 900),
        ground=Count(round(900 * ground), 900),
        walls=Walls(np.full(40, walls, np.float32), np.ones(40, np.float32)),
        planes=Count(round(800 * planes), 800),
        inliers=inliers,
    )


def log_ratio(fit: Observation, others: list[Observation], inliers: int = 3) -> float:
    walls = [walls_over(fit.walls), *(walls_over(fit.walls, other.walls) for other in others)]
    overlap, *rivals = (aligned_measures(each) for each in (fit, *others))
    return MODEL.log_ratio(features_of(fit, overlap[0], rivals, inliers, min(walls)))


def test_the_score_rises_with_all_that_speaks_for_a_pose() -> None:
    rival = [observed(0.5, 0.6, inliers=3, walls=0.4)]
    good = log_ratio(observed(0.85, 0.95), rival)
    for worse in (
        log_ratio(observed(0.7, 0.95), rival),
        log_ratio(observed(0.85, 0.8), rival),
        log_ratio(observed(0.85, 0.95, inliers=5), rival),
        log_ratio(observed(0.85, 0.95, on_surface=0.5), rival),
        log_ratio(observed(0.85, 0.95, ground=0.5), rival),
        log_ratio(observed(0.85, 0.95, walls=0.6), rival),
        log_ratio(observed(0.85, 0.95, planes=0.9), rival),
        log_ratio(observed(0.85, 0.95), rival, inliers=7),
        log_ratio(observed(0.85, 0.95), [observed(0.85, 0.6, inliers=3, walls=0.4)]),
        log_ratio(observed(0.85, 0.95), [observed(0.5, 0.95, inliers=3, walls=0.4)]),
        log_ratio(observed(0.85, 0.95), [observed(0.5, 0.6, inliers=3, walls=0.7)]),
    ):
        assert worse < good
    few, many = (log_ratio(observed(0.85, 0.6, inside=share), rival) for share in (0.01, 0.1))
    assert many < few


def test_what_fits_counts_less_the_more_of_a_view_lies_on_two_planes() -> None:
    rival = [observed(0.5, 0.6, inliers=3, walls=0.4)]
    gains = [
        log_ratio(observed(0.85, 0.95, planes=share), rival)
        - log_ratio(observed(0.7, 0.8, planes=share, walls=0.6), rival)
        for share in (0.2, 0.6, 0.97)
    ]
    assert gains[0] > 1.05 * gains[1] > 1.1 * gains[2] > 0.0


def test_no_observation_makes_an_impossible_score() -> None:
    for overlap, seen, inliers, most in product((0.0, 1.0), (0.0, 1.0), (0, 10**6), (0, 10**6)):
        for others in ([], [observed(0.0, 0.0)], [observed(1.0, 1.0)]):
            fit = observed(overlap, seen, inliers=inliers)
            assert math.isfinite(log_ratio(fit, others, most))
    none = Count(0, 0)
    blind = replace(
        observed(0.0, 0.0),
        known=Evidence(0, 0, 0),
        seen=none,
        inside=none,
        on_surface=none,
        ground=none,
    )
    blind.walls = Walls(*(part[:0] for part in blind.walls))
    assert log_ratio(blind, []) < 0.0


def test_what_the_map_does_not_know_is_no_evidence() -> None:
    """Points in unknown space change nothing; a pose without known points fits as chance does."""
    half = observed(0.9, 0.9, known=0.5)
    assert known_odds(half.known) > 0.6 * known_odds(observed(0.9, 0.9).known)
    unknown, bad = observed(0.0, 0.9, known=0.0), observed(0.0, 0.9)
    assert known_odds(bad.known) < known_odds(unknown.known)
    assert known_odds(unknown.known) == pytest.approx(math.log(1 / 3))


def test_walls_are_compared_where_both_poses_know_them() -> None:
    here = Walls(np.float32([1, 1, 1, 0.9, 0]), np.float32([1, 1, 1, 1, 0]))
    there = Walls(np.float32([1, 0, 0, 0.8, 1]), np.float32([1, 1, 0, 1, 1]))
    assert walls_over(here, there) == -walls_over(there, here) == math.log(12 / 10)
    assert walls_over(here, here) == walls_over(Walls(here.explained, 0 * here.weight)) == 0.0
    faint = Walls(here.explained, 0.5 * here.weight)
    assert 0.0 < walls_over(faint, there) < walls_over(here, there)


def places(*log_ratios: float) -> Posterior:
    return Posterior.of([ScoredPose(np.eye(4), value, 8, 0.8) for value in log_ratios])


def test_probabilities_are_the_softmax_of_places_and_none() -> None:
    found = places(-1.0, 2.0, 0.5)
    shares = np.exp([2.0, 0.5, -1.0, 0.0])
    assert np.allclose((*found.probabilities, found.not_in_map), shares / shares.sum())
    assert [place.log_ratio for place in found.places] == [2.0, 0.5, -1.0]
    assert found.confidence == found.probabilities[0]
    assert places(800.0, -800.0).confidence == 1.0
    lapsing = Posterior.of(found.places, 0.01)
    assert np.allclose(lapsing.probabilities, 0.99 * np.array(found.probabilities))
    assert sum(lapsing.probabilities) + lapsing.not_in_map == pytest.approx(1.0)
    beside = Posterior.of(found.places, 0.0, [2.0])
    assert beside.confidence == pytest.approx(shares[0] / (shares.sum() + shares[0]))
    assert sum(beside.probabilities) + beside.not_in_map == pytest.approx(1.0)
    empty = Posterior.of([])
    assert empty == Posterior() and empty.confidence == 0.0 and empty.not_in_map == 1.0


@pytest.mark.parametrize(
    ("found", "reason"),
    [
        (places(9.0, 1.0), None),
        (places(9.0, 8.5), Reason.AMBIGUOUS),
        (places(1.0, -3.0), Reason.TOO_UNCERTAIN),
        (places(-6.0, -7.0), Reason.NOT_IN_MAP),
        (places(), Reason.NO_CONSISTENT_MATCHES),
    ],
)
def test_one_threshold_says_what_is_believed(found: Posterior, reason: Reason | None) -> None:
    assert found.reason(MIN) is reason
    assert found.reason(0.0) is (None if found.places else reason)
    message = found.message(MIN)
    assert message.startswith("" if reason is None else reason.value)
    assert bool(message) == (reason is not None) and "\n" not in message


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("{", "damaged"),
        ("{}", "Field required"),
        (json.dumps({**MODEL.model_dump(mode="json"), "weights": {"seen": 1.0}}), "weights must"),
        (json.dumps({**MODEL.model_dump(mode="json"), "format": 1}), "format"),
    ],
)
def test_a_damaged_model_is_refused(tmp_path: Path, text: str, expected: str) -> None:
    path = tmp_path / "posterior.json"
    path.write_text(text)
    with pytest.raises(WeightsError, match=expected):
        load_model(path)
