"""Poses of a base on which the sensor is mounted, in folders, datasets and on the command line."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from samples.datasets import matrix
from samples.plaza import Plaza, PlazaSequence
from samples.walk import run

from segloc import geometry
from segloc.tools.datasets import open_sequence, parse_select, poses_at
from segloc.tools.io import Trajectory, write_scan, write_tum
from segloc.types import Float64

MOUNT = matrix((0.4, 0.1, 1.2), (0.0, np.pi / 2, 0.3))  # looking at the ground


def walk(plaza: Plaza, folder: Path) -> Float64:
    """A base's poses, and the scans of the sensor on it; T_world_sensor."""
    folder.mkdir()
    way = PlazaSequence(plaza)
    bases = way.poses @ geometry.yaw_transform(0.0, (0.0, 0.0, -1.2))
    for i, T in enumerate(bases @ MOUNT):
        write_scan(folder / f"{i:03d}.npy", plaza.scan(T, seed=i).points)
    write_tum(folder / "base.tum", Trajectory(np.arange(len(bases), dtype=np.float64), bases))
    poses: Float64 = bases @ MOUNT
    return poses


def test_poses_of_the_base_become_the_sensors(plaza: Plaza, tmp_path: Path) -> None:
    poses = walk(plaza, tmp_path / "walk")
    recording = open_sequence(tmp_path / "walk", "base.tum", T_base_sensor=MOUNT)
    np.testing.assert_allclose(recording.poses, poses, atol=1e-8)
    scan = recording.scan(3)
    np.testing.assert_allclose(scan.T_odom_sensor, poses[3], atol=1e-8)
    np.testing.assert_allclose(scan.T_base_sensor, MOUNT)
    part = recording.select(parse_select("4:6"))
    np.testing.assert_allclose(part.poses, poses[4:7], atol=1e-8)
    bare = open_sequence(tmp_path / "walk")
    known = poses_at(bare, tmp_path / "walk", "base.tum", T_base_sensor=MOUNT)
    np.testing.assert_allclose(known, poses, atol=1e-8)


@pytest.mark.slow
def test_a_sensor_that_looks_down_maps_and_localizes(plaza: Plaza, tmp_path: Path) -> None:
    """By one configuration: poses of the base for the map, no poses for the query."""
    poses = walk(plaza, tmp_path / "walk")
    config = tmp_path / "robot.yaml"
    config.write_text(
        f"method: geo\nlocal_cloud: {{mount: {{matrix: {MOUNT.tolist()}, poses_of_base: true}}}}"
    )
    again = tmp_path / "again"
    again.mkdir()
    T = poses[7] @ matrix((0.2, 0.3, 0.1), (0.0, 0.05, 0.1))
    write_scan(again / "0.npy", plaza.scan(T, seed=77).points)

    prior, out = tmp_path / "walk.segmap", tmp_path / "found"
    options = ["--poses", "base.tum", "--config", config]
    assert run("map", "build", tmp_path / "walk", *options, "--out", prior) == 0
    assert run("localize", again, "--map", prior, "--config", config, "--out", out) == 0
    found = json.loads((out / "localizations.jsonl").read_text())
    assert found["localized"] and found["attitude"] == "estimated"
    delta = geometry.inverse(T) @ np.array(found["T_map_sensor"])
    assert np.linalg.norm(delta[:3, 3]) < 0.2
    assert np.degrees(geometry.rotation_angle(delta)) < 1.0
