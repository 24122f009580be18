"""The score of a pose, and the posterior of several."""

from __future__ import annotations

import json
import math
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from segloc.errors import WeightsError
from segloc.likelihood import Count, Observation, Posterior, ScoredPose, shipped_model
from segloc.likelihood.model import load_model
from segloc.localization import Reason

MODEL = shipped_model()
MIN = 0.95


def observed(
    overlap: float,
    seen: float,
    *,
    inliers: int = 8,
    flush: float = 0.8,
    ground: float = 0.95,
    intruding: float = 0.005,
) -> Observation:
    compared: Any = None
    fit = Observation(np.eye(4), overlap, Count(round(2000 * seen), 2000), 0.1, None, compared)
    fit.inliers = inliers
    fit.flush, fit.ground = Count(round(900 * flush), 900), Count(round(900 * ground), 900)
    fit.intruding = Count(round(1500 * intruding), 1500)
    return fit


def log_ratio(fit: Observation, others: list[Observation], inliers: int = 3) -> float:
    return MODEL.log_ratio(MODEL.features(fit, others, inliers))


def test_the_score_rises_with_all_that_speaks_for_a_pose() -> None:
    rival = [observed(0.5, 0.6, inliers=3, flush=0.4)]
    good = log_ratio(observed(0.85, 0.95), rival)
    for worse in (
        log_ratio(observed(0.7, 0.95), rival),
        log_ratio(observed(0.85, 0.8), rival),
        log_ratio(observed(0.85, 0.95, inliers=5), rival),
        log_ratio(observed(0.85, 0.95, flush=0.5), rival),
        log_ratio(observed(0.85, 0.95, ground=0.5), rival),
        log_ratio(observed(0.85, 0.95, intruding=0.1), rival),
        log_ratio(observed(0.85, 0.95), rival, inliers=7),
        log_ratio(observed(0.85, 0.95), [observed(0.85, 0.6, inliers=3, flush=0.4)]),
        log_ratio(observed(0.85, 0.95), [observed(0.5, 0.95, inliers=3, flush=0.4)]),
        log_ratio(observed(0.85, 0.95), [observed(0.5, 0.6, inliers=3, flush=0.7)]),
    ):
        assert worse < good


def test_no_observation_makes_an_impossible_score() -> None:
    for overlap, seen, inliers, most in product((0.0, 1.0), (0.0, 1.0), (0, 10**6), (0, 10**6)):
        for others in ([], [observed(0.0, 0.0)], [observed(1.0, 1.0)]):
            fit = observed(overlap, seen, inliers=inliers)
            assert math.isfinite(log_ratio(fit, others, most))
    nothing: Any = None
    blind = Observation(np.eye(4), 0.0, Count(0, 0), 0.0, None, nothing)
    blind.flush = blind.ground = blind.intruding = Count(0, 0)
    assert log_ratio(blind, []) < 0.0


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
    empty = Posterior.of([])
    assert empty == Posterior() and empty.confidence == 0.0 and empty.not_in_map == 1.0


@pytest.mark.parametrize(
    ("found", "reason"),
    [
        (places(9.0, 1.0), None),
        (places(9.0, 8.5), Reason.AMBIGUOUS),
        (places(1.0, -3.0), Reason.TOO_UNCERTAIN),
        (places(-6.0, -7.0), Reason.NOT_IN_MAP),
        (places(), Reason.NOT_IN_MAP),
    ],
)
def test_one_threshold_says_what_is_believed(found: Posterior, reason: Reason | None) -> None:
    assert found.reason(MIN) is reason
    assert found.reason(0.0) is None
    if found.places:
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
