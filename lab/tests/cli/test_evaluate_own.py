"""``segloc evaluate`` as a user meets it: two recordings, and the report."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import pytest
from samples.tiny_suite import TINY
from segloc_lab.simulation import record

from segloc.cli import app


def evaluate(*arguments: object) -> None:
    app(["evaluate", *map(str, arguments)], standalone_mode=False)


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
    evaluate("localization", *pair, "--out", tmp_path / "out", "--methods", "geo", "--workers", 1)
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
