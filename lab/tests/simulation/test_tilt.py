"""Platforms that tilt and fly: as far as they say, smoothly, and seen in the scans."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

pytest.importorskip("embreex", reason="the simulator needs segloc-lab")

from segloc_lab.simulation import (
    Conditions,
    Platform,
    drone,
    handheld,
    legged,
    quadruped,
    simulate_sessions,
    vlp16,
    warehouse,
    wheeled,
)
from segloc_lab.simulation.objects.scene import Terrain

from segloc.types import Float64

LINE = np.array([[0.0, 0.0], [400.0, 0.0]])
FLAT = Terrain(np.array([-10.0, -10.0]), 420.0, np.zeros((2, 2)))


def poses(platform: Platform, seed: int = 0, line: Float64 = LINE) -> Float64:
    return platform.motion(FLAT, line, np.random.default_rng(seed)).poses


def tilts(T: Float64) -> Float64:
    """Of the z axes from the vertical, degrees."""
    return np.degrees(np.arccos(np.clip(T[:, 2, 2], -1, 1)))


@pytest.mark.parametrize(
    ("make", "median", "most"),
    [(handheld, (12, 22), (29, 35)), (quadruped, (4, 9), (10, 18)), (legged, (0.5, 3), (2, 9))],
)
def test_tilt_reaches_what_it_says_and_no_more(
    make: Callable[[], Platform], median: tuple[float, float], most: tuple[float, float]
) -> None:
    found = np.concatenate([tilts(poses(make(), seed)) for seed in range(3)])
    assert median[0] < np.median(found) < median[1]
    assert most[0] < found.max() < most[1]


@pytest.mark.parametrize("make", [wheeled, handheld, drone])
def test_a_mount_turns_the_sensor_and_nothing_else(make: Callable[[], Platform]) -> None:
    plain, mounted = poses(make()), poses(replace(make(), mount_rpy_deg=(10.0, 20.0, -30.0)))
    np.testing.assert_array_equal(mounted[:, :3, 3], plain[:, :3, 3])
    turn = plain[:, :3, :3].transpose(0, 2, 1) @ mounted[:, :3, :3]
    angles = Rotation.from_matrix(turn).as_euler("ZYX", degrees=True)
    np.testing.assert_allclose(angles, np.tile([-30.0, 20.0, 10.0], (len(turn), 1)), atol=1e-9)


@pytest.mark.slow
def test_scans_are_cast_from_the_tilted_sensor() -> None:
    """The ground, taken to the world by the true poses, is level; in the sensor it is not."""
    sensor = replace(vlp16(400).ideal(), max_range_m=100.0)
    place, how = warehouse(7, size_m=50.0), {"length_m": 40.0, "platform": handheld()}
    drive, again = (simulate_sessions(place, sensor, [Conditions()], **how)[0] for _ in range(2))
    leaning = int(np.argmax(tilts(drive.truth)))
    scan, T = drive.scan(leaning), drive.truth[leaning]
    ground = scan.points[drive.object_ids(leaning) == 0].astype(float)
    assert len(ground) > 200
    up = ground @ T[:3, :3].T + T[:3, 3]
    height = drive.world.terrain.height(up[:, 0], up[:, 1])
    np.testing.assert_allclose(up[:, 2], height, atol=0.02)
    np.testing.assert_array_equal(again.scan(leaning).points, scan.points)
