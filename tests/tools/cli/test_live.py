"""``segloc live`` on a plaza in a folder, and what it makes of wrong input."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from samples.plaza import Plaza, PlazaSequence
from samples.walk import run

from segloc import Config, build_map, geometry
from segloc.live.core import RECORD
from segloc.live.replay import SUMMARY
from segloc.tools.io import Trajectory, read_trajectory, write_tum

SCANS = 14


@pytest.fixture(scope="module")
def place(plaza: Plaza, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A map, and a drive with its true poses, and with odometry in a frame of its own."""
    root = tmp_path_factory.mktemp("place")
    build_map(PlazaSequence(plaza), Config.preset("geo")).save(root / "plaza.segmap")
    (root / "drive").mkdir()
    poses = np.stack(
        [geometry.yaw_transform(0.02 * k, (-14 + 2 * k, 1, 1.8)) for k in range(SCANS)]
    )
    for k, T in enumerate(poses):
        np.save(root / "drive" / f"{k:04d}.npy", plaza.scan(T, posed=False, seed=k).points)
    numbers = np.arange(SCANS, dtype=float)
    write_tum(root / "truth.tum", Trajectory(numbers, poses))
    elsewhere = geometry.yaw_transform(2.0, (300.0, -20.0, 5.0)) @ poses
    write_tum(root / "odometry.tum", Trajectory(numbers, elsewhere))
    return root


def followed(place: Path, out: Path, *more: Any) -> dict[str, Any]:
    options = ["--map", place / "plaza.segmap", "--truth", place / "truth.tum", "--out", out]
    assert run("live", place / "drive", "--every", 4, *options, *more) == 0
    facts: dict[str, Any] = json.loads((out / "summary.json").read_text())
    return facts


@pytest.mark.slow
def test_a_recording_is_followed_whatever_frame_its_odometry_is_in(
    place: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    found_poses = []
    for name in ("odometry", "truth"):
        out = tmp_path / name
        facts = followed(place, out, "--poses", place / f"{name}.tum")
        assert (facts["scans"], facts["dropped"], facts["false_m"]) == (SCANS, 0, 0.0)
        assert facts["localized_share"] == 1.0 and facts["first_fix_m"] == 0.0
        assert facts["latency_ms"]["p50"] > 0 and facts["query_ms"]["p99"] > 0
        records = [json.loads(line) for line in (out / "states.jsonl").read_text().splitlines()]
        assert [r["index"] for r in records] == list(range(SCANS))
        assert {r["state"] for r in records} == {"localized"}
        assert all(r.keys() == RECORD.keys() and r["correct"] is True for r in records)
        assert facts.keys() == SUMMARY.keys() | {"map_id"}
        found, truth = read_trajectory(out / "poses.tum"), read_trajectory(place / "truth.tum")
        assert np.abs(found.poses - truth.poses).max() < 0.3
        found_poses.append(np.array([r["T_map_base"] for r in records]))
    assert np.allclose(*found_poses, atol=0.1)  # where the odometry begins tells nothing
    printed, output = capsys.readouterr()
    assert "first fix after" in printed and "false track" in printed
    assert output.count("localized at -1") == 2


@pytest.mark.slow
def test_what_is_false_is_counted_along_the_truth(place: Path, tmp_path: Path) -> None:
    truth = read_trajectory(place / "truth.tum")
    short = truth.poses.copy()
    short[:, :3, 3] *= 0.95  # odometry of less way
    write_tum(tmp_path / "short.tum", Trajectory(truth.stamps, short))
    aside = geometry.yaw_transform(0.0, (0.0, 9.0, 0.0)) @ truth.poses
    write_tum(tmp_path / "aside.tum", Trajectory(truth.stamps, aside))
    options = ["--poses", tmp_path / "short.tum", "--truth", tmp_path / "aside.tum"]
    facts = followed(place, tmp_path / "out", *options)
    way = geometry.distance_travelled(aside)[-1]
    assert facts["localized_share"] == 1.0 and facts["travelled_m"] < 0.96 * way
    assert facts["false_m"] == pytest.approx(way, abs=0.01)


@pytest.mark.slow
def test_how_often_odometry_from_the_scans_is_lost_is_noted(
    place: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    whole = place / "drive"
    (carried := tmp_path / "drive").mkdir()
    names = sorted(path.name for path in whole.iterdir())
    for number, name in enumerate([*names[:4], *names[-4:]]):
        (carried / f"{number:04d}{Path(name).suffix}").symlink_to(whole / name)
    facts = followed(place, tmp_path / "whole", "--odometry")
    assert facts["jumps"] == 0 and "was lost" not in capsys.readouterr().err
    options = ["--map", place / "plaza.segmap", "--out", tmp_path / "out", "--odometry"]
    assert run("live", carried, *options) == 0
    assert "odometry from the scans was lost 1 time: record" in capsys.readouterr().err


@pytest.mark.slow
def test_in_real_time_it_is_the_code_of_a_robot(place: Path, tmp_path: Path) -> None:
    facts = followed(place, tmp_path / "out", "--poses", place / "odometry.tum", "--rate", 10)
    assert facts["scans"] + facts["dropped"] == SCANS and facts["scans"] > 0
    assert facts["false_m"] == 0.0 and facts["states"]["localized"] > 0


def test_what_cannot_be_followed_is_refused(
    place: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    options = ["--map", place / "plaza.segmap", "--out", tmp_path / "out"]
    for more, expected in (
        (["--poses", place / "truth.tum", "--odometry"], "exclude each other"),
        (["--poses", place / "nowhere.tum"], "no such file"),
    ):
        capsys.readouterr()
        assert run("live", place / "drive", *options, *more) == 1
        error = capsys.readouterr().err
        assert error.startswith("segloc: error: ") and expected in error and error.count("\n") == 1
        assert not (tmp_path / "out").exists()
