"""Sensors and how they move: patterns, edges, motion, skew, swathes, recordings with times."""

from __future__ import annotations

import pickle
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

pytest.importorskip("embreex", reason="the simulator needs segloc-lab")

from segloc_lab.simulation import (
    PLATFORMS,
    SENSORS,
    Lidar,
    Motion,
    Route,
    Scene,
    World,
    car,
    deskew,
    handheld,
    hdl64e,
    lms151,
    record,
    simulate_session,
    solid_state,
    vlp16,
)
from segloc_lab.simulation.objects.mesh import Objects, boxes
from segloc_lab.simulation.objects.scene import Terrain
from segloc_lab.swathes import swathes

from segloc.errors import ConfigError, DatasetError
from segloc.tools.datasets import open_sequence, parse_select
from segloc.tools.io import read_trajectory
from segloc.types import Scan

FRONT, BACK = 1, 2


@pytest.fixture(scope="module")
def route(small: World) -> Route:
    rng = np.random.default_rng(0)
    return Route(tuple(small.roads.walk(rng, [0], 130.0, avoid=[])), length_m=70.0)


def walls(gap: float) -> Scene:
    """A post 10 m ahead, 0.5 m wide, ``gap`` before a wide wall; no ground near."""
    post = boxes([10.05, 0.0, 0.0], [0.1, 0.5, 40.0], 0.4)
    wall = boxes([10.05 + gap, 0.0, 0.0], [0.1, 40.0, 40.0], 0.4)
    items = Objects.of([("post", post), ("wall", wall)], FRONT)
    flat = Terrain(np.array([-1.0, -1.0]), 1.0, np.full((2, 2), -500.0))
    return Scene(flat, np.zeros(2, dtype=np.float32), [items])


# --- patterns -------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", SENSORS)
def test_every_sensor_has_a_pattern_and_can_be_thinned(name: str) -> None:
    sensor = SENSORS[name]()
    assert sensor.name == name
    rays = sensor.rays(0.4, 3)
    np.testing.assert_allclose(np.linalg.norm(rays.directions, axis=1), 1.0, atol=1e-6)
    assert len(rays.directions) == len(rays.times) * rays.beams_a_firing
    assert rays.times[0] == 0.0
    assert (np.diff(rays.times) > 0).all()
    assert rays.times[-1] < 1 / sensor.rate_hz
    few = sensor.thinned(4).rays(0.4, 3)
    assert len(few.directions) / len(rays.directions) == pytest.approx(0.25, rel=0.01)
    np.testing.assert_allclose(few.directions[0], rays.directions[0], atol=0.02)


# --- edges ----------------------------------------------------------------------------------------


def seen(scene: Scene, sensor: Lidar) -> tuple[np.ndarray, np.ndarray]:
    points, ids = sensor.scan(scene, np.eye(4), np.random.default_rng(3))
    ahead = (np.abs(points[:, 1]) < 2.0) & (points[:, 0] > 5.0)
    return points[ahead].astype(float), ids[ahead]


def broad(divergence_mrad: float) -> Lidar:
    return replace(hdl64e(4000).ideal(), divergence_mrad=divergence_mrad)


def test_points_between_two_near_surfaces_lie_on_their_edges() -> None:
    points, _ = seen(walls(0.6), broad(3.0))
    mixed = (points[:, 0] > 10.02) & (points[:, 0] < 10.58)
    assert 0.002 < mixed.mean() < 0.03
    edge = 0.5 / 2 / 10.0
    assert np.abs(np.abs(points[mixed, 1] / points[mixed, 0]) - edge).max() < 2.6e-3
    assert not ((points[:, 0] < 9.99) | (points[:, 0] > 10.61)).any()


# --- motion ---------------------------------------------------------------------------------------


