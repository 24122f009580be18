"""Sessions with drifting poses brought into the frame of a map, and those that are refused."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from samples.drift import drifted
from samples.walk import as_folder, run

from segloc import Config, MapMismatch, Scan, SegmentMap, align_to_map, build_map, sample
from segloc.errors import ConfigError, DatasetError
from segloc.sample import SampleDrive
from segloc.tools.io import read_trajectory
from segloc.types import Float64

CONFIG = Config(threads=1)


def errors_m(poses: Float64, truth: Float64) -> Float64:
    found: Float64 = np.linalg.norm(poses[:, :3, 3] - truth[:, :3, 3], axis=1)
    return found


@pytest.fixture(scope="module")
def tuesday() -> SampleDrive:
    return sample.load("tuesday")


@pytest.fixture(scope="module")
def prior_map() -> SegmentMap:
    return build_map(sample.load("monday"), CONFIG)


@pytest.mark.slow
def test_another_day_is_brought_into_the_map(prior_map: SegmentMap, tuesday: SampleDrive) -> None:
    sessions = [drifted(tuesday, tuesday.truth, seed) for seed in (1, 2)]
    found = align_to_map(prior_map, sessions, CONFIG)
    for poses, odometry, unanchored_m in zip(
        found.poses, found.odometry, found.unanchored_m, strict=True
    ):
        errors = errors_m(poses, tuesday.truth)
        assert np.median(errors) < 0.3 and errors.max() < 1.0
        assert errors_m(odometry, tuesday.truth).min() > 10
        assert unanchored_m < 30


@pytest.mark.slow
def test_a_short_session_in_memory_is_brought_there_too(
    prior_map: SegmentMap, tuesday: SampleDrive
) -> None:
    moved = drifted(tuesday, tuesday.truth, 3)
    scans: list[Scan] = [moved.scan(i) for i in range(20, 26)]
    found = align_to_map(prior_map, [scans], CONFIG)
    assert np.median(errors_m(found.poses[0], tuesday.truth[20:26])) < 0.3


@pytest.mark.slow
def test_a_robot_that_stands_is_brought_there_too(
    prior_map: SegmentMap, tuesday: SampleDrive
) -> None:
    for count in (1, 4):
        scans = [Scan(tuesday.scan(20).points, T_odom_sensor=np.eye(4)) for _ in range(count)]
        found = align_to_map(prior_map, [scans], CONFIG)
        assert errors_m(found.poses[0], tuesday.truth[20:21]).max() < 0.3


@pytest.mark.slow
def test_what_does_not_meet_the_map_is_refused(prior_map: SegmentMap, tuesday: SampleDrive) -> None:
    other = sample.load("elsewhere")
    elsewhere = drifted(other, other.truth, 4)
    with pytest.raises(MapMismatch, match=r"session 1: elsewhere does not meet the map: 0 of 1. p"):
        align_to_map(prior_map, [drifted(tuesday, tuesday.truth, 1), elsewhere], CONFIG)
    with pytest.raises(DatasetError, match=r"session 0: memory: .*needs odometry"):
        align_to_map(prior_map, [[tuesday.scan(0).points]], CONFIG)
    with pytest.raises(ConfigError, match="no session"):
        align_to_map(prior_map, [], CONFIG)


@pytest.mark.slow
def test_the_commands(
    prior_map: SegmentMap,
    tuesday: SampleDrive,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    prior_map.save("site.segmap")
    before = Path("site.segmap").read_bytes()
    as_folder(tmp_path / "tuesday", drifted(tuesday, tuesday.truth, 1), "odometry.tum")
    other, truth = sample.load("elsewhere"), tuesday.truth[:34]
    as_folder(tmp_path / "elsewhere", drifted(other, other.truth, 4), "odometry.tum")
    for name, kept in (("elsewhere", 10), ("tuesday", len(truth))):
        for scan in sorted((tmp_path / name).glob("*.npy"))[kept:]:
            scan.unlink()
    posed = ("--poses", "odometry.tum", "--threads", 1)

    assert run("align", "site.segmap", "tuesday", "--out", "aligned", *posed) == 0
    assert "submaps agree" in capsys.readouterr().out
    poses = read_trajectory(Path("aligned/session_0.tum")).poses
    assert np.median(errors_m(poses, truth)) < 0.3
    facts = json.loads(Path("aligned/alignment.json").read_text())
    assert facts["sessions"][0]["anchors_accepted"] > 20

    assert run("align", "site.segmap", "elsewhere", "--out", "none", *posed) == 1
    assert "elsewhere does not meet the map" in capsys.readouterr().err
    assert not Path("none/session_0.tum").exists()

    update = ("map", "update", "site.segmap")
    assert run(*update, "elsewhere", "--align", "--out", "site.segmap", *posed) == 1
    assert "elsewhere does not meet the map" in capsys.readouterr().err
    assert run(*update, "tuesday", "--out", "site.segmap", *posed) == 1
    assert "--align" in capsys.readouterr().err
    assert Path("site.segmap").read_bytes() == before

    assert run(*update, "tuesday", "--align", "--out", "new.segmap", *posed) == 0
    assert "segments added" in capsys.readouterr().out
    new = SegmentMap.load("new.segmap")
    assert len(np.unique(new.session)) == 2
    session = new.trajectory[len(prior_map.trajectory) :]
    assert np.median(errors_m(session, truth)) < 0.3


def test_an_update_without_poses_names_the_remedy(capsys: pytest.CaptureFixture[str]) -> None:
    assert run("map", "update", "a", "b", "--out", "c")
    assert "--align" in capsys.readouterr().err
