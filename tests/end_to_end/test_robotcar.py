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
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("embreex", reason="the simulator needs segloc-lab")
pytest.importorskip("torch", reason="training needs the extra 'train'")

from samples.drift import errors_across
from samples.robotcar import T_sensor_car, write_drive
from segloc_lab.simulation import Conditions, lms151, simulate_sessions, town

from segloc.tools.datasets import open_sequence
from segloc.tools.io import read_trajectory

LENGTH_M = 110.0
EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "robotcar.sh"


@pytest.mark.slow
def test_sessions_are_aligned_trained_on_and_localized(tmp_path: Path) -> None:
    seasons = [Conditions(), Conditions(foliage=0.3, replaced=0.2)]
    drives = simulate_sessions(
        town(5, size_m=180.0), lms151(271), seasons, length_m=LENGTH_M, spacing_m=0.3, seed=2
    )
    folders = [
        write_drive(tmp_path / f"2014-11-2{k}-16-07-03", drive.with_odometry())
        for k, drive in enumerate(drives)
    ]
    first, second = (drive.truth @ T_sensor_car(drive.sensor) for drive in drives)
    out, scripts = tmp_path / "out", sysconfig.get_path("scripts")
    given = {"NETWORK": "profile", "STEPS": "20", "EVERY": "8"}
    run = subprocess.run(
        ["bash", str(EXAMPLE), str(out), *map(str, folders)],
        env={**os.environ, **given, "PATH": f"{scripts}{os.pathsep}{os.environ['PATH']}"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert run.returncode == 0, run.stderr[-2000:]
    assert (out / "profile.safetensors").is_file()

    facts = json.loads((out / "aligned" / "alignment.json").read_text())
    assert facts["components"] == [[0, 1]]
    poses = [read_trajectory(out / "aligned" / f"session_{k}.tum").poses for k in (0, 1)]
    off = errors_across(*poses, first, second)
    assert len(off) > 100 and np.median(off) < 0.15 and off.max() < 0.5

    with (out / "dataset" / "pairs.csv").open(newline="") as file:
        rows = [row for row in csv.DictReader(file) if row["match"] == "1"]
    assert ("0", "1") in {(row["first_session"], row["second_session"]) for row in rows}
    assert len(rows) > 200 and max(float(row["distance_m"]) for row in rows) < 1.0

    found = read_trajectory(out / "results" / "poses.tum")
    recorded = open_sequence(folders[1], "none")
    assert recorded.stamps is not None
    numbers = recorded.indices[np.searchsorted(recorded.stamps, found.stamps - 1e-3)]
    off = errors_across(poses[0], found.poses, first, second[numbers], reach_m=np.inf)
    assert len(off) >= 4 and off.max() < 1.0
    summary = json.loads((out / "results" / "summary.json").read_text())
    assert (summary["correct"], summary["false"]) == (len(found), 0)
