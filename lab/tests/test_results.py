"""Stored results: pages show them as they are, and say where the code has changed since."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest
from segloc_lab.protocols.table import result as table_of
from segloc_lab.results import fingerprints as prints
from segloc_lab.results.pages import MARK, pages, stale, status, written
from segloc_lab.results.quotes import figure, unsaid
from segloc_lab.results.stamp import stamp
from segloc_lab.results.store import FOLDER, Origin, Result

from segloc.errors import DatasetError

STORED = sorted(FOLDER.glob("*.json"))
PAGE = "# A page\n\n<!-- begin result two -->\nold\n<!-- end result two -->\n"


@pytest.fixture
def clone(tmp_path: Path) -> Path:
    """A tree of files where the stages are looked for."""
    for paths in prints.STAGES.values():
        for path in paths:
            folder = tmp_path / path
            file = folder if folder.suffix else folder / "code.py"
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_text('"""What it does."""\nx = 1  # why\n')
    (tmp_path / "src/segloc/weights/dsm.safetensors").write_bytes(b"numbers")
    return tmp_path


def result(root: Path) -> Result:
    produced = prints.fingerprints(("pose", "matching"), ("dsm", "dsm-fq", "geo"), root)
    rows = (("dsm", 41, 0.25), ("geo", None, "0 of 3"))
    return Result("two", "a command", "abc", produced, ("method", "n", "share"), rows, "A note.")


def test_a_result_is_read_as_it_was_written(tmp_path: Path, clone: Path) -> None:
    each = result(clone)
    assert Result.load(each.save(tmp_path / "kept")) == each
    with pytest.raises(ValueError, match="two"):
        replace(each, rows=(("dsm", 1),))


def test_words_about_code_change_nothing_and_code_does(clone: Path) -> None:
    each, pose = result(clone), clone / "src/segloc/proposals/pose.py"
    assert "nothing" in status(each, clone)
    pose.write_text('"""Other words."""\n\n# and a comment\nx   =  1\n')
    assert "nothing" in status(each, clone)
    pose.write_text('"""What it does."""\nx = 2  # why\n')
    assert "Outdated" in status(each, clone) and "changed since: pose." in status(each, clone)
    (clone / "src/segloc/weights/dsm.safetensors").write_bytes(b"others")
    assert "weights of dsm, weights of dsm-fq" in status(each, clone)


def test_a_page_is_filled_and_found_stale(tmp_path: Path, clone: Path) -> None:
    result(clone).save(tmp_path)
    assert stale(PAGE, tmp_path) == ["two"]
    page = written(PAGE, tmp_path, clone)
    assert "| geo | - | 0 of 3 |" in page and "    a command" in page and "A note." in page
    (clone / "src/segloc/proposals/pose.py").write_text("x = 3\n")
    marked = written(page, tmp_path, clone)
    assert "Outdated" in marked and "Outdated" not in page
    assert stale(page, tmp_path) == stale(marked, tmp_path) == []
    assert stale(page.replace("| 41 |", "| 42 |"), tmp_path) == ["two"]


def test_rows_in_which_another_method_is_ahead_are_bold(tmp_path: Path, clone: Path) -> None:
    rows = (("town", 0.5, 0.75), ("park", "7 (1)", 7), ("meadow", "12", "9 (3)"))
    replace(result(clone), columns=("set", "geo", "profile"), rows=rows).save(tmp_path)
    page = PAGE.replace("result two -->\nold", "result two, bold where profile is behind -->\nold")
    filled = written(page, tmp_path, clone)
    assert "| park | 7 (1) | 7 |" in filled and "| town | 0.5 | 0.75 |" in filled
    assert "| **meadow** | **12** | **9 (3)** |" in filled and "ahead of `profile`" in filled
    assert stale(filled, tmp_path) == []


def test_an_old_table_stays_until_its_result_is_stored(tmp_path: Path, clone: Path) -> None:
    old = PAGE.replace("old", f"{MARK}\n\n| method |")
    assert written(old, tmp_path, clone) == old and not stale(old, tmp_path)
    with pytest.raises(FileNotFoundError):
        written(PAGE, tmp_path, clone)
    result(clone).save(tmp_path)
    assert MARK not in written(old, tmp_path, clone) and stale(old, tmp_path) == ["two"]


def test_a_table_of_several_runs_is_of_one_code(tmp_path: Path) -> None:
    runs = [tmp_path / name for name in ("sparse-dsm", "accumulated-geo")]
    summary = {
        "queries": 9, "within_coverage": 4, "within_coverage_correct": 4, "false": 0,
        "translation_error_m": {"median": 0.7, "p95": 1.0}, "rotation_error_deg": {"median": None},
    }  # fmt: skip
    for run in runs:
        run.mkdir()
        (run / "summary.json").write_text(json.dumps(summary))
    with pytest.raises(DatasetError, match="nothing says what code"):
        table_of(runs)
    stamp(runs[0], ["dsm"])
    stamp(runs[1], ["geo"])
    found = table_of(runs)
    assert [cells[0] for cells in found.rows] == ["accumulated-geo", "sparse-dsm"]
    assert found.rows[0][1:] == (9, "4 of 4 (51 to 100 %)", 0, "0.70 / 1.00", "-")
    assert found.produced_by == Origin.now(("dsm",)).produced_by and "geo" in found.command
    other = json.loads((runs[0] / "produced.json").read_text())
    other["produced_by"]["pose"] = "another"
    (runs[0] / "produced.json").write_text(json.dumps(other))
    with pytest.raises(DatasetError, match="another pose"):
        table_of(runs)


def test_the_documentation_shows_what_is_stored() -> None:
    shown = [path for path in pages() for _ in stale(path.read_text("utf-8"))]
    assert not shown, "run `python docs/results.py`"
    assert not list(unsaid())


def test_sentences_quote_what_is_stored(tmp_path: Path, clone: Path) -> None:
    rows = (("town", "all", "8 of 9 (5 to 10 %)", 12345), ("park", "all", "1 of 2", 5))
    columns = ("set", "by", "found", "queries")
    replace(result(clone), columns=columns, rows=rows).save(tmp_path)
    assert str(figure("two", "*", "found", tmp_path)) == "9 of 11"
    assert figure("two", "town | all", "queries", tmp_path).n == "12 345"
    assert figure("two", "park", "found", tmp_path).word == "one"
    for row, column in (("meadow", "found"), ("town", "lost"), ("town", "by")):
        with pytest.raises(DatasetError, match="two"):
            figure("two", row, column, tmp_path)
    quotes, page = tmp_path / "quotes.yaml", tmp_path / "page.md"
    quotes.write_text('page.md: [{text: "{n} were found", n: [two, "*", found]}]')
    page.write_text("Of all, 9 of\n11 were found.")
    assert not list(unsaid(quotes, tmp_path, tmp_path))
    page.write_text("8 of 11 were found.")
    assert list(unsaid(quotes, tmp_path, tmp_path)) == [("page.md", "9 of 11 were found")]


@pytest.mark.parametrize("path", STORED, ids=lambda path: path.stem)
def test_what_is_stored_can_be_read_and_says_what_made_it(path: Path) -> None:
    each = Result.load(path)
    assert each.name == path.stem and each.rows and each.command and each.produced_by
    known = set(prints.STAGES)
    assert all(name in known or name.startswith("weights of ") for name in each.produced_by)


def test_a_change_that_leaves_a_result_as_it_is_does_not_outdate_it(clone: Path) -> None:
    each = result(clone)
    pose = clone / prints.STAGES["pose"][0]
    before = each.produced_by["pose"]
    pose.write_text("x = 2\n")
    after = prints.fingerprints(("pose",), (), clone)["pose"]
    entry = f"""
- stages: {{pose: [{before}, {after}]}}
  concerns: maps on two sheets
  may_change: [RESULT]
  checked: All answers are the same.
"""
    named = clone / "docs" / "unaffected.yaml"
    named.parent.mkdir(exist_ok=True)
    named.write_text(entry.replace("RESULT", "another"))
    assert "nothing that it depends on has changed" in status(each, clone)
    assert "but what concerns only maps on two sheets.*" in status(each, clone)
    named.write_text(entry.replace("RESULT", each.name))
    assert "Outdated" in status(each, clone)
    named.write_text(entry.replace("RESULT", "another"))
    pose.write_text("x = 3\n")
    assert "changed since: pose." in status(each, clone)
    last = prints.fingerprints(("pose",), (), clone)["pose"]
    second = f"- {{stages: {{pose: [{after}, {last}]}}, concerns: ice, may_change: [], checked: x}}"
    named.write_text(entry.replace("RESULT", "another") + second)
    assert "but what concerns only maps on two sheets and ice.*" in status(each, clone)
