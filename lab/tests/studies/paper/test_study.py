"""Studies on disk, the cache that computes nothing twice, and tables as CSV and LaTeX."""

from __future__ import annotations

import csv
import io
import json
import os
import signal
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from segloc_lab.evaluation.report.study import Figure, Study, Table, stored
from segloc_lab.evaluation.report.tables import escape, text, to_csv, to_latex
from segloc_lab.studies.paper.workspace import Workspace

from segloc.errors import ConfigError, SeglocError
from segloc.system.processes import in_parallel

CELLS = st.none() | st.integers(-(10**9), 10**9) | st.floats(allow_nan=False) | st.text()


def ended(task: int) -> int:
    """What a process does that the system ends."""
    if task:
        os.kill(os.getpid(), signal.SIGKILL)
    return task


@pytest.mark.slow
def test_a_process_that_the_system_ends_is_one_clear_line() -> None:
    with pytest.raises(SeglocError, match="memory ran out: try fewer workers"):
        list(in_parallel(ended, [0, 1], 2))


def study(rows: tuple[tuple[object, ...], ...] = (("a", 1, 2.5, None),)) -> Study:
    table = Table("counts", "Counts", ("name", "n", "m", "k"), rows, "A note.", "paper")
    curve = (np.arange(3.0), np.array([0.5, np.nan, 2.0]))
    figure = Figure("f", "F", "lines", {"x": curve, "ünï": curve}, "m", "s", "n")
    facts = {"seed": 3, "nested": {"a": np.float64(2), "b": float("inf")}, "out": Path("x")}
    return Study("demo", "Demo", (table,), (figure,), facts, "Text.")


def test_a_study_comes_back_as_it_was(tmp_path: Path) -> None:
    before = study()
    before.save(tmp_path / "demo")
    (after,) = stored(tmp_path, ("other", "demo"))
    assert after.tables == before.tables and after.text == before.text
    assert after.facts == {"seed": 3, "nested": {"a": 2.0, "b": None}, "out": "x"}
    (figure,) = after.figures
    assert list(figure.series) == ["x", "ünï"] and figure.kind == "lines"
    np.testing.assert_array_equal(figure.series["ünï"][1], [0.5, np.nan, 2.0])


@pytest.mark.parametrize("name", ["study.json", "arrays.npz"])
def test_a_damaged_study_is_named(tmp_path: Path, name: str) -> None:
    study().save(tmp_path)
    path = tmp_path / name
    path.write_bytes(path.read_bytes()[:-30])
    with pytest.raises(SeglocError, match=f"{name}: damaged"):
        Study.load(tmp_path)
    path.unlink()
    with pytest.raises(SeglocError, match=f"{name}: cannot be read"):
        Study.load(tmp_path)


def test_rows_are_as_long_as_the_header() -> None:
    with pytest.raises(ValueError, match="3 cells for 4 columns"):
        study((("a", 1, 2),))


# --- the cache ---------------------------------------------------------------------------------


def test_a_finished_part_is_not_computed_again(tmp_path: Path) -> None:
    calls: list[int] = []

    def compute() -> dict[str, int]:
        calls.append(1)
        return {"answer": 42}

    workspace = Workspace(tmp_path)
    for _ in range(2):
        assert workspace.cached_json("part", {"a": 1}, compute) == {"answer": 42}
    assert len(calls) == 1
    workspace.cached_json("part", {"a": 2}, compute)  # other settings are another part
    assert len(calls) == 2


def test_a_damaged_part_is_computed_again_and_said(tmp_path: Path) -> None:
    said: list[str] = []
    workspace = Workspace(tmp_path, say=said.append)
    workspace.cached_json("part", {}, lambda: [1.25])
    (data,) = tmp_path.glob("cache/part-*/data")
    data.write_text("[1.35]")  # still JSON: only the checksum tells
    assert workspace.cached_json("part", {}, lambda: [1.25]) == [1.25]
    assert len(said) == 1 and "damaged, computed again" in said[0]
    assert workspace.cached_json("part", {}, lambda: [9]) == [1.25] and len(said) == 1


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
    next(tmp_path.glob("cache/part-*/data/deep/file")).unlink()
    assert workspace.cached("part", {}, lambda: "y", save, load) == "y"


def test_a_workspace_knows_its_scales_and_suites(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="scale must be one of small, full, paper, not 'huge'"):
        Workspace(tmp_path, scale="huge")
    with pytest.raises(ConfigError, match="suite must be one of six"):
        _ = Workspace(tmp_path, suite="seven").sets
    facts = Workspace(tmp_path, command="segloc x").facts(1.26, {"geo": "geo-1"})
    assert facts["seconds"] == 1.3 and facts["fingerprints"] == {"geo": "geo-1"}
    json.dumps(facts)


# --- tables ------------------------------------------------------------------------------------


@given(st.lists(st.tuples(CELLS, CELLS), min_size=1, max_size=5))
def test_csv_brings_every_cell_back(rows: list[tuple[object, ...]]) -> None:
    table = Table("t", "T", ('a,"b"', "c"), tuple(rows))  # type: ignore[arg-type]
    header, *cells = csv.reader(io.StringIO(to_csv(table), newline=""))
    assert header == ['a,"b"', "c"]
    for row, read in zip(rows, cells, strict=True):
        for cell, back in zip(row, read, strict=True):
            if isinstance(cell, str) or cell is None:
                assert back == (cell or "")
            else:
                assert float(back) == cell


@given(st.text(alphabet="ab&%$#_{}~^\\<>|\"'"))
def test_latex_prints_what_was_written(plain: str) -> None:
    escaped = escape(plain)
    back = escaped
    for command, character in (
        ("textasciitilde", "~"), ("textasciicircum", "^"), ("textless", "<"), ("textgreater", ">"),
        ("textbar", "|"), ("textquotedbl", '"'), ("textbackslash", "\0"),
    ):  # fmt: skip
        back = back.replace(f"\\{command}{{}}", character)
    for character in "&%$#_{}":
        back = back.replace(f"\\{character}", character)
    assert back.replace("\0", "\\") == plain


def test_latex_lays_out_numbers_and_words() -> None:
    rows = (("dsm_fq", 1, 0.5, "9 (1)"), ("50 %", None, 12.0, "x & y"))
    latex = to_latex(study(rows).tables[0])
    assert r"\begin{tabular}{lrrl}" in latex
    assert r"dsm\_fq & 1 & 0.500 & 9 (1) \\" in latex
    assert r"50 \% & - & 12.0 & x \& y \\" in latex
    assert r"\caption{Counts (as published). A note.}" in latex


def test_cells_for_people() -> None:
    shown = [
        text(cell) for cell in (None, float("nan"), 0.0, 0.12345, 12.345, 1234.5, 7, "x", 9.99)
    ]
    assert shown == ["-", "-", "0", "0.123", "12.3", "1234", "7", "x", "9.99"]
