"""Studies of the paper, kept as results with the code that made them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from segloc_lab.evaluation.comparison_tables import total
from segloc_lab.evaluation.report.study import Study, Table
from segloc_lab.results.pages import status, table
from segloc_lab.results.store import Result
from segloc_lab.results.studies import kept
from segloc_lab.simulation.suites import SIX
from segloc_lab.studies.paper.workspace import Workspace


def _study(name: str, **facts: Any) -> Study:
    own = Table("roc_judges", "Ours", ("set", "dsm"), (("KITTI", 0.95), ("RobotCar", None)), "How.")
    theirs = Table("roc-paper", "Theirs", ("method",), (("DSM",),), source="paper")
    told = {"suite": "six", "scale": "full", "data": None, "fingerprints": {"dsm, kitti": "0"}}
    return Study(name, "A study", (own, theirs), facts=told | facts)


def test_own_tables_are_kept_and_published_ones_are_not(tmp_path: Path) -> None:
    (result,) = kept(_study("roc"))
    assert result.name == "paper-roc-judges"
    assert set(result.produced_by) >= {"descriptors", "training", "weights of dsm"}
    assert "verification" not in result.produced_by
    again = Result.load(result.save(tmp_path))
    assert again == result and "| RobotCar | - |" in table(again)
    assert "--suite six --scale full" in table(again) and "nothing" in status(again)


def test_other_sets_have_names_of_their_own() -> None:
    (result,) = kept(_study("localization", scale="small", data="kitti00"))
    assert result.name == "paper-roc-judges-six-small-kitti00"
    assert "--kitti DATA" in result.command and "verification" in result.produced_by


def test_sets_and_methods_can_be_measured_one_after_the_other(tmp_path: Path) -> None:
    def measured(
        only: list[str], rows: tuple[tuple[str | int, ...], ...], method: str = "dsm"
    ) -> Result:
        counts = Table("negatives", "False", ("set", "queries", method), (*rows, total(rows)))
        over_all = Table("differences", "", ("method", "right"), ((method, 3),))
        facts = {"suite": "six", "scale": "full", "data": None, "only": only}
        of = {"fingerprints": {method: "0"}}
        study = Study("localization", "", (counts, over_all), facts=facts | of)
        result, own = kept(study, tmp_path)
        result.save(tmp_path)
        assert own.rows == ((method, 3),) and f"--sets {','.join(only)} --store" in own.command
        return result

    names = [test.name for test in SIX]
    first = measured(names[1:3], ((names[1], 5, 1), (names[2], 7, 0)))
    assert f"--sets {names[1]},{names[2]} --store" in first.command
    second = measured([names[0], names[2]], ((names[0], 2, 0), (names[2], 8, 0)))
    assert second.rows == ((names[0], 2, 0), (names[1], 5, 1), (names[2], 8, 0), ("all", 15, 1))
    rest = measured(names[3:], tuple((name, 1, 0) for name in names[3:]))
    assert [row[0] for row in rest.rows] == [*names, "all"] and "--sets" not in rest.command
    both = measured(names[:1], ((names[0], 2, 0), ("kitti00 sparse", 4, 0)))
    assert [row[0] for row in both.rows] == [*names, "kitti00 sparse", "all"]
    other = measured(names[:1], ((names[0], 2, 6),), "nsm")
    assert (
        other.columns == ("set", "queries", "nsm", "dsm") and "weights of nsm" in other.produced_by
    )
    assert other.rows[:2] == ((names[0], 2, 6, 0), (names[1], 5, None, 1))
    path = tmp_path / f"{rest.name}.json"
    path.write_text(path.read_text().replace(rest.produced_by["pose"], "0123456789ab"))
    assert len(measured(names[:1], ((names[0], 2, 0),)).rows) == 2  # the others are of other code


def test_what_other_code_has_made_is_made_again(tmp_path: Path, monkeypatch: Any) -> None:
    made: list[str] = []

    def ask() -> str:
        def compute() -> str:
            made.append("x")
            return "x"

        def save(value: str, path: Path) -> None:
            path.write_text(value)

        return Workspace(tmp_path).cached("part", {}, compute, save, Path.read_text)

    assert ask() == ask() == "x" and len(made) == 1
    assert Workspace(tmp_path).find("part", {}, Path.read_text) == "x"
    code = "segloc_lab.studies.paper.workspace._code"
    monkeypatch.setattr(code, lambda: {"pose": "other"})
    assert Workspace(tmp_path).find("part", {}, Path.read_text) is None
    assert ask() == "x" and len(made) == 2
