"""The confidence of a pose and the verdict on it, by made-up evidence."""

from __future__ import annotations

import json
from dataclasses import replace
from itertools import product
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from segloc import geometry
from segloc.errors import WeightsError
from segloc.geometry import Separation
from segloc.likelihood import Evidence, VerificationConfig, shipped_confidence
from segloc.likelihood.candidates import CandidateScores
from segloc.likelihood.confidence import load_confidence
from segloc.likelihood.decision import decide, demand
from segloc.likelihood.evidence import RankedCandidate, RefinedScore
from segloc.localization import Reason
from segloc.types import Candidate

MODEL = shipped_confidence()


def measured(
    flush: float | None = None, ground: float | None = None, intruding: float = 0.0
) -> Any:
    return SimpleNamespace(ground=ground, flush=flush, intruding=intruding)


def score(inliers: int, overlap: float, seen: float | None) -> RefinedScore:
    judged = 0 if seen is None else 2000
    confirmed = round(judged * (seen or 0.0))
    return RefinedScore(
        np.eye(4), inliers, overlap, confirmed, judged, 0.1, covariance=None, details=measured()
    )


def evidence(
    inliers: int,
    overlap: float,
    seen: float | None,
    ratio: float,
    rival: tuple[float, float | None] | None = None,
) -> Evidence:
    rivals = () if rival is None else (score(3, *rival),)
    return Evidence(score(inliers, overlap, seen), ratio, rivals)


def test_confidence_rises_with_every_feature() -> None:
    good = MODEL.probability(evidence(4, 0.6, 0.75, 1.3, (0.5, 0.6)))
    assert 0.5 < good < 0.99
    for worse in (
        evidence(4, 0.4, 0.75, 1.3, (0.5, 0.6)),
        evidence(4, 0.6, 0.5, 1.3, (0.5, 0.6)),
        evidence(4, 0.6, 0.75, 1.1, (0.5, 0.6)),
        evidence(4, 0.6, 0.75, 1.3, (0.6, 0.6)),
        evidence(4, 0.6, 0.75, 1.3, (0.5, 0.75)),
    ):
        assert MODEL.probability(worse) < good
    assert MODEL.probability(evidence(5, 0.4, 0.6, 1.2, (0.4, 0.6))) < 0.3
    # However many segments agree, clouds that agree no better than elsewhere outweigh them.
    many = MODEL.probability(evidence(500, 0.4, 0.6, 100.0, (0.4, 0.6)))
    assert many < VerificationConfig().min_confidence


def test_the_verdict_is_a_function_of_the_evidence() -> None:
    config = VerificationConfig()
    sure = evidence(15, 0.85, 0.95, 3.0, (0.3, 0.5))
    verdict = decide(sure, None, MODEL, config)
    assert verdict.reason is None and verdict.message == "" and not verdict.undecided
    assert verdict.confidence == MODEL.probability(sure) and verdict.best is sure.score
    verdict = decide(evidence(15, 0.85, 0.95, 3.0, (0.84, 0.95)), None, MODEL, config)
    assert verdict.reason is Reason.AMBIGUOUS and not verdict.undecided
    verdict = decide(evidence(4, 0.4, 0.6, 1.2), None, MODEL, config)
    assert verdict.reason is Reason.TOO_UNCERTAIN and verdict.undecided


def test_what_was_refined_for_one_candidate_is_a_rival_of_the_next() -> None:
    """Two that set out 1 m apart end on two storeys that look the same."""
    lower, upper = (geometry.yaw_transform(0.0, (0.0, 0.0, z)) for z in (0.0, 1.0))
    ends = {lower.tobytes(): 0.0, upper.tobytes(): 3.0}

    def refined(candidate: Candidate, *_: object) -> RefinedScore:
        T = geometry.yaw_transform(0.0, (0.0, 0.0, ends[candidate.T_map_local.tobytes()]))
        return RefinedScore(T, 0, 0.98, 240, 246, 0.1, None, measured())

    def ranked(candidates: list[Candidate], _: object) -> list[RankedCandidate]:
        return [RankedCandidate(c, 0.9, 0.1) for c in candidates]

    cloud: Any = SimpleNamespace(
        ranked=ranked, refined=refined, off_path=lambda _: 0.0, storeyed=False
    )
    config, candidates = VerificationConfig(), [Candidate(T, 0, 0.5) for T in (lower, upper)]
    query: Any = SimpleNamespace(extent=40)
    scores = CandidateScores(candidates, cloud, query, config, Separation(), lambda _: 0)
    assert scores.elsewhere(lower) == []  # so neither is a rival of the other by where it starts
    first = scores.refined(0)
    assert scores.evidence(first, [], 3).rivals == ()
    second = scores.refined(1)
    found = scores.evidence(second, [first], 3)
    assert found.rivals == (first,) == scores.evidence(second, [], 3).rivals
    verdict = decide(found, None, MODEL, config)
    assert verdict.reason is Reason.AMBIGUOUS


