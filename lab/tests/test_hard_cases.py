"""Tables of the protocols of hard cases, from what their runs keep."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from segloc_lab.calibration import reliability
from segloc_lab.protocols import change, simulation_queries, wrong_maps
from segloc_lab.protocols.simulation_queries import scenarios
from segloc_lab.recordings import kept
from segloc_lab.report import keep
from segloc_lab.simulation import Conditions, building, simulate_sessions, vlp16


def _set(method: str, right: list[bool], **values: object) -> dict[str, object]:
    told = {"world": "forest", "clouds": "single", "sensor": "vlp16", "map": "its own"}
    return {**told, "method": method, "way": change.ALONE, "right": right, "false": 0, **values}


def test_methods_stand_side_by_side_with_the_best_of_the_others() -> None:
    there, back = [True] * 8, [True, True, False, False]
    entries = [_set("profile", there), _set("geo", [False] * 8), _set("nsm", [True] + [False] * 7)]
    entries += [_set("profile", back, false=1), _set("geo", back), _set("nsm", [False] * 4)]
    columns, (row,) = change.table(entries)
    assert columns[5:] == (
        "queries",
        "profile",
        "geo",
        "nsm",
        "p, profile and the best other",
        "false",
    )
    # Eight queries that only the first method answers, none that only `geo` does: 2 / 2^8.
    assert row[5:] == (12, 10, 2, 1, 0.008, 1)


def test_one_method_has_an_interval(tmp_path: Path) -> None:
    keep(tmp_path / "a.jsonl", _set("profile", [True] * 19 + [False]))
    columns, (row,) = change.table(change.entries(tmp_path / "a.jsonl"))
    assert columns[-2:] == ("profile", "false") and row[-2:] == ("19 of 20 (76 to 99 %)", 0)
    change.report(change.entries(tmp_path / "a.jsonl"), tmp_path / "report")
    (table,) = json.loads((tmp_path / "report" / "rows.json").read_text())
    assert table["rows"] == [list(row)]


def test_what_is_false_in_the_mirror_image_of_a_place_is_told_apart(tmp_path: Path) -> None:
    counts = {"accumulated": 20, "single": 20, "thinned": 20}
    own = {"own, right": 50, "own, refused": 10, "half, right": 59, "half, false": 1}
    false = [{"map": -1}, {"map": 0}, {"map": 1}]
    offices = {"world": "offices 1", "maps": 2, "counts": counts, "own": own, "false": false}
    rows = {row[0]: row for row in wrong_maps.table([offices])}
    assert rows["offices"][1:] == (30, 1, 30, 1, "50 of 60", 0, "59 of 60", 1)
    assert rows["town"][1:] == (0, 0, 0, 0, "0 of 0", 0, "0 of 0", 0)
    halls = {**offices, "world": "warehouse 2"}  # which may be its own mirror image
    wrong_maps.report([offices, halls], tmp_path / "report")
    (table,) = json.loads((tmp_path / "report" / "rows.json").read_text())
    assert table["rows"][-1][1:5] == [90, 3, 30, 1]
    assert "3 false of 90 elsewhere" in (tmp_path / "report" / "REPORT.md").read_text()


@pytest.mark.parametrize(("right", "cause"), [(True, None), (False, "1 candidate")])
def test_what_simulated_queries_lack_is_told(right: bool, cause: str | None) -> None:
    name = next(iter(scenarios()))
    answer = {"right": right, "localized": right, "reason": "", "where": "", "ms": 40.0}
    missing = {} if right else {"cause": "candidate"}
    (row,) = simulation_queries.table({f"{name}/11": [answer | missing]})
    assert row[:2] == (name, scenarios()[name].expected) and row[-1] == cause
    assert str(row[2]).startswith("1 of 1" if right else "0 of 1") and row[3] == 0


def test_reliability_counts_poses_by_their_confidence() -> None:
    answers = [{"confidence": p, "best": best} for p, best in ((0.99, "found"), (0.97, "false"))]
    answers += [{"confidence": 0.01, "best": "false"}, {"confidence": 0.0, "best": None}]
    rows = reliability.table({"a": reliability.judged(answers), "b": []})
    assert rows[0][:2] == ("0.00 to 0.05", "0 of 1 (0 to 79 %)")
    assert rows[-2] == ("0.95 to 1.00", "1 of 2 (9 to 91 %)", "0 of 0")
    assert rows[-1] == ("Brier score", round((0.01**2 + 0.97**2 + 0.01**2) / 3, 4), None)


def test_scans_of_worlds_that_differ_are_kept_apart(tmp_path: Path) -> None:
    pytest.importorskip("embreex", reason="simulation needs the extra sim")
    worlds = [building(4, size_m=40.0, storeys=2, differ=differ) for differ in (0.0, 1.0)]
    alike, own = (
        simulate_sessions(world, vlp16(60), [Conditions()], length_m=20.0, storey=1)[0]
        for world in worlds
    )
    np.testing.assert_array_equal(alike.truth, own.truth)
    folders = {kept(drive, tmp_path).folder for drive in (alike, own)}
    assert len(folders) == 2
    assert kept(alike, tmp_path).folder in folders
