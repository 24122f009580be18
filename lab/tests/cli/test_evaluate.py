"""``segloc evaluate``: the studies of the paper, and two recordings of the user."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from samples.tiny_suite import TINY
from segloc_lab.evaluation.study import Figure, Study, Table
from segloc_lab.simulation import record
from segloc_lab.studies import kitti_paper
from segloc_lab.studies.paper import workspace as studies

from segloc.errors import ConfigError, DatasetError, MissingDependency
from segloc.tools.cli import app

pytestmark = pytest.mark.usefixtures("verbs")


def evaluate(*arguments: object) -> None:
    app(["evaluate", *map(str, arguments)], standalone_mode=False)


@pytest.mark.parametrize(
    ("arguments", "error", "line"),
    [
        (
            ("roc", "--suite", "seven"),
            ConfigError,
            "suite must be one of six, repeated, not 'seven'",
        ),
        (
            ("roc", "--scale", "huge"),
            ConfigError,
            "scale must be one of small, full, paper, not 'huge'",
        ),
        (("localization", "here"), ConfigError, "two recordings"),
        (("peers", "--sets", "lake"), ConfigError, "--sets: no 'lake'; available: single"),
        (("peers", "--python", "open3d"), ConfigError, "pass NAME=PYTHON"),
        (("peers", "--sets", "single"), DatasetError, "no folder kitti00 .*pass --data"),
        (("localization", "a", "b"), DatasetError, "a: no such file or folder"),
        (("localization", "--methods", "x"), ConfigError, "no method 'x'.* dsm"),
        (("localization", "--kitti", "x"), DatasetError, "x: no such folder; --kitti needs"),
        (("localization", "a", "b", "--every", "0"), ConfigError, "--every must be a positive"),
    ],
)
def test_what_the_user_can_mend_is_one_line(
    arguments: tuple[str, ...], error: type[Exception], line: str, tmp_path: Path
) -> None:
    with pytest.raises(error, match=line):
        evaluate(*arguments, "--out", tmp_path / "out")


def test_all_runs_every_study_and_leaves_out_what_cannot_be(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    done: list[str] = []

    def run(name: str, workspace: object) -> Study:
        if name == "memory":
            raise MissingDependency("torch", "lab", "measuring memory")
        done.append(name)
        curve = np.array([0.0, 1.0]), np.array([0.0, 1.0])
        figures = (
            Figure(name, "curves", "roc", {"a": curve}),
            Figure("m", "map", "map", {"a": curve}),
        )
        tables = (
            Table("t", f"{name} here", ("method", "area"), (("a", 0.25),)),
            Table("p", f"{name} there", ("method", "area"), (("a", 0.5),), source="paper"),
        )
        return Study(name, name.title(), tables, figures, text=f"What is {name}?")

    monkeypatch.setattr(studies, "run", run)
    monkeypatch.setattr(kitti_paper, "answers_of", lambda *_: {})
    monkeypatch.setattr(kitti_paper, "study", lambda _: run("kitti-paper", None))
    (tmp_path / "kitti" / "keyframes").mkdir(parents=True)
    options = "--out", tmp_path / "out", "--report", tmp_path / "report"
    evaluate("all", "--kitti", tmp_path / "kitti", *options)
    told = capsys.readouterr()
    assert "measuring memory needs torch" in " ".join(told.err.split())
    assert done == [*(name for name in studies.STUDIES if name != "memory"), "kitti-paper"]
    page = (tmp_path / "report" / "REPORT.md").read_text("utf-8")
    pictures = [f"{name}.png" for name in done]
    assert sorted(file.name for file in tmp_path.glob("report/*.png")) == sorted(pictures)
    for name in done:  # one page: question, measured and published figures, picture
        parts = [f"## {name.title()}", f"What is {name}?", f"### {name} here", "| a | 0.25 |"]
        parts += [f"### {name} there (published)", "| a | 0.5 |", f"({name}.png)"]
        places = [page.index(part, page.index(parts[0])) for part in parts]
        assert places == sorted(places)


def stored(out: Path) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = json.loads((out / "own" / "study.json").read_text())["tables"]
    return found


@pytest.fixture(scope="module")
def recordings(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two simulated sessions, written as a user's own recordings would be."""
    pytest.importorskip("embreex", reason="the simulation needs embreex")
    folder = tmp_path_factory.mktemp("recordings")
    for name, session in TINY.sessions().items():
        record(session, folder / name, workers=1)
    return folder


@pytest.mark.slow
def test_two_recordings_are_mapped_localized_and_reported(
    recordings: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pair = (recordings / "map", recordings / "test_0")
    more = ("--methods", "geo", "--workers", 1, "--report", tmp_path / "report")
    evaluate("localization", *pair, "--out", tmp_path / "out", *more)
    assert "own query" in (tmp_path / "report" / "REPORT.md").read_text("utf-8")
    printed = capsys.readouterr().out
    assert "our estimator" in printed and "PROSAC" in printed and "own query" in printed
    tables = stored(tmp_path / "out")
    (row,) = tables[0]["rows"]
    assert row[0] == "own query" and row[3] == 8 and isinstance(row[5], int) and row[5] >= 4
    assert not any(table["source"] == "paper" for table in tables)
    page = (tmp_path / "out" / "own" / "REPORT.md").read_text("utf-8")
    assert "own query" in page and ".png)" in page


@pytest.mark.slow
def test_without_truth_answers_are_counted_but_not_judged(recordings: Path, tmp_path: Path) -> None:
    query = tmp_path / "query"
    shutil.copytree(recordings / "test_0", query)
    (query / "poses.tum").unlink()
    out = tmp_path / "out"
    evaluate("localization", recordings / "map", query, "--out", out, "--methods", "geo")
    last = stored(out)[-1]
    details = dict(zip(last["columns"], last["rows"][0], strict=True))
    assert details["localized"] >= 4
    assert details["right"] is details["false"] is details["places"] is None
