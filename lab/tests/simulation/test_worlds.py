"""The simulator: the same for the same seed, true to its geometry, honest about noise."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import cKDTree

pytest.importorskip("embreex", reason="the simulator needs segloc-lab")

from segloc_lab.simulation import (
    OdometryNoise,
    Route,
    Scene,
    SpinningLidar,
    hdl32e,
    hdl64e,
    industrial,
    record,
    simulate_session,
    town,
    vlp16,
)
from segloc_lab.simulation.objects.mesh import SESSION_IDS, Objects, boxes, glass, quads
from segloc_lab.simulation.objects.scene import Terrain
from segloc_lab.simulation.worlds.town import _town
from segloc_lab.simulation.worlds.world import World

from segloc.errors import DatasetError
from segloc.system.processes import ProcessPool
from segloc.tools.datasets import open_sequence
from segloc.tools.datasets.recorded import parse_select

SIZE = 150.0
BOX_ID = 7


@pytest.fixture(scope="module")
def box_scene() -> Scene:
    """A grey 2 m cube, its near face 10 m ahead, on ground that slopes by 2 %."""
    x = np.arange(0.0, 81.0)
    terrain = Terrain(np.array([-40.0, -40.0]), 1.0, np.tile(0.02 * (x - 40.0), (81, 1)))
    box = Objects.of([("box", boxes([11.0, 0.0, 1.0], [2.0, 2.0, 2.0], 0.4))], BOX_ID)
    return Scene(terrain, np.full(2 * 80 * 80, 0.3, dtype=np.float32), [box])


def at(height: float) -> np.ndarray:
    T = np.eye(4)
    T[2, 3] = height
    return T


def route_in(world: World, metres: float = 40.0) -> Route:
    rng = np.random.default_rng(0)
    return Route(tuple(world.roads.walk(rng, [0], metres, avoid=[])), length_m=metres)


# --- worlds ---------------------------------------------------------------------------------------


@pytest.mark.slow
def test_town_depends_on_its_seed_alone(small: World) -> None:
    again = _town.__wrapped__(3, SIZE, 0.0, False)  # type: ignore[attr-defined]
    assert again is not small
    np.testing.assert_array_equal(again.static.triangles, small.static.triangles)
    np.testing.assert_array_equal(again.terrain.heights, small.terrain.heights)
    other = town(4, size_m=SIZE)
    assert other.static.triangles.shape != small.static.triangles.shape


@pytest.mark.slow
@pytest.mark.parametrize(("make", "gap"), [(town, 1.9), (industrial, 2.0)])
def test_nothing_stands_where_vehicles_drive(make: Callable[..., World], gap: float) -> None:
    world = make(3, size_m=SIZE)
    line = np.concatenate([street.line for street in world.roads.streets])
    corner = world.static.triangles.reshape(-1, 3)
    height = corner[:, 2] - world.terrain.height(corner[:, 0], corner[:, 1])
    low = corner[(height < 2.0) & (height > 0.1)] if make is industrial else corner[height < 2.0]
    assert cKDTree(low[:, :2]).query(line[::4])[0].min() > gap


@pytest.mark.slow
def test_sessions_redraw_cars_and_keep_the_rest(small: World) -> None:
    first, second = small.changing(0), small.changing(1)
    assert set(first.kinds.values()) >= {"car", "person"}
    assert min(first.kinds) >= SESSION_IDS
    assert min(second.kinds) >= 2 * SESSION_IDS
    assert max(small.static.kinds) < SESSION_IDS
    assert not {t.tobytes() for t in first.triangles} & {t.tobytes() for t in second.triangles}
    repeat = small.changing(0)
    np.testing.assert_array_equal(first.triangles, repeat.triangles)

    sensor = hdl64e(180).ideal()
    poses = route_in(small, 20.0).poses(small, sensor.mount_height_m)
    seen = []
    for k in (0, 1):
        points, ids = sensor.scan(small.session(k), poses[3], np.random.default_rng(0))
        stays = ids < SESSION_IDS
        seen.append({tuple(row) for row in points[stays].tolist()})
        kinds = small.session(k).kinds
        assert all(kinds[i] in ("car", "person", "bicycle") for i in np.unique(ids[~stays]))
    assert len(seen[0] & seen[1]) > 0.8 * len(seen[0])


# --- sensors --------------------------------------------------------------------------------------


def test_points_lie_on_the_box_and_on_the_ground(box_scene: Scene) -> None:
    sensor = hdl64e(1500).ideal()
    points, ids = sensor.scan(box_scene, at(1.73), np.random.default_rng(0))
    world = points.astype(np.float64) + at(1.73)[:3, 3]
    box, ground = world[ids == BOX_ID], world[ids == 0]
    assert set(np.unique(ids)) == {0, BOX_ID}
    np.testing.assert_allclose(box[:, 0], 10.0, atol=1e-4)
    assert np.abs(box[:, 1]).max() <= 1.0 + 1e-4
    np.testing.assert_allclose(ground[:, 2], 0.02 * ground[:, 0], atol=1e-4)
    behind = (ground[:, 0] > 12) & (np.abs(ground[:, 1]) < 0.9) & (ground[:, 0] < 20)
    assert not behind.any()


@pytest.mark.parametrize(("make", "beams"), [(hdl64e, 64), (hdl32e, 32), (vlp16, 16)])
def test_beams_are_those_of_the_table(make: type, beams: int, box_scene: Scene) -> None:
    sensor: SpinningLidar = make(300)
    directions = sensor.rays(0.3)[0]
    assert directions.shape == (300 * beams, 3)
    np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1.0, atol=1e-6)
    points, _ = replace(sensor, range_sigma_m=0.05).scan(
        box_scene, at(1.73), np.random.default_rng(0)
    )
    elevation = np.degrees(np.arctan2(points[:, 2], np.hypot(points[:, 0], points[:, 1])))
    table = np.array(sensor.elevations_deg)
    nearest = np.abs(elevation[:, None] - table).min(axis=1)
    assert nearest.max() < 2e-3
    azimuth = np.degrees(np.arctan2(points[:, 1], points[:, 0])) * 300 / 360
    offset = (azimuth - azimuth[0] + 0.5) % 1.0 - 0.5
    assert np.abs(offset).max() < 1e-2


def test_range_noise_has_the_given_spread(box_scene: Scene) -> None:
    sensor = replace(hdl64e(3000).ideal(), range_sigma_m=0.03)
    still = replace(sensor, range_sigma_m=0.0)
    exact, same = (
        s.scan(box_scene, at(1.73), np.random.default_rng(5))[0] for s in (still, sensor)
    )
    assert exact.shape == same.shape
    error = np.linalg.norm(same, axis=1).astype(float) - np.linalg.norm(exact, axis=1)
    assert len(error) > 20_000
    assert abs(error.mean()) < 0.001
    assert abs(error.std() / 0.03 - 1) < 0.03


def test_returns_are_lost_with_range_angle_and_darkness() -> None:
    def share(distance: float, reflectance: float, turn: float = 0.0) -> float:
        wall = boxes([0, 0, 0], [0.01, 400.0, 400.0], reflectance).moved([0, 0, 0], turn)
        walls = Objects.of([("wall", wall.moved([distance, 0, 0]))], 1)
        flat = Terrain(np.array([-1.0, -1.0]), 1.0, np.full((2, 2), -50.0))
        scene = Scene(flat, np.zeros(2, dtype=np.float32), [walls])
        sensor = replace(hdl64e(4000), elevations_deg=(0.0,), min_range_m=0.1)
        count = np.zeros(2)
        for lidar in (sensor, sensor.ideal()):
            points, _ = lidar.scan(scene, np.eye(4), np.random.default_rng(2))
            count[int(lidar is sensor)] = (np.abs(points[:, 1]) < 0.05 * distance).sum()
        return float(count[1] / count[0])

    assert share(10.0, 0.3) > 0.97
    assert share(30.0, 0.1) > share(60.0, 0.1) > share(100.0, 0.1)
    assert share(60.0, 0.5) > share(60.0, 0.05) + 0.2
    assert share(80.0, 0.15) > share(80.0, 0.15, turn=np.radians(80.0)) + 0.1


def test_glass_is_dirty_or_clear_or_a_mirror() -> None:
    """Many panes leaning towards the sensor at x = 10, a wall at x = 15, ground at z = -2."""
    edge = np.arange(-8.0, 8.0, 0.25)
    y, z = (grid.reshape(-1) for grid in np.meshgrid(edge, np.arange(-0.5, 4.0, 0.25)))

    def lean(y: np.ndarray, z: np.ndarray) -> np.ndarray:
        return np.stack([10.0 - 0.5 * z, y, z], axis=1)

    corners = np.stack(
        [lean(y + a, z + b) for a, b in ((0, 0), (0.25, 0), (0.25, 0.25), (0, 0.25))]
    )
    panes = glass(quads(corners.transpose(1, 0, 2), 0.0))
    wall = boxes([15.0, 0, 0], [0.02, 400.0, 400.0], 0.5)
    things = Objects.of([("panes", panes), ("wall", wall)], 1)
    flat = Terrain(np.array([-40.0, -40.0]), 40.0, np.full((3, 3), -2.0))
    scene = Scene(flat, np.full(8, 0.5, dtype=np.float32), [things])
    sensor = replace(hdl64e(6000).ideal(), glass=True)

    def seen_ahead(lidar: SpinningLidar) -> tuple[np.ndarray, np.ndarray]:
        points, ids = lidar.scan(scene, np.eye(4), np.random.default_rng(0))
        ahead = (points[:, 0] > 8) & (np.abs(points[:, 1] / points[:, 0]) < 0.6)
        ahead &= (points[:, 2] / points[:, 0] > -0.04) & (points[:, 0] < 200)
        return points[ahead], ids[ahead]

    assert set(seen_ahead(replace(sensor, glass=False))[1]) == {1}
    points, ids = seen_ahead(sensor)
    np.testing.assert_allclose(points[ids == 1, 0] + 0.5 * points[ids == 1, 2], 10.0, atol=1e-3)
    np.testing.assert_allclose(points[ids == 2, 0], 14.99, atol=1e-3)
    shares = [(ids == k).mean() for k in (1, 2)]
    assert 0.15 < shares[0] < 0.35
    assert shares[1] > 0.6
    ghosts = points[ids == -1]
    assert 0 < len(ghosts) < 0.06 * len(points)
    mirror = np.array([1.0, 0.0, 0.5]) / np.sqrt(1.25)
    seen = ghosts - 2 * ((ghosts - [10.0, 0.0, 0.0]) @ mirror)[:, None] * mirror
    np.testing.assert_allclose(seen[:, 2], -2.0, atol=5e-3)


# --- drives ---------------------------------------------------------------------------------------


def test_drive_keeps_its_spacing_lane_and_heading(small: World) -> None:
    right = route_in(small, 50.0)
    left = replace(right, lane_offset_m=-1.1)
    a, b = right.poses(small, 1.73), left.poses(small, 1.73)
    step = np.linalg.norm(np.diff(a[:, :2, 3], axis=0), axis=1)
    np.testing.assert_allclose(step, 2.0, atol=0.1)
    ahead = (
        np.diff(a[:, :3, 3], axis=0) / np.linalg.norm(np.diff(a[:, :3, 3], axis=0), axis=1)[:, None]
    )
    assert (np.einsum("ij,ij->i", ahead, a[:-1, :3, 0]) > 0.98).all()
    across = np.linalg.inv(a[0]) @ b[0]
    np.testing.assert_allclose(across[:2, 3], [0.0, 2.2], atol=0.1)
    above = a[:, 2, 3] - small.terrain.height(a[:, 0, 3], a[:, 1, 3])
    np.testing.assert_allclose(above, 1.73, atol=0.08)
    np.testing.assert_allclose(
        a[:, :3, :3] @ a[:, :3, :3].transpose(0, 2, 1),
        np.tile(np.eye(3), (len(a), 1, 1)),
        atol=1e-12,
    )


@pytest.mark.slow
def test_recording_is_the_same_on_two_processes_and_reads_back(
    small: World, tmp_path: Path
) -> None:
    sequence = simulate_session(small, 1, route_in(small, 30.0), hdl64e(60), seed=5, name="drive")
    reports: list[tuple[int, int]] = []
    with ProcessPool(2) as pool:
        folder = record(
            sequence, tmp_path / "two", executor=pool, progress=lambda *n: reports.append(n)
        )
    assert reports[-1] == (len(sequence), len(sequence))
    record(sequence, tmp_path / "one", workers=1)
    files = sorted(path.name for path in folder.iterdir())
    assert files[0] == "000000.npy"
    assert files[-1] == "poses.tum"
    for name in files:
        assert (tmp_path / "one" / name).read_bytes() == (folder / name).read_bytes()
    read = open_sequence(folder, folder / "poses.tum")
    assert read.poses is not None
    np.testing.assert_allclose(read.poses, sequence.poses, atol=1e-7)
    chosen = sequence.select(parse_select("4:6"))
    assert chosen.indices.tolist() == [4, 5, 6]
    scan, stored = chosen.scan(1), read.scan(5)
    np.testing.assert_array_equal(scan.points, stored.points)
    assert scan.stamp is None and stored.stamp is None  # no motion, no times
    assert len(chosen.object_ids(1)) == len(scan)


@pytest.mark.slow
def test_odometry_drifts_and_starts_level(small: World) -> None:
    sequence = simulate_session(small, 0, route_in(small, 60.0), hdl64e(30), seed=5)
    exact = sequence.with_odometry(OdometryNoise(0, 0, 0, 0, 0))
    relative = np.linalg.inv(sequence.truth[3]) @ sequence.truth[20]
    np.testing.assert_allclose(np.linalg.inv(exact.poses[3]) @ exact.poses[20], relative, atol=1e-9)
    np.testing.assert_allclose(exact.poses[:, 2, :3], sequence.truth[:, 2, :3], atol=1e-9)
    np.testing.assert_allclose(exact.poses[0, :3, 3], 0.0, atol=1e-9)
    noisy = sequence.with_odometry()
    error = np.linalg.inv(exact.poses) @ noisy.poses
    far = np.linalg.norm(error[:, :3, 3], axis=1)
    assert 0.0 < far[0] < 0.1
    assert far.max() < 0.6
    scan = noisy.scan(4)
    np.testing.assert_array_equal(scan.points, sequence.scan(4).points)
    np.testing.assert_array_equal(scan.T_odom_sensor, noisy.poses[4])
    np.testing.assert_array_equal(noisy.select(parse_select("4:6")).poses, noisy.poses[4:7])


def test_a_scan_that_is_not_there_is_named(small: World) -> None:
    sequence = simulate_session(small, 0, route_in(small, 20.0), hdl64e(30), seed=5, name="drive")
    with pytest.raises(DatasetError, match="drive: no scan at position 10, there are 10"):
        sequence.scan(10)
