"""Studies on disk, and the cache that computes nothing twice."""

from __future__ import annotations

import json
import os
from pathlib import Path

import numpy as np
import pytest
from segloc_lab.evaluation.study import Figure, Kind, Study, Table
from segloc_lab.parallel import in_parallel
from segloc_lab.studies.paper.workspace import Workspace

from segloc.errors import SeglocError


@pytest.mark.slow
def test_a_process_that_the_system_ends_is_one_clear_line() -> None:
    with pytest.raises(SeglocError, match=r"memory ran out: .*fewer workers"):
        list(in_parallel(os._exit, [1, 1], 2))


def study(rows: tuple[tuple[object, ...], ...] = (("a", 1, 2.5, None),)) -> Study:
    table = Table("counts", "Counts", ("name", "n", "m", "k"), rows, "A note.", "paper")
    curve = (np.arange(3.0), np.array([0.5, np.nan, 2.0]))
    figure = Figure("f", "F", "lines", {"x": curve, "ünï": curve}, "m", "s", "n")
    facts = {"seed": 3, "nested": {"a": np.float64(2), "b": float("inf")}, "out": Path("x")}
    return Study("demo", "Demo", (table,), (figure,), facts, "Text.")


def test_a_study_is_a_folder_of_markdown_data_and_pictures(tmp_path: Path) -> None:
    study().save(tmp_path)
    text = (tmp_path / "REPORT.md").read_text("utf-8")
    assert "## Counts (published)" in text and "| a | 1 | 2.5 | - |" in text
    assert "![F](f.png)" in text and (tmp_path / "f.png").read_bytes().startswith(b"\x89PNG")
    stored = json.loads((tmp_path / "study.json").read_text())
    assert stored["tables"][0]["rows"] == [["a", 1, 2.5, None]]
    assert stored["facts"] == {"seed": 3, "nested": {"a": 2.0, "b": None}, "out": "x"}


@pytest.mark.parametrize("kind", ["roc", "polar", "bars", "map", "lines"])
def test_every_kind_of_figure_is_drawn_also_empty(kind: Kind) -> None:
    empty, line = (np.empty(0), np.empty(0)), (np.arange(3.0), np.arange(3.0))
    for series in ({}, {"map": empty, "localized": empty}, {"localized": line, "b": line}):
        assert Figure("f", "F", kind, series).draw().startswith(b"\x89PNG")


# --- the cache ---------------------------------------------------------------------------------


def test_a_finished_part_is_not_computed_again(tmp_path: Path) -> None:
    workspace = Workspace(tmp_path)
    for settings, answer, expected in ((1, 42, 42), (1, 43, 42), (2, 44, 44)):
        assert workspace.cached_json("part", {"a": settings}, lambda a=answer: a) == expected


def test_a_damaged_part_is_computed_again_and_reported(tmp_path: Path) -> None:
    output: list[str] = []
    workspace = Workspace(tmp_path, say=output.append)
    workspace.cached_json("part", {}, lambda: [1.25])
    (part,) = tmp_path.glob("cache/part-*")
    part.write_text("[1.2")
    assert workspace.cached_json("part", {}, lambda: [1.25]) == [1.25]
    assert len(output) == 1 and "damaged, computed again" in output[0]
    assert workspace.cached_json("part", {}, lambda: [9]) == [1.25] and len(output) == 1


def test_a_part_that_fails_leaves_nothing(tmp_path: Path) -> None:
    def save(value: int, path: Path) -> None:
        path.mkdir()
        (path / "half").write_text("of it")
        raise OSError(28, "No space left on device")

    with pytest.raises(SeglocError, match="cannot be written: No space left"):
        Workspace(tmp_path).cached("part", {}, lambda: 1, save, lambda path: 1)
    assert not list((tmp_path / "cache").iterdir())


def test_a_part_may_be_a_folder(tmp_path: Path) -> None:
    def save(value: str, path: Path) -> None:
        (path / "deep").mkdir(parents=True)
        (path / "deep" / "file").write_text(value)

    def load(path: Path) -> str:
        return (path / "deep" / "file").read_text()

    workspace = Workspace(tmp_path)
    assert workspace.cached("part", {}, lambda: "x", save, load) == "x"
    assert workspace.cached("part", {}, lambda: "y", save, load) == "x"
    next(tmp_path.glob("cache/part-*/deep/file")).unlink()
    assert workspace.cached("part", {}, lambda: "y", save, load) == "y"
