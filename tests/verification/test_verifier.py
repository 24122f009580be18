"""Nearest map points against a k-d tree, and the gates of verification one by one."""

from __future__ import annotations

import json
from dataclasses import replace
from itertools import pairwise, product
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from samples.plaza import Plaza, PlazaSequence
from scipy.ndimage import minimum_filter
from scipy.spatial import cKDTree

from segloc import Config, Localizer, SegmentMap, build_map, geometry
from segloc._native import PointIndex, VisibilityCheck
from segloc.config import differences
from segloc.errors import WeightsError
from segloc.geometry import Separation
from segloc.localization import Reason
from segloc.map.compact import CompactConfig
from segloc.map.config import MappingConfig
from segloc.matching import MatchingConfig
from segloc.occupancy import OccupancyConfig
from segloc.segmentation import Segmentation
from segloc.types import Candidate, Descriptors, Float32, Float64, Int64, Pose, Segments
from segloc.verification import Evidence, VerificationConfig, Verifier, shipped_confidence
from segloc.verification.candidates import CandidateScores
from segloc.verification.confidence import load_confidence
from segloc.verification.decision import CAUTIOUSLY, confidence_needed, decide
from segloc.verification.evidence import RankedCandidate, RefinedScore


def within_reach(points: Float64, cloud: Float32) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Whether each point is as low as the cloud around it, and whether there is no cloud."""
    cells, own = np.floor(points[:, None, :2] / 4), np.floor(cloud[:, :2] / 4)
    around = (np.abs(cells - own) <= 1).all(axis=2)
    low = np.where(around, cloud[:, 2], np.inf).min(axis=1)
    high = np.where(around, cloud[:, 2], -np.inf).max(axis=1)
    return points[:, 2] <= np.maximum(high, low + 3) + 0.5, ~around.any(axis=1)


@settings(max_examples=50, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(1, 500), st.floats(0.05, 1.0), st.floats(0.1, 1.0))
def test_overlap_is_what_a_tree_finds(seed: int, count: int, radius: float, share: float) -> None:
    rng = np.random.default_rng(seed)
    cloud = rng.uniform(-4, 4, (count, 3)).astype(np.float32)
    query = rng.uniform([-9, -9, -5], [9, 9, 9], (200, 3)).astype(np.float32)
    T = geometry.yaw_transform(rng.uniform(-3, 3), tuple(rng.uniform(-2, 2, 3)))
    asked = radius * share
    distance = cKDTree(cloud).query(geometry.transform(T, query))[0]
    if np.abs(distance - asked).min() < 1e-5:  # decided by rounding
        return
    moved = geometry.transform(T, query)
    low, unmapped = within_reach(moved, cloud)
    near = (distance < asked) & low & ~unmapped
    judged = (low | unmapped).sum()
    index = PointIndex(cloud, radius)
    for counts in (0.0, 0.25):
        overlap, rmse = index.overlap(query, T[None], asked, counts)
        assert overlap[0] == (near.sum() + counts * unmapped.sum()) / max(judged, 1)
    if near.any():
        assert abs(rmse[0] - np.sqrt((distance[near] ** 2).mean())) < 1e-4


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


LACKING = {"constant": 0.0, "weights": {"flush": 1.0}}


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
    judged = moved[(floor > -np.inf) & (moved[:, 2] > floor + 0.5)]
    seen = cKDTree(structure).query(judged)[0] <= 0.4
    at, ranges = pixels(judged)
    behind = nearest[at] > ranges + np.maximum(0.7, 0.05 * ranges)
    return int(seen.sum()), int((~seen & np.isfinite(image[at]) & behind).sum())


@settings(max_examples=40, deadline=None)
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


def test_a_wall_that_is_gone_violates_free_space_and_one_behind_another_is_not_judged() -> None:
    y, z = (v.ravel().astype(np.float32) for v in np.mgrid[-6:6:0.2, -1:2:0.2])

    def wall(x: float) -> Float32:
        return np.column_stack([np.full_like(y, x), y, z]).astype(np.float32)

    floor = np.stack(np.meshgrid(np.arange(-12, 12, 0.5), np.arange(-12, 12, 0.5), [-1.7]), -1)
    ground = floor.reshape(-1, 3).astype(np.float32)

    def shares(live: Float32, prior_map: Float32) -> tuple[int, int]:
        return VisibilityCheck(live, ground, 30.0, 2.0, 0.4).count(prior_map, np.eye(4), 0.4, 0.7)

    assert shares(wall(8), wall(8)) == (len(y), 0)
    assert shares(wall(8), wall(11)) == (0, 0)  # hidden
    seen, through = shares(wall(8), wall(5))
    assert seen == 0 and through > 0.5 * len(y)


MODEL = shipped_confidence()


def measured(flush: float | None = None, ground: float | None = None) -> Any:
    return SimpleNamespace(ground=ground, flush=flush)


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


def test_what_is_not_known_does_not_speak_for_a_pose() -> None:
    good = MODEL.probability(evidence(4, 0.6, 0.7, 1.2, (0.2, 0.2)))
    assert MODEL.probability(evidence(4, 0.6, 0.7, 1.2)) < good
    # Overlap stands in for what is seen, and for walls that are not there; much in view says more.
    unseen, same = evidence(4, 0.6, None, 1.2), evidence(4, 0.6, 0.6, 1.2)
    assert MODEL.probability(unseen) < MODEL.probability(same)

    def p(details: Any) -> float:
        return MODEL.probability(replace(unseen, score=replace(unseen.score, details=details)))

    assert p(measured(flush=0.6)) == pytest.approx(MODEL.probability(unseen))


def test_few_judged_points_say_little_and_no_step_lies_between() -> None:
    def p(judged: int) -> float:
        seen = replace(score(3, 0.45, None), confirmed=0, judged=judged)
        return MODEL.probability(Evidence(seen, 1.0, ()))

    falling = [p(judged) for judged in range(0, 400, 5)]
    assert all(a > b for a, b in pairwise(falling)) and falling[0] > 1.5 * falling[-1]
    assert max(a - b for a, b in pairwise(falling)) < 0.1
    assert MODEL.standalone(score(0, 0.0, None)) < 0.01


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

    cloud: Any = SimpleNamespace(ranked=ranked, refined=refined)
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

    def needed(inliers: int, ratio: float, judged: int = 2000) -> float:
        found = evidence(inliers, 0.9, 0.95, ratio)
        best = replace(found.score, confirmed=round(0.95 * judged), judged=judged)
        return confidence_needed(replace(found, score=best, extent=40), MODEL, config)

    many, few = needed(20, 3.0), needed(4, 3.0)
    assert many == config.min_confidence < few < 1
    assert needed(9, 1.1) == few == needed(4, 3.0, 200)  # as many elsewhere
    # With much in view, segments of another part of a place that repeats itself agree as well.
    repeated = needed(9, 2.0)
    assert few < repeated < 1 and needed(19, 1.5) == repeated
    assert needed(9, 2.0, 200) == needed(12, 3.0) == many


def test_a_view_as_small_as_a_room_is_not_believed_unless_segments_decide() -> None:
    """Rooms are like other rooms, whatever the clouds say."""
    config = VerificationConfig()
    alike = replace(evidence(4, 0.9, 0.95, 4.0, (0.8, 0.9)), extent=40)
    assert decide(alike, None, MODEL, config).reason is None
    verdict = decide(replace(alike, extent=12), None, MODEL, config)
    assert verdict.reason is Reason.TOO_UNCERTAIN and "12 squares" in verdict.message
    needed = confidence_needed(replace(alike, extent=12), MODEL, config)
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
    assert MODEL.probability(bay) > confidence_needed(fits, MODEL, config)
    assert decide(fits, None, MODEL, config).reason is None
    # How much less is seen elsewhere is what the cautious model does not count.
    assert MODEL.cautiously(bay) == MODEL.cautiously(found(200, 0.74, 0.9))
    assert MODEL.probability(bay) > MODEL.probability(found(200, 0.74, 0.9))
    # Nor are poses of which few walls are flush, or unknown: wrong ones are not so likely.
    for flush in (None, 0.5):
        hedge = replace(bay, score=replace(bay.score, details=measured(flush, ground=0.62)))
        assert confidence_needed(hedge, MODEL, config) == confidence_needed(fits, MODEL, config)
    # Where much of the map is in view, more would differ at another place.
    assert decide(found(800, 0.74), None, MODEL, config).reason is None


def test_the_extent_is_what_stands_around_the_sensor() -> None:
    """A wall of 40 m; neither the ground counts, nor a wall that is out of range."""
    along = np.arange(-20.0, 20.0, 0.25)
    wall = np.stack([along, np.full_like(along, 5.0), np.full_like(along, 1.5)], axis=1)
    ground = np.stack([along, along, np.zeros_like(along)], axis=1).astype(np.float32)
    judge = Verifier(wall.astype(np.float32), np.zeros(3))
    no_points = np.zeros((0, 3), np.float32)

    def extent(*walls: Float64) -> int:
        none = Segments(no_points, np.zeros(1, np.int64), np.zeros((0, 3)), np.zeros(0))
        structure = np.concatenate([no_points, *walls], dtype=np.float32)
        return judge.query(Segmentation(none, structure, ground)).extent

    assert extent() == 0
    assert extent(wall) == extent(wall, wall) == extent(wall, wall + [0.0, 60.0, 0.0]) == 10
    assert extent(wall, wall + [0.0, 9.0, 0.0]) == 20


def test_no_score_makes_an_impossible_confidence() -> None:
    for inliers, overlap, seen, ratio in product(
        (0, 3, 10**6), (0.0, 1.0), (None, 0.0, 1.0), (0.0, 1e9)
    ):
        for rival in (None, (0.0, None), (1.0, 1.0)):
            assert 0 <= MODEL.probability(evidence(inliers, overlap, seen, ratio, rival)) <= 1


def test_the_confidence_was_fitted_under_the_default_configuration() -> None:
    assert differences(Config().model_dump(mode="json"), MODEL.settings) == []
    whole = {"segmentation", "mapping", "matching", "pose", "occupancy", "verification"}
    assert set(MODEL.settings) == whole and MODEL.card["command"]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("{", "damaged"),
        ("{}", "Field required"),
        (json.dumps({**MODEL.model_dump(mode="json"), "constant": "x"}), "constant"),
        (json.dumps({**MODEL.model_dump(mode="json"), "weights": {"seen": 1.0}}), "weights must"),
        (json.dumps({**MODEL.model_dump(mode="json"), "format": 1}), "format"),
        (json.dumps({**MODEL.model_dump(mode="json"), "cautious": LACKING}), "weights must"),
    ],
)
def test_a_damaged_model_is_refused(tmp_path: Path, text: str, said: str) -> None:
    path = tmp_path / "confidence.json"
    path.write_text(text)
    with pytest.raises(WeightsError, match=said):
        load_confidence(path)


@pytest.mark.parametrize(
    ("gate", "reason"),
    [
        ({"min_inliers": 10_000}, Reason.TOO_FEW_INLIERS),
        ({"min_confidence": 1.0}, Reason.TOO_UNCERTAIN),
    ],
)
def test_each_gate_refuses_and_says_so(
    plaza: Plaza, gate: dict[str, float], reason: Reason
) -> None:
    config = Config.preset("geo")
    prior_map = build_map(PlazaSequence(plaza, steps=6), config)
    scan = plaza.scan(geometry.yaw_transform(0.3, (-8.0, 1.0, 1.7)))
    assert Localizer(prior_map, config).localize(scan).localized
    gates = VerificationConfig(**gate)  # type: ignore[arg-type]
    result = Localizer(prior_map, config.model_copy(update={"verification": gates})).localize(scan)
    assert not result.localized and result.reason is reason and reason.value in result.message
    assert result.T_map_sensor is None


def twice(prior_map: SegmentMap, by: float) -> SegmentMap:
    """A map that holds its place a second time, so many metres farther."""
    both = prior_map.crop((0.0, 0.0), np.inf)
    move = np.array([by, 0.0, 0.0])
    both.add(
        Descriptors(prior_map.vectors, prior_map.quality),
        prior_map.centroids + move,
        prior_map.sizes,
        session=1,
        stamp=0.0,
        cloud=prior_map.cloud + prior_map.origin + move,
    )
    return both


@pytest.mark.slow
@pytest.mark.parametrize("method", ["geo", "profile"])
def test_a_place_that_the_map_holds_twice_is_ambiguous(plaza: Plaza, method: str) -> None:
    config = Config.preset(method)
    prior_map = build_map(PlazaSequence(plaza, steps=6), config)
    scans = [plaza.scan(geometry.yaw_transform(yaw, (-8.0, 1.0, 1.7))) for yaw in (0.3, 2.0)]
    for scan in scans:
        assert Localizer(prior_map, config).localize(scan).localized
        result = Localizer(twice(prior_map, 500.0), config).localize(scan)
        assert not result.localized and result.reason is Reason.AMBIGUOUS
        assert result.runner_up is not None


def test_more_neighbours_are_tried_where_too_few_segments_agree(plaza: Plaza) -> None:
    every_view = MappingConfig(compact=CompactConfig(enabled=False))
    config = Config.preset("geo").model_copy(update={"mapping": every_view})
    prior_map = build_map(PlazaSequence(plaza, steps=6), config)
    scan = plaza.scan(geometry.yaw_transform(0.3, (-8.0, 1.0, 1.7)))
    rng = np.random.default_rng(0)
    # The nearest is hardly ever right:
    prior_map.vectors[:] += rng.normal(0, 2.5, prior_map.vectors.shape)
    answers = []
    for escalation in (1, 80):
        matching = MatchingConfig(neighbours=1, escalation=escalation)
        gates = VerificationConfig(min_inliers=3)
        clouds = OccupancyConfig(enabled=False)
        config = Config.preset("geo").model_copy(
            update={"matching": matching, "verification": gates, "occupancy": clouds}
        )
        answers.append(Localizer(prior_map, config).localize(scan))
    lost, found = answers
    assert not lost.localized and lost.reason is Reason.TOO_FEW_INLIERS
    assert found.localized
    assert found.counts["proposed"] == min(80, len(prior_map)) * found.counts["segments"]


def test_neighbours_grow_with_the_map_up_to_a_limit() -> None:
    config = MatchingConfig()
    first = [config.schedule(n)[0] for n in (10, 50_000, 200_000, 1_000_000, 10**8)]
    assert first[:2] == [25, 25] and first == sorted(first) and first[-1] == config.max_neighbours
    assert Config.preset("nsm").matching.schedule(10**7) == (200,)
    assert Config.preset("dsm").matching.schedule(10**7) == (25,)
