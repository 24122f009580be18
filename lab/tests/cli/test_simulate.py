"""``segloc simulate``, end to end in small worlds, and what it makes of wrong input."""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("embreex", reason="the simulator needs the extra 'sim'")

from segloc_lab.simulation import suites
from segloc_lab.simulation.suites import SIX, SUMMER

from segloc import cli
from segloc.datasets import open_sequence
from segloc.io import read_trajectory

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
    options = [*TINY, "--objects", "--sessions", "3", "--season", "winter", "--replaced", "0.3"]
    assert segloc(monkeypatch, "simulate", "town", "--out", out, *options) == 0
    assert "sessions of town-0: 3, in" in capsys.readouterr().out
    facts = json.loads((out / "scene.json").read_text())
    assert (facts["scene"], facts["sensor"], facts["seed"]) == ("town", "hdl64e", 0)
    assert facts["version"]
    conditions = [session["conditions"] for session in facts["sessions"]]
    assert [c["foliage"] for c in conditions] == [1.0, 0.0, 0.0]
    assert [c["replaced"] for c in conditions] == [0.0, 0.3, 0.3]
    kinds = json.loads((out / "kinds.json").read_text())
    for k in range(3):
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
def test_a_storey_is_simulated_with_a_sensor_that_tilts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "third"
    options = ["--size", "40", "--length", "24", "--thin", "24", "--workers", "1"]
    options += ["--sessions", "1", "--sensor", "mid360", "--platform", "handheld"]
    tilted = [*options, "--tilt", "0", "20", "--storey", "3"]
    assert segloc(monkeypatch, "simulate", "building", "--out", out, *tilted) == 0
    facts = json.loads((out / "scene.json").read_text())
    assert (facts["storey"], facts["tilt_deg"]) == (3, [0.0, 20.0])
    assert segloc(monkeypatch, "simulate", "building", "--out", tmp_path / "low", *options) == 0
    high, low = (
        read_trajectory(folder / "session_0" / "poses.tum").poses
        for folder in (out, tmp_path / "low")
    )
    assert 8.5 < (high[:, 2, 3] - low[:, 2, 3]).min() < 12.0
    np.testing.assert_allclose(high[:, :2, 3], low[:, :2, 3], atol=1e-5)
    nod = low[:, :3, :3].transpose(0, 2, 1) @ high[:, :3, :3]
    np.testing.assert_allclose(nod[:, 0, 0], np.cos(np.radians(20.0)), atol=1e-5)


@pytest.mark.slow
def test_a_push_broom_sensor_is_gathered_to_swathes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("laspy")
    options = ["--size", "130", "--length", "40", "--sessions", "1", "--spacing", "0.5"]
    options += ["--sensor", "lms151", "--swathe", "15", "--format", "laz", "--workers", "1"]
    assert segloc(monkeypatch, "simulate", "industrial", "--out", tmp_path, *options) == 0
    sequence = open_sequence(tmp_path / "session_0", "poses.tum")
    assert len(sequence) == 2
    assert np.ptp(sequence.scan(0).points, axis=0).min() > 2.0


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
        ([], "name either a scene or"),
        (["town", "--suite", "six"], "name either a scene or"),
        (["moon"], "the scene must be one of"),
        (["town", "--sensor", "sonar"], "--sensor must be one of"),
        (["town", "--platform", "boat"], "--platform must be one of"),
        (["town", "--tilt", "0", "9"], "--tilt goes with --platform"),
        (["town", "--size", "150", "--storey", "1"], "town-0: storey must be in 0..0, not 1"),
        (["town", "--season", "monsoon"], "--season must be one of summer, autumn, winter, spring"),
        (["town", "--season", "winter", "--foliage", "0.5"], "--season or --foliage, not both"),
        (["town", "--replaced", "2"], "replaced must be in 0..1, not 2.0"),
        (["town", "--thin", "0"], "factor must be at least 1"),
        (["town", "--format", "doc"], "--format must be one of npy"),
        (["town", "--size", "3"], "size_m must be in"),
        (["town", "--size", "150", "--length", "-4"], "--length must be a positive number"),
        (["town", "--size", "150", "--spacing", "0"], "spacing_m must be positive"),
        (["town", "--sessions", "1", "--season", "monsoon"], "--season must be one of"),
        (["town", "--sessions", "1", "--foliage", "7"], "foliage must be in 0..1, not 7.0"),
        (["town", "--objects", "--swathe", "30"], "--objects goes with single scans"),
        (["town", "--skew", "--swathe", "30"], "--skew goes with single scans"),
        (["--suite", "six", "--sensor", "vlp16"], "--sensor cannot be chosen with --suite"),
        (["--suite", "six", "--objects"], "--objects cannot be chosen with --suite"),
        (["--suite", "seven"], "--suite must be one of six"),
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