@settings(deadline=None, max_examples=30)
@given(st.integers(0, 10_000), st.floats(0.0, 1.0))
def test_motion_is_linear_and_slerp_between_knots(seed: int, share: float) -> None:
    rng = np.random.default_rng(seed)
    T = np.tile(np.eye(4), (3, 1, 1))
    T[:, :3, :3] = Rotation.random(3, random_state=rng).as_matrix()
    T[:, :3, 3] = rng.normal(size=(3, 3))
    motion = Motion(np.array([0.0, 1.5, 2.0]), T)
    np.testing.assert_allclose(motion.at(motion.stamps), T, atol=1e-9)
    between = motion.at([1.5 + 0.5 * share])[0]
    np.testing.assert_allclose(between[:3, 3], (1 - share) * T[1, :3, 3] + share * T[2, :3, 3])
    whole = Rotation.from_matrix(T[1, :3, :3].T @ T[2, :3, :3]).as_rotvec()
    part = Rotation.from_matrix(T[1, :3, :3].T @ between[:3, :3]).as_rotvec()
    np.testing.assert_allclose(part, share * whole, atol=1e-7)
    np.testing.assert_allclose(motion.at([-5.0, 9.0]), T[[0, 2]], atol=1e-9)


def around_a_corner(radius: float = 0.8) -> np.ndarray:
    """25 m straight, a quarter of a circle to the left, 25 m straight."""
    turn = np.linspace(0.0, np.pi / 2, 13)
    arc = [45.0, 40.0] + radius * np.column_stack([np.sin(turn), 1 - np.cos(turn)])
    return np.concatenate([[[20.0, 40.0]], arc, [arc[-1] + [0.0, 25.0]]])


@pytest.mark.slow
@pytest.mark.parametrize("name", PLATFORMS)
def test_platforms_keep_their_height_and_their_limits(name: str, small: World) -> None:
    platform = PLATFORMS[name]()
    motion = platform.motion(small.terrain, around_a_corner(), np.random.default_rng(1))
    assert motion.travelled is not None
    speed = np.diff(motion.travelled) / np.diff(motion.stamps)
    assert speed.max() <= platform.speed_mps * 1.001
    slowest = motion.travelled[int(speed.argmin())]
    assert abs(slowest - 25.6) < 1.5
    assert speed.min() < 0.8 * platform.speed_mps
    gain = np.diff(speed) / np.diff(motion.stamps)[1:]
    assert np.abs(gain).max() < 1.3 * platform.braking_mps2
    above = motion.poses[:, 2, 3] - small.terrain.height(*motion.poses[:, :2, 3].T)
    if platform.flight is not None:
        assert above.min() >= platform.flight.low_m
        assert above.max() <= platform.flight.high_m
    else:
        assert abs(np.median(above) - platform.mount_height_m) < 0.05


# --- skew -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("make", [vlp16, solid_state, lms151])
@pytest.mark.parametrize("platform", [car, handheld])
def test_deskewing_with_the_known_motion_gives_the_geometry_back(
    make: Callable[[], Lidar], platform: Callable[[], object], small: World, route: Route
) -> None:
    sensor = make().thinned(2).ideal()
    drive = simulate_session(
        small, 0, route, sensor, 5, platform=platform(), by_rate=True, skew=True
    )
    assert drive.motion is not None
    assert drive.stamps is not None
    i = len(drive) // 2
    raw = drive.scan(i)
    assert raw.times is not None
    start = float(drive.stamps[i])
    for moment in np.unique(raw.times)[[0, -1]]:
        T = drive.motion.at([start + moment])[0]
        mine = raw.times == moment
        world = raw.points[mine] @ T[:3, :3].T + T[:3, 3]
        straight = deskew(raw, drive.motion, start).points[mine]
        there = straight @ drive.truth[i, :3, :3].T + drive.truth[i, :3, 3]
        np.testing.assert_allclose(there, world, atol=2e-4)
    ground = drive.object_ids(i) == 0
    straight = deskew(raw, drive.motion, start).points[ground].astype(float)
    world = straight @ drive.truth[i, :3, :3].T + drive.truth[i, :3, 3]
    assert np.abs(world[:, 2] - small.terrain.height(*world[:, :2].T)).max() < 3e-3


# --- swathes --------------------------------------------------------------------------------------


