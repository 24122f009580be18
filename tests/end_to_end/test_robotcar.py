"""Sessions of a push-broom sensor in RobotCar's layout, through `examples/robotcar.sh`.

The sweeps are a simulated LMS-151's and the poses drift; the simulator's poses are only compared
with.
"""

from __future__ import annotations

import csv
import json
import os
import subprocess
import sysconfig
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("embreex", reason="the simulator needs the extra 'sim'")
pytest.importorskip("torch", reason="training needs the extra 'train'")

from samples.datasets import FLIP, START
from samples.robotcar import FRONT, T_sensor_car, write_drive
from segloc_lab.simulation import Conditions, lms151, simulate_sessions, town
from segloc_lab.training.shards import load_dataset

from segloc import Config, Localizer, SegmentMap, geometry
from segloc.batch.run import localize_sequence, query_positions
from segloc.datasets import open_sequence, swathes
from segloc.io import read_trajectory
from segloc.map.build import build_map
from segloc.types import Float64

pytestmark = pytest.mark.slow

LENGTH_M = 110.0
EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "robotcar.sh"


@dataclass
class Traversals:
    """Three sessions in one street, the last in winter."""

    folders: list[Path]
    truths: list[Float64]
    out: Path
    said: str

    @property
    def aligned(self) -> Path:
        return self.out / "aligned"

    def error(self, session: int, index: int, T_world_car: Float64) -> float:
        """How far a pose in the aligned world is off, seen from the nearest pose of session 0."""
        base, true = self.truths[0], self.truths[session][index]
        near = int(np.linalg.norm(base[:, :3, 3] - true[:3, 3], axis=1).argmin())
        anchor = read_trajectory(self.aligned / "session_0.tum").poses[near]
        found = geometry.inverse(anchor) @ T_world_car
        expected = geometry.inverse(base[near]) @ true
        return float(np.linalg.norm(found[:3, 3] - expected[:3, 3]))