def test_a_view_as_small_as_a_room_is_not_believed_unless_segments_decide() -> None:
    """Rooms are like other rooms, whatever the clouds say."""
    config = VerificationConfig()
    alike = replace(evidence(4, 0.9, 0.95, 4.0, (0.8, 0.9)), extent=40)
    assert decide(alike, None, MODEL, config).reason is None
    verdict = decide(replace(alike, extent=12), None, MODEL, config)
    assert verdict.reason is Reason.TOO_UNCERTAIN and "12 squares" in verdict.message
    needed = demand(replace(alike, extent=12), MODEL).confidence(config)
    assert "(0.99954 < 0.99996)" in verdict.message and needed > MODEL.probability(alike)
    assert verdict.confidence == MODEL.probability(alike)
    # Where nothing at all fits elsewhere, a narrow view of a near wall is enough.
    unlike = replace(evidence(4, 1.0, 1.0, 4.0, (0.3, 0.3)), extent=12)
    assert decide(unlike, None, MODEL, config).reason is None
    assert decide(unlike, None, MODEL, config).confidence < needed
    all_of_it = config.model_copy(update={"min_confidence": 1.0})  # no confidence is as high
    assert decide(unlike, None, MODEL, all_of_it).reason is Reason.TOO_UNCERTAIN
    told = replace(evidence(9, 1.0, 1.0, 3.0, (0.3, 0.3)), extent=12)
    assert decide(told, None, MODEL, config).reason is None
    # Whoever asks for no confidence is given any pose.
    anything = config.model_copy(update={"min_confidence": 0.0})
    assert decide(replace(alike, extent=12), None, MODEL, anything).reason is None


def test_a_pose_is_doubted_that_puts_things_where_the_map_is_free() -> None:
    """Unless segments decide, or it is nearly certain: then things were moved."""
    config = VerificationConfig()

    def found(intruding: float, inliers: int, ratio: float, overlap: float = 0.9) -> Evidence:
        details = measured(0.5, ground=0.8, intruding=intruding)
        best = replace(score(inliers, overlap, 0.95), details=details)
        rival = replace(score(0, 0.65, 0.8), details=measured(0.4, ground=0.8))
        return Evidence(best, ratio, (rival,), extent=80)

    for inliers, ratio in ((3, 0.9), (9, 1.4)):
        free = found(0.01, inliers, ratio)
        assert decide(free, None, MODEL, config).reason is None
        verdict = decide(found(0.03, inliers, ratio), None, MODEL, config)
        assert verdict.reason is Reason.TOO_UNCERTAIN
        assert verdict.message.endswith(
            "; 3.0% of what is seen stands where the map is known to be free"
        )
    assert decide(found(0.1, 20, 3.0), None, MODEL, config).reason is None
    assert decide(found(0.1, 9, 1.4, 0.97), None, MODEL, config).reason is None


def test_no_score_makes_an_impossible_confidence() -> None:
    for inliers, overlap, seen, ratio in product(
        (0, 3, 10**6), (0.0, 1.0), (None, 0.0, 1.0), (0.0, 1e9)
    ):
        for rival in (None, (0.0, None), (1.0, 1.0)):
            assert 0 <= MODEL.probability(evidence(inliers, overlap, seen, ratio, rival)) <= 1


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("{", "damaged"),
        ("{}", "Field required"),
        (json.dumps({**MODEL.model_dump(mode="json"), "weights": {"seen": 1.0}}), "weights must"),
        (json.dumps({**MODEL.model_dump(mode="json"), "format": 1}), "format"),
    ],
)
def test_a_damaged_model_is_refused(tmp_path: Path, text: str, said: str) -> None:
    path = tmp_path / "confidence.json"
    path.write_text(text)
    with pytest.raises(WeightsError, match=said):
        load_confidence(path)