def test_swathes_of_a_push_broom_show_the_street(small: World, route: Route) -> None:
    sensor = replace(lms151(181).ideal(), max_range_m=25.0)
    drive = simulate_session(small, 0, route, sensor, 5, by_rate=True)
    rows = swathes(drive, 20.0)
    assert len(rows) == 3
    for i in range(len(rows)):
        cloud = rows.scan(i)
        assert rows.stamps is not None and cloud.stamp == rows.stamps[i]
        world = cloud.points @ rows.poses[i, :3, :3].T + rows.poses[i, :3, 3]
        low = world[world[:, 2] < small.terrain.height(*world[:, :2].T) + 0.05]
        assert len(low) > 2000
        reach = (low - rows.poses[i, :3, 3]) @ rows.poses[i, :3, 0]
        assert 15.0 < np.quantile(reach, 0.95) - np.quantile(reach, 0.05) < 30.0
        behind, ahead = (
            np.linalg.norm(drive.truth[k, :3, 3] - rows.poses[i, :3, 3])
            for k in (rows.first[i], rows.last[i] - 1)
        )
        assert max(behind, ahead) < 10.5
    assert rows.select(parse_select(f"{rows.indices[1]}")).scan(0).points.shape == (
        rows.scan(1).points.shape
    )


class OnePointScans:
    """A recording along x; every scan is the point that the sensor stands on."""

    name = "points"

    def __init__(self, way: np.ndarray) -> None:
        self.indices = np.arange(len(way))
        self.stamps = None
        self.poses = np.tile(np.eye(4), (len(way), 1, 1))
        self.poses[:, 0, 3] = way

    def __len__(self) -> int:
        return len(self.indices)

    def scan(self, i: int) -> Scan:
        return Scan(np.zeros((1, 3), dtype=np.float32))


def test_swathes_leave_out_stretches_without_scans() -> None:
    way = np.array([0.0, 1, 2, 3, 40, 41, 42, 43, 50])
    rows = swathes(OnePointScans(way), 10.0)
    assert list(zip(rows.first, rows.anchor, rows.last, strict=True)) == [(0, 3, 4), (4, 7, 8)]
    np.testing.assert_array_equal(rows.scan(1).points[:, 0], way[4:8] - 43.0)


# --- recordings -----------------------------------------------------------------------------------


@pytest.mark.parametrize("suffix", [None, ".laz"])
def test_recordings_of_moving_sensors_keep_times_and_stamps(
    suffix: str | None, small: World, route: Route, tmp_path: Path
) -> None:
    drive = simulate_session(
        small, 0, replace(route, length_m=12.0), vlp16(200), 5, by_rate=True, skew=True
    )
    record(drive, tmp_path, suffix=suffix, workers=1)
    stamps = read_trajectory(tmp_path / "poses.tum").stamps
    np.testing.assert_allclose(stamps, drive.stamps, atol=1e-9)
    read = open_sequence(tmp_path, tmp_path / "poses.tum", deskew=False)
    assert read.poses is not None
    np.testing.assert_allclose(read.poses, drive.truth, atol=1e-7)
    stored, scan = read.scan(4), drive.scan(4)
    assert stored.times is not None
    again = pickle.loads(pickle.dumps(drive)).scan(4)
    np.testing.assert_array_equal(again.points, scan.points)
    np.testing.assert_allclose(stored.times, scan.times, atol=1e-12)
    np.testing.assert_allclose(stored.points, scan.points, atol=6e-4 if suffix else 0)


def test_what_cannot_be_recorded_is_refused_in_one_line(
    small: World, route: Route, tmp_path: Path
) -> None:
    drive = simulate_session(small, 0, replace(route, length_m=40.0), lms151(20), 5)
    with pytest.raises(ConfigError, match="only simulated scans know the objects"):
        record(swathes(drive), tmp_path / "out", objects=True)
    assert not (tmp_path / "out").exists()
    (tmp_path / "file").touch()
    with pytest.raises(DatasetError, match="file: cannot be made: file exists"):
        record(drive, tmp_path / "file")
    with pytest.raises(DatasetError, match="cannot write this format"):
        record(drive, tmp_path / "out", suffix=".doc", workers=1)


def test_a_scan_without_motion_cannot_be_skewed(small: World, route: Route) -> None:
    drive = replace(simulate_session(small, 0, route, vlp16(30), 5, name="drive"), skew=True)
    with pytest.raises(ConfigError, match="drive: there is no skew without a motion"):
        drive.scan(0)
    assert isinstance(replace(drive, skew=False).scan(0), Scan)
