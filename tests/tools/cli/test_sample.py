"""``segloc sample``: from nothing to answers."""

from __future__ import annotations

from pathlib import Path

import pytest
from samples.source import PROJECT
from samples.walk import run


@pytest.mark.slow
def test_the_commands_that_it_prints_are_those_of_the_quick_start(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Which tests/docs/test_documents_run.py runs."""
    monkeypatch.chdir(tmp_path)
    assert run("sample", "--out", "sample") == 0
    commands = [line for line in capsys.readouterr().out.splitlines() if line.startswith("segloc ")]
    page = (PROJECT / "docs" / "tutorials" / "first-map.md").read_text("utf-8").replace("\\\n", " ")
    documented = {" ".join(line.split("  #")[0].split()) for line in page.splitlines()}
    assert len(commands) > 4 and set(commands) <= documented
    names = {path.name for path in Path("sample").iterdir()}
    assert {"monday", "tuesday", "elsewhere.npy"} <= names


def test_a_file_in_the_way_is_refused_before_anything_is_written(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "sample").write_text("mine")
    assert run("sample", "--out", tmp_path / "sample") == 1
    assert capsys.readouterr().err.startswith("segloc: error: ")
    assert (tmp_path / "sample").read_text() == "mine"
