"""``segloc evaluate`` as a user meets it: two recordings, and the report."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from samples.tiny_suite import TINY
from segloc_lab.evaluation.report.study import Figure, Study, Table
from segloc_lab.simulation import record

from segloc.cli import app
from segloc.errors import ConfigError, DatasetError, SeglocError


def evaluate(*arguments: object) -> None:
    app(["evaluate", *map(str, arguments)], standalone_mode=False)


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
    evaluate("localization", *pair, "--out", tmp_path / "out", "--methods", "geo", "--workers", 1)
    printed = capsys.readouterr().out
    assert "our estimator" in printed and "PROSAC" in printed and "own query" in printed
    study = Study.load(tmp_path / "out" / "own")
    (row,) = study.tables[0].rows
    assert row[0] == "own query" and row[3] == 8 and isinstance(row[5], int) and row[5] >= 4
    assert not any(table.source == "paper" for table in study.tables)
    page = (tmp_path / "out" / "report.html").read_text("utf-8")
    assert "own query" in page and "<svg" in page
    names = {path.name for path in (tmp_path / "out" / "tables").iterdir()}
    assert {"own-details.csv", "own-details.tex"} <= names


@pytest.mark.slow
def test_without_truth_answers_are_counted_but_not_judged(recordings: Path, tmp_path: Path) -> None:
    query = tmp_path / "query"
    shutil.copytree(recordings / "test_0", query)
    (query / "poses.tum").unlink()
    out = tmp_path / "out"
    evaluate("localization", recordings / "map", query, "--out", out, "--methods", "geo")
    study = Study.load(out / "own")
    details = dict(zip(study.tables[-1].columns, study.tables[-1].rows[0], strict=True))
    assert details["localized"] >= 4  # type: ignore[operator]
    assert details["right"] is details["false"] is details["places"] is None


@pytest.mark.parametrize(
    ("arguments", "error", "line"),
    [
        (("localization", "a", "b"), DatasetError, "a: no such file or folder"),
        (("localization", "a", "b", "--every", "0"), ConfigError, "--every must be a positive"),
        (("report",), SeglocError, "holds no study; run one first"),
    ],
)
def test_what_the_user_can_mend_is_one_line(
    arguments: tuple[str, ...], error: type[Exception], line: str, tmp_path: Path
) -> None:
    with pytest.raises(error, match=line):
        evaluate(*arguments, "--out", tmp_path / "out")


@pytest.mark.slow
def test_errors_end_with_status_one(tmp_path: Path) -> None:
    (tmp_path / "out").write_text("a file")
    code = "import sys; from segloc.cli import main; main()"
    command = [sys.executable, "-c", code, "evaluate", "report", "--out", str(tmp_path / "out")]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 1 and done.stdout == ""
    assert len(done.stderr.strip().splitlines()) == 1
    assert done.stderr.startswith("segloc: error: ") and "is not a folder" in done.stderr


@pytest.mark.slow
def test_the_report_is_made_again_of_what_is_stored(tmp_path: Path) -> None:
    curve = (np.arange(3.0), np.arange(3.0))
    figure = Figure("f", "F", "lines", {"a": curve})
    table = Table("t", "T", ("a", "b"), (("x", 1),))
    Study("roc", "ROC", (table,), (figure,)).save(tmp_path / "roc")
    evaluate("report", "--out", tmp_path)
    first = (tmp_path / "report.html").read_bytes()
    (tmp_path / "report.html").unlink()
    evaluate("report", "--out", tmp_path)
    assert (tmp_path / "report.html").read_bytes() == first
    text = json.loads((tmp_path / "roc" / "study.json").read_text())
    text["format"] = 99
    (tmp_path / "roc" / "study.json").write_text(json.dumps(text))
    with pytest.raises(SeglocError, match=r"study\.json: damaged: format 99"):
        evaluate("report", "--out", tmp_path)
