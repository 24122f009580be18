"""``segloc simulate``, end to end in small worlds, and what it makes of wrong input."""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("embreex", reason="the simulator needs segloc-lab")

from segloc_lab.simulation import suites
from segloc_lab.simulation.suites import SIX, SUMMER

from segloc.tools import cli
from segloc.tools.datasets import open_sequence
from segloc.tools.io import read_trajectory

TINY = ["--size", "130", "--length", "24", "--thin", "24", "--workers", "1"]


def segloc(monkeypatch: pytest.MonkeyPatch, *arguments: str | Path) -> int:
    monkeypatch.setattr(sys, "argv", ["segloc", *map(str, arguments)])
    with pytest.raises(SystemExit) as left:
        cli.main()
    return int(left.value.code or 0)


@pytest.mark.slow
def test_sessions_are_recorded_with_poses_and_objects(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "runs"
    options = [*TINY, "--objects", "--sessions", "2", "--season", "winter", "--replaced", "0.3"]
    assert segloc(monkeypatch, "simulate", "town", "--out", out, *options) == 0
    assert "sessions of town-0: 2, in" in capsys.readouterr().out
    facts = json.loads((out / "scene.json").read_text())
    assert (facts["scene"], facts["sensor"], facts["seed"]) == ("town", "hdl64e", 0)
    assert facts["version"]
    conditions = [session["conditions"] for session in facts["sessions"]]
    assert [c["foliage"] for c in conditions] == [1.0, 0.0]
    assert [c["replaced"] for c in conditions] == [0.0, 0.3]
    kinds = json.loads((out / "kinds.json").read_text())
    for k in range(2):
        folder = out / f"session_{k}"
        sequence = open_sequence(folder, "odometry.tum")
        truth = read_trajectory(folder / "poses.tum")
        assert len(sequence) == len(truth.poses) == 12
        assert not np.array_equal(sequence.poses, truth.poses)
        ids = np.load(folder / "objects" / "000007.npy")
        assert ids.shape == (len(sequence.scan(7).points),)
        assert {str(number) for number in np.unique(ids) if number >= 0} <= kinds.keys()
    assert {"ground", "house", "car"} <= set(kinds.values())
    houses = {int(number) for number, kind in kinds.items() if kind == "house"}
    assert houses & set(np.unique(ids).tolist())


@pytest.mark.slow
def test_a_suite_is_a_folder_a_set(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    small = {"small": 150.0}
    sets = tuple(
        replace(each, size_m=small, share={"small": 0.001}, tests=(SUMMER,), spacing_m=6.0)
        for each in (SIX[2], replace(SIX[1], sensor="vlp16"))
    )
    monkeypatch.setitem(suites.SUITES, "six", sets)
    arguments = ("simulate", "--suite", "six", "--out", tmp_path, "--workers", "1")
    assert segloc(monkeypatch, *arguments) == 0
    assert {path.name for path in tmp_path.iterdir()} == {"fire_college", "kitti"}
    facts = json.loads((tmp_path / "fire_college" / "scene.json").read_text())
    assert facts["published"] == {"length_m": 190, "clouds": 169}
    assert facts["share_of_length"] == pytest.approx(90 / 190)
    for session, clouds in facts["clouds"].items():
        assert len(open_sequence(tmp_path / "fire_college" / session, "poses.tum")) == clouds


@pytest.mark.parametrize(
    ("arguments", "fault"),
    [
        ([], "either a scene or"),
        (["town", "--suite", "six"], "either a scene or"),
        (["moon"], "the scene must be one of"),
        (["town", "--sensor", "sonar"], "--sensor must be one of"),
        (["town", "--tilt", "0", "9"], "--tilt needs --platform"),
        (["town", "--size", "150", "--storey", "1"], "town-0: storey must be in 0..0, not 1"),
        (["town", "--season", "winter", "--foliage", "0.5"], "--season and --foliage"),
        (["town", "--replaced", "2"], "replaced must be in 0..1, not 2.0"),
        (["town", "--thin", "0"], "factor must be at least 1"),
        (["town", "--size", "150", "--length", "-4"], "--length must be a positive number"),
        (["town", "--size", "150", "--spacing", "0"], "spacing_m must be positive"),
        (["town", "--sessions", "1", "--season", "monsoon"], "--season must be one of"),
        (["town", "--objects", "--swathe", "30"], "--objects needs single scans"),
        (["--suite", "six", "--sensor", "vlp16"], "--sensor is fixed by --suite"),
        (["--suite", "six", "--scale", "huge"], "scale must be one of small, full"),
    ],
)
def test_what_cannot_be_simulated_is_one_line(
    arguments: list[str],
    fault: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    out = tmp_path / "out"
    assert segloc(monkeypatch, "simulate", *arguments, "--out", out) == 1
    line = capsys.readouterr().err
    assert line.startswith("segloc: error: ")
    assert fault in line
    assert line.count("\n") == 1
    assert not out.exists()


def test_plans_are_written_beside_buildings(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("trimesh")
    from segloc.tools.io.meshes import read_plan

    out, size = tmp_path / "runs", ["--size", "40", *TINY[2:]]
    told = ("--plan", "--sessions", "1", "--out", out, *size)
    assert segloc(monkeypatch, "simulate", "offices", *told) == 0
    plan, other = read_plan(out / "plan.stl"), read_plan(out / "plan_deviating.stl")
    low, high = plan.reshape(-1, 3).min(axis=0), plan.reshape(-1, 3).max(axis=0)
    poses = read_trajectory(out / "session_0" / "poses.tum").poses[:, :3, 3]
    assert (poses > low).all() and (poses < high).all()
    assert 0.8 * len(plan) < len(other) <= len(plan)
    assert segloc(monkeypatch, "simulate", "town", *told[:5], *TINY) == 1
    assert "only buildings have a plan" in capsys.readouterr().err
