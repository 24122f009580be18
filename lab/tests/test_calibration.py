"""Worlds that are read again, and the fit of the posterior."""

from __future__ import annotations

import shutil
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from segloc_lab.calibration import judge, known
from segloc_lab.calibration.posterior import (
    FEATURES,
    KEPT,
    Decisions,
    Records,
    fit,
    fitted,
    records_of,
)
from segloc_lab.calibration.rows import ALIGNED, HOME, ROUGH, Rows
from segloc_lab.calibration.worlds import (
    MAX_THINNED,
    QuerySet,
    generated,
    load_queries,
    save_queries,
    simulated,
    write_world,
)
from segloc_lab.protocols import degenerate, first_sight, one_number, wrong_maps
from segloc_lab.protocols.wrong_maps import parts
from segloc_lab.report import entries
from segloc_lab.simulation.bare_views import VIEWS

from segloc import Config
from segloc.likelihood import shipped_model


@pytest.mark.parametrize("ground", [True, False])
def test_the_shipped_weights_are_those_of_the_kept_rows(ground: bool) -> None:
    rows, model = Rows.load(KEPT), shipped_model(ground=ground)
    shipped = np.array([*(model.weights[n] for n in FEATURES), model.none])
    found, promised = fitted(records_of(rows, ground=ground), shipped)
    assert np.allclose(found, shipped, atol=0.02)
    assert np.allclose(promised["rough"].weights, model.rough.weights, atol=0.02)
    assert np.allclose(promised["aligned"].weights, model.aligned.weights, atol=0.02)


@pytest.mark.slow
def test_what_a_view_says_of_a_known_pose_is_fitted_to_the_kept_rows() -> None:
    worlds, shipped = known.read(known.KEPT), shipped_model().known
    views = known.Views.of(worlds)
    found = known.fitted(views, np.ones(len(worlds), bool))
    assert [found.weights[n] for n in known.USED] == pytest.approx(
        [*shipped.weights.values()], abs=0.05
    )
    said = views.evidence(shipped)
    for count, right, wrong in ((1, 0.9, 0.17), (3, 0.9, 0.15)):
        runs = views.together(count)
        runs = runs[views.seen[runs[:, 0]] == known.WHOLE]
        told, alike = views.told(shipped)[runs], shipped.alike(known.STEP_M)
        sums, label = known.said_together(said[runs], told, alike), views.right[runs[:, 0]]
        assert (sums[label] > 0.0).mean() > right and (sums[~label] > 0.0).mean() < wrong


def test_people_around_a_sensor_shorten_its_rays() -> None:
    points = np.float32(np.random.default_rng(0).normal(size=(5000, 3)) * 20.0)
    ranges, blocked = (np.linalg.norm(p, axis=1) for p in (points, known.crowded(points, 1)))
    assert (blocked <= ranges + 1e-3).all() and 0.3 < (blocked < ranges - 1e-3).mean() < 0.97
    assert (blocked[blocked < ranges - 1e-3] < 3.1).all()


