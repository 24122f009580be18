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
from segloc.likelihood.decision import CAUTIOUSLY, CONFINED_ROOT, Demand, decide, demand
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


def test_a_rival_whose_walls_are_less_flush_is_no_equal() -> None:
    config = VerificationConfig()

    def refined(flush: float, x: float) -> RefinedScore:
        T = geometry.yaw_transform(0.0, (x, 0.0, 0.0))
        return RefinedScore(T, 4, 0.97, 950, 1000, 0.1, None, measured(flush))

    def reason(rival: float) -> Reason | None:
        found = Evidence(refined(0.85, 0.0), 1.0, (refined(rival, 20.0),))
        return decide(found, None, MODEL, config).reason

    assert reason(0.85) is reason(0.8) is Reason.AMBIGUOUS
    assert reason(0.4) is not Reason.AMBIGUOUS
    less = [Evidence(refined(0.85, 0.0), 1.0, (refined(r, 20.0),)) for r in (0.8, 0.6, 0.4)]
    rising = [MODEL.probability(each) for each in less]
    assert rising == sorted(rising)


def test_more_confidence_is_needed_where_there_is_less_to_go_by() -> None:
    config = VerificationConfig()

    def needed(inliers: int, ratio: float, judged: int = 2000, flush: float = 0.5) -> float:
        found = evidence(inliers, 0.9, 0.95, ratio)
        best = replace(found.score, confirmed=round(0.95 * judged), judged=judged)
        best = replace(best, details=measured(flush))
        return demand(replace(found, score=best, extent=40), MODEL).confidence(config)

    many, few = needed(20, 3.0), needed(4, 3.0)
    assert many == config.min_confidence < few < 1
    assert needed(9, 1.1) == few == needed(4, 3.0, 200)  # as many elsewhere
    # Segments of another part of a place that repeats itself agree as well.
    repeated = needed(9, 2.0)
    assert few < repeated < 1 and needed(19, 1.5) == repeated == needed(9, 2.0, 200, flush=0.7)
    assert needed(9, 2.0, 200) == needed(12, 3.0) == many  # little in view, and no walls


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


def test_a_pose_is_doubted_that_is_likely_only_because_others_are_worse() -> None:
    """So is the best bay of a hall for a query of another hall."""
    config = VerificationConfig()

    def found(judged: int, overlap: float, seen: float = 0.99) -> Evidence:
        best = replace(score(1, overlap, None), confirmed=round(seen * judged), judged=judged)
        best = replace(best, details=measured(0.76, ground=0.62))
        poor = replace(score(0, 0.6, 0.55), details=measured(0.5))
        return Evidence(best, 0.4, (poor,))

    bay, fits = found(200, 0.74), found(200, 0.95)
    assert MODEL.cautiously(bay) < CAUTIOUSLY < MODEL.cautiously(fits)
    verdict = decide(bay, None, MODEL, config)
    assert verdict.reason is Reason.TOO_UNCERTAIN and "others are but worse" in verdict.message
    assert MODEL.probability(bay) > demand(fits, MODEL).confidence(config)
    assert decide(fits, None, MODEL, config).reason is None
    # How much less is seen elsewhere is what the cautious model does not count.
    assert MODEL.cautiously(bay) == MODEL.cautiously(found(200, 0.74, 0.9))
    assert MODEL.probability(bay) > MODEL.probability(found(200, 0.74, 0.9))
    # Nor are poses of which few walls are flush, or unknown: wrong ones are not so likely.
    for flush in (None, 0.5):
        hedge = replace(bay, score=replace(bay.score, details=measured(flush, ground=0.62)))
        assert demand(hedge, MODEL).confidence(config) < demand(fits, MODEL).confidence(config)
    # Where much of the map is in view, more would differ at another place.
    assert decide(found(800, 0.74), None, MODEL, config).reason is None


def test_a_pose_far_from_the_path_of_the_map_is_doubted() -> None:
    """What is there was mapped from one side: the far end of a hall is like that of another."""

    def found(off_path: float | None, flush: float = 0.8, inliers: int = 1) -> Evidence:
        best = replace(score(inliers, 0.9, 0.98), details=measured(flush, ground=0.9))
        rival = replace(score(0, 0.75, 0.9), details=measured(0.65, ground=0.9))
        return Evidence(best, 3.0, (rival,), extent=80, off_path=off_path)

    verdict = decide(found(32.0), None, MODEL, VerificationConfig())
    assert verdict.reason is Reason.TOO_UNCERTAIN
    assert verdict.message.endswith("it is 32 m from the path of the map")
    hedges = found(20.0, flush=0.5), found(32.0, flush=0.5)
    assert [bool(demand(each, MODEL).why) for each in hedges] == [False, True]
    for near in (found(7.0), found(None), found(32.0, inliers=15)):
        assert not demand(near, MODEL).why
    assert decide(found(7.0), None, MODEL, VerificationConfig()).reason is None
    config = VerificationConfig()
    doubted, edge = (demand(found(off), MODEL).confidence(config) for off in (20.0, 32.0))
    assert doubted < 0.9993 < edge  # what is off the map does not speak against a pose


def test_a_storey_is_told_from_the_others_where_nothing_but_it_fits() -> None:
    """A room that is like others is not the same; only a storey above or below might be."""
    config = VerificationConfig()

    def found(
        up: float,
        overlap: float = 0.99,
        judged: int = 220,
        there: float = 0.8,
        storeyed: bool = True,
    ) -> Evidence:
        best = replace(score(1, overlap, None), confirmed=judged - 3, judged=judged)
        best = replace(best, details=measured(0.8, ground=0.85))
        T = np.eye(4)
        T[2, 3] = up
        details = measured(0.8 * there, ground=0.85)
        storey = replace(score(0, there, there), T_map_local=T, details=details)
        cloud: Any = SimpleNamespace(
            ranked=lambda *_: [], off_path=lambda _: 0.5, storeyed=storeyed
        )
        query: Any = SimpleNamespace(extent=15)
        scores = CandidateScores([], cloud, query, config, Separation(), lambda _: 0)
        return scores.evidence(best, (storey,), 3)

    told = found(3.0)
    assert MODEL.unbounded(told) < Demand(CONFINED_ROOT).confidence(config)
    assert decide(told, None, MODEL, config).reason is None
    for other in (
        found(0.0),  # the same place
        found(3.0, overlap=0.96),
        found(3.0, judged=180),
        found(3.0, there=0.97),
        replace(told, rivals=(), other_storeys=()),
        found(3.0, storeyed=False),  # the next shelf of a rack is no storey
    ):
        assert demand(other, MODEL).root == CONFINED_ROOT


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