@pytest.fixture(scope="module")
def traversals(tmp_path_factory: pytest.TempPathFactory) -> Traversals:
    root = tmp_path_factory.mktemp("robotcar")
    seasons = [Conditions(), Conditions(), Conditions(foliage=0.3, replaced=0.2)]
    drives = simulate_sessions(
        town(5, size_m=220.0), lms151(271), seasons, length_m=LENGTH_M, spacing_m=0.3, seed=2
    )
    folders, truths = [], []
    for k, drive in enumerate(drives):
        folders.append(write_drive(root / f"2014-11-2{k}-16-07-03", drive.with_odometry()))
        truths.append(drive.truth @ T_sensor_car(drive.sensor))
    out = root / "out"
    scripts = sysconfig.get_path("scripts")
    given = {"NETWORK": "profile", "STEPS": "20", "EVERY": "8"}
    run = subprocess.run(
        ["bash", str(EXAMPLE), str(out), *map(str, folders)],
        env={**os.environ, **given, "PATH": f"{scripts}{os.pathsep}{os.environ['PATH']}"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert run.returncode == 0, run.stderr[-2000:]
    return Traversals(folders, truths, out, run.stdout)


def test_every_step_says_what_it_found(traversals: Traversals) -> None:
    said = " ".join(traversals.said.split())
    assert said.count("Oxford RobotCar") == 3
    assert said.count("2D, one plane") == 3
    for fact in ("loops accepted", "profile.safetensors: auc", "recall@25", "not localized"):
        assert fact in said
    assert (traversals.out / "profile.safetensors").is_file()


def test_sessions_are_aligned(traversals: Traversals) -> None:
    facts = json.loads((traversals.aligned / "alignment.json").read_text())
    assert facts["components"] == [[0, 1, 2]]
    assert facts["loops"]["accepted_across_sessions"] > 20
    for session in (1, 2):
        poses = read_trajectory(traversals.aligned / f"session_{session}.tum").poses
        truth = traversals.truths[session]
        way = traversals.truths[0][None, :, :2, 3] - truth[:, None, :2, 3]
        shared = np.flatnonzero(np.linalg.norm(way, axis=2).min(axis=1) < 6)[::5]
        errors = [traversals.error(session, int(i), poses[i]) for i in shared]
        assert len(errors) > 40
        assert np.median(errors) < 0.15
        assert max(errors) < 0.5


def test_pairs_are_of_swathes_and_across_sessions(traversals: Traversals) -> None:
    dataset = load_dataset(traversals.aligned / "dataset")
    assert set(dataset.lengths.tolist()) == {30.0}  # no object shows in one sweep
    with (traversals.aligned / "pairs.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    across = {(row["first_session"], row["second_session"]) for row in rows if row["match"] == "1"}
    assert {("0", "1"), ("0", "2"), ("1", "2")} <= across
    near = [float(row["distance_m"]) for row in rows if row["match"] == "1"]
    assert len(near) > 500
    assert max(near) < 1.0


def test_a_map_of_one_session_localizes_another(traversals: Traversals) -> None:
    last, out = traversals.folders[-1], traversals.out
    found = read_trajectory(out / "results" / "poses.tum")
    assert len(found) >= 10  # of 14
    recorded = open_sequence(last, "none")
    assert recorded.stamps is not None
    numbers = recorded.indices[np.searchsorted(recorded.stamps, found.stamps - 1e-3)]
    for number, pose in zip(numbers, found.poses, strict=True):
        assert traversals.error(2, int(number), pose) < 1.0
    summary = json.loads((out / "results" / "summary.json").read_text())
    assert (summary["correct"], summary["false"]) == (len(found), 0)

    localizer = Localizer(SegmentMap.load(out / "site.segmap"), Config(threads=1))
    gathered = swathes(open_sequence(last), 30.0)
    answers = [localizer.localize(gathered.scan(i)) for i in range(len(gathered))]
    places = [answer.T_map_sensor for answer in answers]
    assert sum(place is not None for place in places) >= 2  # of 3
    for number, place in zip(gathered.indices, places, strict=True):
        assert place is None or traversals.error(2, int(number), place) < 1.0
    sweep = open_sequence(last, "none").scan(100)
    assert not localizer.localize(sweep).localized


def test_the_same_sensor_as_a_planar_scanner_in_bags(
    traversals: Traversals, tmp_path: Path
) -> None:
    """sensor_msgs/LaserScan in the scanner's own frame, which stands on edge."""
    pytest.importorskip("rosbags")
    from samples.bags import BagWriter

    step, recordings, T_car_scanner = 1.5 * np.pi / 270, [], FLIP @ FRONT
    for session in (0, 1):
        bag, sweeps = BagWriter("sqlite3"), open_sequence(traversals.folders[session], "none")
        for i, pose in enumerate(traversals.truths[session]):
            stamp = START + 0.05 * i
            flat = geometry.transform(geometry.inverse(T_car_scanner), sweeps.scan(i).points)
            firings = (np.arctan2(flat[:, 1], flat[:, 0]) + 0.75 * np.pi) / step
            ranges = np.full(271, np.inf)
            ranges[np.round(firings).astype(int)] = np.linalg.norm(flat, axis=1)
            bag.laser("/scan", stamp, ranges, step, 0.0)
            bag.odometry("/odom", stamp, pose @ T_car_scanner, "laser")
        recordings.append(open_sequence(bag.write(tmp_path / f"session_{session}")))
    mapped, asked = recordings
    config = Config(threads=1)
    localizer = Localizer(build_map(mapped, config), config)
    assert asked.poses is not None
    positions = query_positions(asked.poses, 16.0, 10.0)
    answers = localize_sequence(localizer, asked, positions)
    errors = [
        float(np.linalg.norm((geometry.inverse(asked.poses[i]) @ answer.T_map_sensor)[:3, 3]))
        for i, answer in zip(positions, answers, strict=True)
        if answer.T_map_sensor is not None
    ]
    assert len(errors) >= 4
    assert max(errors) < 0.3