def test_queries_are_made_again(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    sizes = [MAX_THINNED + 500, 40, 30]
    points = rng.normal(size=(sum(sizes), 3)).astype(np.float32)
    offsets = np.concatenate([[0], np.cumsum(sizes)])
    truth = np.stack([np.eye(4)] * 3)
    truth[:, 0, 3] = [0.0, 2.0, 4.0]
    spans, thinning = np.array([[0, 0], [0, 0], [0, 2]]), np.array([-1, 5, -1])
    save_queries(
        tmp_path / "queries.npz",
        [QuerySet("vlp16", points, offsets, truth, truth, spans, thinning)],
    )
    single, thinned, accumulated = load_queries(tmp_path / "queries.npz")[0]
    assert np.array_equal(single.scans[0].points, points[: sizes[0]])
    assert single.scans[0].T_odom_sensor is None
    assert len(thinned.scans[0]) == MAX_THINNED
    assert [len(scan) for scan in accumulated.scans] == sizes
    assert accumulated.truth[0, 3] == 4.0
    assert (single.kind, thinned.kind, accumulated.kind) == ("single", "thinned", "accumulated")


def test_the_fit_finds_the_weights_that_drew_the_classes() -> None:
    rng = np.random.default_rng(2)
    weights = np.append(rng.normal(size=len(FEATURES)), 1.0)
    features = rng.normal(size=(20_000, 3, len(FEATURES)))
    scores = np.column_stack([features @ weights[:-1], np.full(len(features), weights[-1])])
    drawn = (scores + rng.gumbel(size=scores.shape)).argmax(axis=1)
    right = drawn[:, None] == np.arange(3)
    poses, names = np.ones_like(right), np.full(len(right), "town")
    number = np.zeros(len(right), np.int64)
    before = rng.normal(size=(*right.shape, len(ROUGH + ALIGNED)))
    records = Records(features, before, poses, right, ~right, number, names, names)
    found = fit(records)
    assert np.allclose(found, weights, atol=0.1)
    decisions = Decisions.by(records, found)
    sure = decisions.log_odds > np.log(9.0)
    assert 0.9 < decisions.right[sure].mean() < 1.0
    assert np.array_equal(decisions.right, ~decisions.false)


@pytest.fixture(scope="module")
def worlds(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    folder = tmp_path_factory.mktemp("calibration") / "worlds"
    with pytest.MonkeyPatch.context() as few:
        few.setattr("segloc_lab.calibration.worlds.BARE_VIEWS", 2)
        for name, seed in (("offices", 2), ("warehouse", 3)):
            write_world(simulated(name, seed, 20.0), folder / f"{name}-{seed}", Config(threads=1))
        yield folder


@pytest.mark.slow
def test_answers_in_worlds_are_reported(
    worlds: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def run(study: ModuleType, *words: str) -> tuple[list[dict[str, Any]], str]:
        name = study.__name__.rsplit(".", 1)[1]
        out, report = tmp_path / f"{name}.jsonl", tmp_path / name
        words = (*words, "--out", str(out), "--report", str(report))
        monkeypatch.setattr(sys, "argv", [name, *words])
        study.main()
        return entries(out), (report / "REPORT.md").read_text("utf-8")

    several = shutil.copytree(worlds, tmp_path / "worlds")  # one world is lost in two others
    write_world(simulated("offices", 4, 20.0), several / "offices-4", Config(threads=1))
    found, report = run(judge, str(several), "--every", "3")
    answers = judge.flat(found)
    whole = [a for a in answers if a["made"] in judge.WHOLE]
    home = [a["outcome"] for a in whole if a["map"] in HOME]
    assert f"| {home.count('found')} of {len(home)} |" in report
    assert f"| {sum(a['outcome'] == 'false' for a in whole)} of {len(whole)} |" in report
    compared, report = run(one_number, str(several), "--every", "3")
    both = [a for each in compared for a in each["found"]]
    accepted = sum(a["reason"] is None for a in both)
    assert f"| all | {len(both)} | {accepted} |" in report
    assert len(both) == len(answers)
    assert accepted == sum(a["localized"] for a in answers)  # one door
    ways, report = run(first_sight, str(several), "--every", "3")
    twice = [a for each in ways for a in each["found"]]
    counts = [sum(a[way] == "found" for a in twice) for way in ("seen", "matched")]
    assert f"| all | {len(twice)} | {counts[0]} | {counts[1]} |" in report
    assert len(twice) == len(answers) and counts[0] == sum(a["outcome"] == "found" for a in answers)
    views, report = run(degenerate, *map(str, worlds.glob("*/own.segmap")), "--each", "1")
    count = sum(len(each["answers"]) for each in views)
    assert count == 2 * len(VIEWS) and f"| all | {count} | 0 |" in report


@pytest.mark.slow
def test_queries_are_counted_in_their_own_and_in_other_maps(
    worlds: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "kept.jsonl"
    monkeypatch.setattr(sys, "argv", ["wrong_maps", str(worlds), "--out", str(out)])
    wrong_maps.main()
    records = entries(out)
    assert len(records) == len(parts(generated(worlds))) == 4
    kept = out.read_text("utf-8").splitlines()
    out.write_text("\n".join(kept[:-1]) + "\n", "utf-8")  # interrupted
    wrong_maps.main()
    assert [{**r, "seconds": 0} for r in entries(out)] == [{**r, "seconds": 0} for r in records]
    queries = sum(len(each) for each in load_queries(worlds / "offices-2/queries.npz"))
    rows = {
        row[0]: dict(zip(wrong_maps.COLUMNS, row, strict=True)) for row in wrong_maps.table(records)
    }
    assert rows["offices"]["queries elsewhere"] == 2 * queries
    assert rows["offices"]["in its mirror image"] == queries
    assert rows["warehouse"]["in its mirror image"] == 0
    right, of = map(int, rows["offices"]["own map: right"].split(" of "))
    assert right == of == queries
