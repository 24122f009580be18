"""Scoring of localizations: errors, counts, and what the records say."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from segloc import geometry
from segloc.localization import Localization, Localized, NotLocalized, Place, Reason
from segloc.map.segment_map import SegmentMap
from segloc.tools.batch.picture import draw, draw_errors
from segloc.tools.batch.report import summary_rows
from segloc.tools.batch.run import query_positions
from segloc.tools.batch.score import (
    RECORD,
    SUMMARY,
    Evaluation,
    Tolerance,
    distances_to_map,
    distances_to_path,
    pose_errors,
)
from segloc.tools.inspect.pictures import blank, coordinates, plan, scale
from segloc.types import Descriptors


def pose(x: float, y: float = 0.0, z: float = 0.0, yaw_deg: float = 0.0) -> np.ndarray:
    return geometry.yaw_transform(math.radians(yaw_deg), (x, y, z))


def line(xs: Sequence[float]) -> np.ndarray:
    return np.stack([pose(x) for x in xs])


found = st.tuples(st.floats(-1e3, 1e3), st.floats(-1e3, 1e3), st.floats(-1e3, 1e3))


@settings(max_examples=30)
@given(found, st.floats(0, 100), st.floats(0, 179), st.floats(-180, 180), st.integers(0, 99))
def test_errors_are_what_was_put_in(
    position: tuple[float, float, float], metres: float, degrees: float, yaw: float, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    direction, axis = (v / np.linalg.norm(v) for v in rng.normal(size=(2, 3)))
    truth = pose(*position, yaw_deg=yaw)
    estimate = truth.copy()
    estimate[:3, 3] += metres * direction
    estimate[:3, :3] @= Rotation.from_rotvec(math.radians(degrees) * axis).as_matrix()
    translation, rotation = pose_errors(estimate[None], truth[None])
    assert translation[0] == pytest.approx(metres, abs=1e-9)
    assert rotation[0] == pytest.approx(degrees, abs=1e-6)


def test_queries_stand_at_the_end_of_each_stretch() -> None:
    assert query_positions(line(range(11)), 4.0, 10.0).tolist() == [4, 8]
    assert query_positions(line(np.arange(0, 21, 2.0)), 5.0, 10.0).tolist() == [3, 5, 8, 10]
    assert query_positions(line(range(4)), 4.0, 10.0).tolist() == []
    assert query_positions(line([0]), 1.0, 10.0).tolist() == []
    assert query_positions(np.empty((0, 4, 4)), 1.0, 10.0).tolist() == []
    # Standing still is no travel, and long stretches have at most one query a scan.
    assert query_positions(line([0, 1, 1, 1, 2, 3]), 2.0, 10.0).tolist() == [4]
    assert query_positions(line([0, 9, 18]), 2.0, 10.0).tolist() == [1, 2]


def test_distance_to_the_path_is_horizontal() -> None:
    path = line([0, 10, 20])
    poses = np.stack([pose(10, 1, 50), pose(-3, 4), pose(15, 2)])
    assert distances_to_path(poses, path) == pytest.approx([1.0, 5.0, 2.0])
    broken = line([0, 10, 20, 90])
    assert distances_to_path(line([55]), broken) == pytest.approx([35.0])
    assert np.isinf(distances_to_path(path, np.empty((0, 4, 4)))).all()


def test_a_finished_cloud_covers_what_its_surfaces_surround() -> None:
    """Two walls of 60 m, 15 m apart; viewpoints stand behind them."""
    walls = [np.arange(0, 60, 0.5), np.zeros(120), np.ones(120)]
    origin = np.array([500.0, 900.0, 0.0])
    site = SegmentMap.empty("geo", "f" * 16, 5, origin, cloud_voxel=0.3)
    site.add_cloud(np.column_stack(walls) + origin)
    site.add_cloud(np.column_stack(walls) + [0, 15, 0] + origin)
    site.add_trajectory(np.stack([pose(500 + x, 940) for x in (0, 30, 60)]))
    at = [(30, 7.5), (30, -2), (30, 25), (75, 0)]
    truths = np.stack([pose(500 + x, 900 + y) for x, y in at])
    results = [result(truths[0]), *3 * [result(None)]]
    site.metadata |= {"source": "cloud", "viewpoints": "lattice"}
    scored = Evaluation(np.arange(4), results, site, truths)
    assert scored.distance_to_map == pytest.approx([0, 2, 10, 15], abs=1.0)
    assert scored.within_coverage.tolist() == [True, True, False, False]
    coarse = SegmentMap.empty("geo", "f" * 16, 2, origin)
    corners = origin + np.array([[x, y, 1.0] for x in range(0, 60, 10) for y in (0, 15)])
    segments = Descriptors(np.ones((len(corners), 2), np.float32))
    sizes = np.ones(len(corners), np.int64)
    coarse.add(segments, corners, sizes, session=0, stamp=0.0, cloud=np.empty((0, 3)))
    coarse.metadata["source"] = "cloud"
    assert distances_to_map(truths, coarse)[:3] == pytest.approx([0, 2, 10], abs=1.0)
    far = Evaluation(np.arange(2), results[2:], site, truths[2:])
    assert ("correct, of those within map coverage", "1 of 2") in summary_rows(scored.summary())
    assert ("within map coverage", "none") in summary_rows(far.summary())


def result(T: np.ndarray | None, reason: str = "ambiguous", ms: float = 10.0) -> Localization:
    common: dict[str, Any] = {
        "inliers": 7,
        "places": (Place(pose(5), 0.75, 3, 0.25),),
        "not_in_map": 0.25,
        "times_ms": {"total": ms},
    }
    if T is None:
        return NotLocalized(reason=Reason(reason), message=f"{reason} (so)", **common)
    return Localized(T_map_sensor=T, **common)


@pytest.fixture
def evaluation() -> Evaluation:
    truths = np.stack([pose(0), pose(10), pose(20), pose(30), pose(40, 9.0), pose(50, 9.0)])
    results = [
        result(pose(2.9, yaw_deg=4.9)),  # correct
        result(pose(13.1)),  # false: too far
        result(pose(20, yaw_deg=5.1)),  # false: turned
        result(None, "no segments", ms=math.nan),
        result(pose(40, 9.5)),  # correct, off the map's path
        result(None),
    ]
    return Evaluation(np.arange(100, 106), results, line(range(0, 60, 2)), truths)


def test_every_query_is_counted_once(evaluation: Evaluation) -> None:
    assert evaluation.correct.tolist() == [True, False, False, False, True, False]
    assert evaluation.false.tolist() == [False, True, True, False, False, False]
    summary = evaluation.summary()
    counts = ("queries", "localized", "not_localized", "correct", "false")
    assert [summary[c] for c in counts] == [6, 4, 2, 2, 2]
    assert (summary["within_coverage"], summary["within_coverage_correct"]) == (4, 1)
    assert summary["reasons"] == {"ambiguous": 1, "no segments": 1}
    assert summary["translation_error_m"]["median"] == pytest.approx((0.5 + 2.9) / 2)
    assert summary["rotation_error_deg"]["median"] == pytest.approx(2.45)
    json.dumps(summary, allow_nan=False)
    assert list(summary) == list(SUMMARY)


def test_tolerances_decide(evaluation: Evaluation) -> None:
    truths = evaluation.truths
    strict = Evaluation(
        evaluation.indices, evaluation.results, np.empty((0, 4, 4)), truths, Tolerance(0.1, 5.2)
    )
    assert strict.correct.tolist() == [False, False, True, False, False, False]
    assert not strict.within_coverage.any()


def test_records_hold_no_nan_and_keep_times_apart(evaluation: Evaluation) -> None:
    records = list(evaluation.records())
    assert [r["index"] for r in records] == list(range(100, 106))
    for record in records:
        json.dumps(record, allow_nan=False)
        assert list(record) == list(RECORD)
    assert records[3]["T_map_sensor"] is None and records[3]["translation_error_m"] is None
    assert records[3]["rmse"] is None and records[3]["ms"] == {"total": None}
    assert records[4]["distance_to_map_m"] == pytest.approx(9.0)
    where = {"T_map_sensor": pose(5).tolist(), "probability": 0.75}
    assert records[0]["places"] == [{**where, "inliers": 3, "overlap": 0.25}]
    assert records[0]["not_in_map"] == 0.25


def test_without_truth_nothing_is_scored(evaluation: Evaluation) -> None:
    blind = Evaluation(evaluation.indices, evaluation.results, line([0]))
    summary = blind.summary()
    assert summary["correct"] is None and summary["false"] is None
    assert summary["translation_error_m"] == {"median": None, "p95": None}
    assert "within_coverage" not in summary and summary["localized"] == 4
    assert "correct" not in next(blind.records())


def test_drawing(evaluation: Evaluation) -> None:
    pytest.importorskip("matplotlib")
    prior_map = SegmentMap.empty("geo", "f", 2, (5.0, 5.0, 0.0))
    empty = Evaluation(np.empty(0, np.int64), [], prior_map.trajectory)
    blind = Evaluation(evaluation.indices, evaluation.results, prior_map.trajectory)
    pictures = [draw(prior_map, case, "a town") for case in (evaluation, blind, empty)]
    view = Descriptors(np.zeros((0, 2), np.float32))
    cloud = np.random.default_rng(0).normal(size=(500, 3)) * 20
    prior_map.add(view, np.empty((0, 3)), [], session=0, stamp=0, cloud=cloud)
    prior_map.add_trajectory(line([0, 10, 90]))
    pictures.append(draw(prior_map, evaluation, "a town"))
    assert all(picture.startswith(b"\x89PNG") for picture in pictures)
    assert draw(prior_map, evaluation, "a town") == pictures[-1]
    assert b"trajectory of the map" in pictures[-1] and b"viewpoints" not in pictures[-1]
    prior_map.metadata["source"] = "cloud"  # chosen viewpoints, which nobody drove between
    drawn = draw(prior_map, evaluation, "a town")
    assert b"viewpoints of the map" in drawn and b"trajectory of the map" not in drawn
    assert draw_errors(prior_map, evaluation, "a town").startswith(b"\x89PNG")


def test_ground_plans_have_round_coordinates_and_a_bar_as_long_as_a_cell() -> None:
    pytest.importorskip("matplotlib", reason="pictures need the extra 'report'")
    axes = blank((8.0, 4.0), 100).add_subplot()
    plan(axes, (691_600.0, 5_336_000.0), (691_800.0, 5_336_100.0))
    coordinates(axes)
    scale(axes)
    ticks = axes.get_xticks()
    assert (np.diff(ticks) == 20.0).all() and (ticks % 20.0 == 0.0).all()
    axes.figure.canvas.draw()
    assert "691660" in {label.get_text() for label in axes.get_xticklabels()}
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("x, m", "y, m")
    assert [text.get_text() for text in axes.texts] == ["20 m"]
