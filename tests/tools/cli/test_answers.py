"""What ``segloc localize`` and ``segloc explain`` say of a scan."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from html import escape
from pathlib import Path

import numpy as np
import pytest
from samples.maps import repeated
from samples.plaza import Plaza
from samples.storey import furnished, scan_in, storey
from samples.walk import POINTS_ASIDE, Site, run

from segloc import Localizer, SegmentMap, build_map, geometry
from segloc.likelihood import (
    Count,
    Posterior,
    Walls,
    aligned_measures,
    features_of,
    walls_over,
)
from segloc.tools.inspect import confidence_tables, steps, summarize, trace
from segloc.tools.inspect.evidence import LABELS, evidence_rows, parts_of
from segloc.tools.io import read_trajectory
from segloc.types import Scan

AWAY = np.array([300.0, 40.0, 0.0])


@pytest.mark.slow
def test_one_scan_gives_one_line_with_its_pose(
    site: Site, capsys: pytest.CaptureFixture[str]
) -> None:
    capsys.readouterr()
    assert run("localize", site.run / "0004.npy", "--map", site.map) == 0
    out, err = capsys.readouterr()
    found = re.fullmatch(
        r"localized at x (\S+), y (\S+), z (\S+) m, yaw (\S+) deg; confidence (0\.\d\d|1\.00) "
        r"\(\d+% of the cloud lies on the map; proposed by first sight\)\n",
        out,
    )
    assert found and err == ""
    truth = read_trajectory(site.run / "poses.tum").at(4)
    assert truth is not None
    assert np.allclose([float(v) for v in found.groups()[:3]], truth[:3, 3], atol=0.3)


@pytest.mark.slow
def test_one_scan_that_is_not_found_says_why(
    site: Site, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    np.save(tmp_path / "0.npy", POINTS_ASIDE)
    assert run("localize", tmp_path / "0.npy", "--map", site.map) == 0
    out, err = capsys.readouterr()
    assert re.fullmatch(r"not localized: [a-z].*; confidence 0\.\d\d\n", out)
    assert "were they taken within the map?" in err or "Likely cause" in err


@pytest.mark.slow
def test_a_prior_that_excludes_the_place_is_named(
    site: Site, capsys: pytest.CaptureFixture[str]
) -> None:
    prior = ("--near", "900,900", "--radius", "5")
    assert run("localize", site.run / "0004.npy", "--map", site.map, *prior) == 0
    out, err = capsys.readouterr()
    assert out.startswith("not localized: not near the prior")
    assert "Likely cause: the prior excludes them: query 4 is at" in " ".join(err.split())


@pytest.mark.slow
def test_many_answers_are_a_table_with_the_worst_first(
    site: Site, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for i in range(3):
        np.save(tmp_path / f"{i}.npy", np.load(site.run / f"000{i + 3}.npy"))
    np.save(tmp_path / "3.npy", POINTS_ASIDE)
    assert run("localize", tmp_path, "--map", site.map) == 0
    lines = capsys.readouterr().out.splitlines()
    rows = [line for line in lines if re.search(r"│ +[0-3] │|│ [0-3] +│", line)]
    assert "x " not in rows[0] and rows[0].split("│")[1].strip() == "3"
    assert all("yaw" in row for row in rows[1:4])


@pytest.mark.slow
def test_json_on_stdout_is_all_of_it(site: Site, capsys: pytest.CaptureFixture[str]) -> None:
    capsys.readouterr()
    assert run("localize", site.run, "--map", site.map, "--select", "4:5", "--json") == 0
    found = json.loads(capsys.readouterr().out)
    assert run("localize", site.run / "0004.npy", "--map", site.map, "--json") == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) <= 60 and max(map(len, lines)) <= 100  # a screen, 8 lines of covariance
    assert found["summary"]["queries"] == len(found["queries"]) == 2
    assert {"T_map_sensor", "confidence", "reason", "message"} <= found["queries"][0].keys()


@pytest.mark.slow
def test_the_page_of_a_run_is_one_file_with_answers_and_pictures(
    site: Site, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("matplotlib", reason="pictures need the extra 'report'")
    for i in (3, 4):
        np.save(tmp_path / f"{i}.npy", np.load(site.run / f"000{i}.npy"))
    np.save(tmp_path / "5.npy", POINTS_ASIDE)
    html, truth = tmp_path / "run.html", site.run / "poses.tum"
    query = ["localize", tmp_path, "--map", site.map, "--truth", truth, "--html", html]
    assert run(*query) == 0
    assert f"{html}: open it in a browser" in capsys.readouterr().out
    text = html.read_text("utf-8")
    assert "2 of 3 queries localized, 2 correct, 0 false" in text
    assert text.count("data:image/png;base64,") == 2
    assert not re.search(r"(src|href)=\"(?!data:)", text) and "://" not in text
    assert re.search(r"<tr><td>5</td><td>0\.\d\d</td><td>[a-z]", text)
    assert len(re.findall(r"<td>x \S+ y", text)) == 2


def test_lines_are_whole_where_stdout_is_no_terminal(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    from segloc.tools.cli.console import note, table

    path = tmp_path / ("long" * 60)
    table(str(path), ("", ""), [("path", str(path))])
    note(str(path))
    out, err = capsys.readouterr()
    assert out.count(str(path)) == 2 and str(path) in err


def test_progress_is_a_line_now_and_then_where_stderr_is_no_terminal(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    from segloc.tools.cli import console

    now = [0.0]
    monkeypatch.setattr(console.time, "monotonic", lambda: now[0])
    with console.progress("Training") as update:
        for done in range(7):
            update(done, 6)
            now[0] += 0.6 * console.SECONDS_A_LINE
    lines = [f"Training: {done} of 6" for done in (2, 4, 6)]
    assert capsys.readouterr().err.splitlines() == lines
    with console.progress("Testing") as update:  # soon done
        update(1, 1)
    assert capsys.readouterr().err == ""


# --- explain --------------------------------------------------------------------------------------


@pytest.mark.slow
def test_the_parts_of_the_confidence_add_up_to_it(site: Site) -> None:
    localizer = Localizer(SegmentMap.load(site.map))
    for points in (np.load(site.run / "0004.npy"), POINTS_ASIDE):
        cloud = localizer.accumulator.gather(Scan(points))
        found, plain = trace(localizer, cloud), localizer.localize(cloud)
        assert (found.result.localized, found.result.confidence) == (
            plain.localized,
            plain.confidence,
        )
        if found.parts:
            log_ratio = found.prior + sum(part.log_odds for part in found.parts)
            best = localizer.search(localizer.describe(cloud)).posterior.best
            assert best is not None and log_ratio == pytest.approx(best.log_ratio)
            rows = [row for _, rows in confidence_tables(found) for row in rows]
            labels = sorted([*LABELS, "prior"])
            assert sorted(label for _, label, _ in rows) == labels  # each once
        if plain.localized:
            assert found.T_map_local is not None
            assert np.allclose(found.T_map_local @ found.T_local_sensor, plain.T_map_sensor)
            assert found.inliers.sum() >= plain.inliers and found.on_map.mean() > 0.8
        assert len(np.unique(found.pairs[:, 0])) == len(found.pairs)
        assert summarize(found).startswith("localized" if plain.localized else "not localized")
        assert [name for name, _ in steps(found)][:4] == ["cloud", "ground", "segments", "matches"]


@pytest.mark.slow
def test_poses_in_rooms_that_are_aligned_more_finely_are_explained() -> None:
    building = furnished(storey(1), 1)
    path = np.stack([geometry.yaw_transform(0.3 * k, (2.0 * k + 2, 5.5, 1.2)) for k in range(11)])
    scans = [scan_in(building, T, k) for k, T in enumerate(path)]
    localizer = Localizer(build_map(scans, poses=path, check=False))
    finer = 0
    for k, (x, y) in enumerate([(4.0, 5.2), (9.0, 5.8), (14.0, 5.3)]):
        cloud = localizer.accumulator.gather(
            scan_in(building, geometry.yaw_transform(1.0, (x, y, 1.2)), 100 + k)
        )
        found, search = trace(localizer, cloud), localizer.search(localizer.describe(cloud))
        best = search.posterior.best
        assert best is not None
        total = found.prior + sum(part.log_odds for part in found.parts)
        assert total == pytest.approx(best.log_ratio)
        finer += all(best.T_map_local is not fit.T_map_local for fit in search.fits)
    assert finer


def test_why_the_best_pose_beats_the_runner_up(plaza: Plaza, plaza_map: SegmentMap) -> None:
    everywhere = np.ones(len(plaza_map), bool)
    partly = plaza_map.kept(everywhere, np.abs(plaza_map.cloud[:, 0]) % 12 < 11.2)
    copy = repeated(partly, AWAY).crop(AWAY[:2], 100.0)
    both = plaza_map.merge(copy)
    both.metadata.update(plaza_map.metadata)
    localizer = Localizer(both)
    scan = plaza.scan(geometry.yaw_transform(1.0, (3.0, -2.0, 1.7)), seed=77)
    cloud = localizer.accumulator.gather(scan)
    found = trace(localizer, cloud)
    best, second = localizer.search(localizer.describe(cloud)).posterior.places[:2]
    over = sum(part.over for part in found.parts)
    assert over == pytest.approx(best.log_ratio - second.log_ratio) and over > 1.0
    title, rows = confidence_tables(found)[-1]
    sizes = [abs(float(log_odds)) for log_odds, _, _ in rows]
    assert title == "over the runner-up" and sizes == sorted(sizes, reverse=True)
    words = {label: text for _, label, text in rows}["wall by wall"]
    assert re.fullmatch(r"\d\d pieces of wall fit better here, \d at the runner-up", words)
    assert min(sizes) > 0


def test_what_was_not_measured_is_worth_nothing(plaza: Plaza, plaza_map: SegmentMap) -> None:
    localizer = Localizer(plaza_map)
    scan = plaza.scan(geometry.yaw_transform(1.0, (3.0, -2.0, 1.7)), seed=77)
    search = localizer.search(localizer.describe(localizer.accumulator.gather(scan)))
    (fit,) = search.fits
    nothing = Count(0, 0)
    walls = Walls(fit.walls.explained, 0 * fit.walls.weight)
    bare = replace(fit, inside=nothing, ground=nothing, on_surface=nothing, walls=walls)
    overlap, _ = aligned_measures(bare)
    features = features_of(bare, overlap, (), 0, walls_over(bare.walls))
    scored = localizer.likelihood.scored(bare, features)
    search = replace(
        search,
        posterior=Posterior.of([scored]),
        places=[replace(place, fit=bare) for place in search.places if place.fit is fit],
    )
    parts = parts_of(localizer.likelihood.model, search)
    unmeasured = {part.label: part for part in parts if part.words.startswith("not measured: ")}
    assert unmeasured.keys() == {"walls", "ground", "wall by wall"}
    (free,) = (part.words for part in parts if part.label == "free space")
    assert free == "the map in view tells more; not measured: no free space of the map is known"
    assert all(part.log_odds == pytest.approx(0.0) for part in unmeasured.values())
    groups = dict(evidence_rows(-6.0, parts))
    assert {label for _, label, _ in groups["neither"]} >= unmeasured.keys()


@pytest.mark.slow
def test_explain_prints_a_verdict_and_writes_a_page(
    site: Site, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("matplotlib")
    np.save(tmp_path / "0.npy", POINTS_ASIDE)
    np.save(tmp_path / "1.npy", 1000 * POINTS_ASIDE)
    html = tmp_path / "page.html"
    for scan, expected in [
        (site.run / "0004.npy", r"^localized at x "),
        (tmp_path / "0.npy", r"^not localized: not in the map \("),
        (
            tmp_path / "1.npy",
            r"^not localized: no points \(.*\nproblem: half of .* in millimetres",
        ),
    ]:
        capsys.readouterr()
        assert run("explain", scan, "--map", site.map, "--html", html) == 0
        out = capsys.readouterr().out
        assert re.search(expected, out), out
        text = html.read_text("utf-8")
        assert text.count("data:image/png;base64,") in (2, 5)
        assert not re.search(r"(src|href)=\"(?!data:)", text) and "://" not in text
        assert escape(out.splitlines()[0]) in text


@pytest.mark.slow
def test_a_scan_of_a_recording_is_chosen_by_its_number(
    site: Site, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ["--map", site.map, "--poses", "poses.tum"]
    assert run("explain", site.run, "--select", 5, *arguments) == 0
    assert re.search(r"cloud +\d+ points of 6 scans", capsys.readouterr().out)
    assert run("explain", site.run, "--select", 99, *arguments) == 1
    assert "nearest are 12 and 13" in capsys.readouterr().err


def test_options_that_would_be_ignored_are_refused(
    site: Site, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for command, expected in (
        (("localize", site.run, "--map", site.map, "--radius", 1), "--radius and --anywhere need"),
        (("localize", site.run, "--map", site.map, "--anywhere"), "--radius and --anywhere need"),
        (("odometry", site.run, "--select", "0:3"), "--select needs --out"),
        (
            ("live", site.run, "--map", "http://127.0.0.1:9/tiles", "--out", tmp_path / "live"),
            "http://127.0.0.1:9/tiles",
        ),
    ):
        assert run(*command) == 1
        assert expected in " ".join(capsys.readouterr().err.split())
