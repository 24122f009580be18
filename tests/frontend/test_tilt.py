"""Tilted frames of poses: detected when a map is built, and corrected."""

from __future__ import annotations

import json

import numpy as np
import pytest
from samples.plaza import Plaza, PlazaSequence
from scipy.spatial.transform import Rotation

from segloc import Config, Localizer, Scan, build_map, geometry
from segloc.errors import DatasetError
from segloc.frontend.gravity import angle_deg
from segloc.frontend.local_cloud import LocalCloudConfig
from segloc.frontend.tilt import Tilt, frame_tilt, level_recording, level_transform
from segloc.types import Float64, Recording, Reposed

Z = np.array([0.0, 0.0, 1.0])
CONFIG = LocalCloudConfig()


def tilt(roll_deg: float, pitch_deg: float = 0.0) -> Float64:
    """T_odom_world of odometry whose frame leans."""
    R = Rotation.from_euler("xy", [roll_deg, pitch_deg], degrees=True).as_matrix()
    return geometry.rigid(R, np.array([100.0, -50.0, 3.0]))


def leaning(recording: Recording, T_odom_world: Float64) -> Reposed:
    assert recording.poses is not None
    return Reposed(recording, T_odom_world @ recording.poses)


def tilt_of(recording: Recording) -> Tilt:
    found = frame_tilt(recording, CONFIG)
    assert found is not None
    return found


@pytest.mark.parametrize("angles", [(0.0, 0.0), (-3.0, 2.0), (15.0, 20.0)])
def test_a_leaning_frame_is_noticed(plaza: Plaza, angles: tuple[float, float]) -> None:
    T, walk = tilt(*angles), PlazaSequence(plaza.thinned(3))
    found = tilt_of(leaning(walk, T))
    assert angle_deg(found.up, T[:3, :3] @ Z) < 0.1
    assert found.is_significant == any(angles)
    again = tilt_of(leaning(walk, T))
    np.testing.assert_array_equal(again.up, found.up)


@pytest.mark.parametrize("slope_deg", [12.0])
def test_a_hill_is_no_lean(slope_deg: float) -> None:
    """Though every scan, by itself, shows a ground that rises the same way all along."""
    hill = Plaza(1)
    rise = np.tan(np.radians(slope_deg))
    hill.points = hill.points.copy()
    hill.points[:, 2] += rise * hill.points[:, 0]
    way = PlazaSequence(hill)
    way.poses[:, 2, 3] += rise * way.poses[:, 0, 3]
    assert tilt_of(way).tilt_deg < 0.3


def test_what_shows_no_walls_says_nothing() -> None:
    """Bare ground, and a corridor that leads straight on: floor and walls that all face one way."""
    rng = np.random.default_rng(0)
    ground = np.column_stack([*rng.uniform(-25, 25, (2, 30_000)), np.full(30_000, -1.8)])
    sides = np.column_stack(
        [rng.uniform(-25, 25, 9000), rng.choice([-1.5, 1.5], 9000), rng.uniform(-1.8, 1, 9000)]
    )
    for points in (ground, np.concatenate([ground[:9000] * [1, 0.06, 1], sides])):
        way = PlazaSequence(Plaza(0, objects=1))
        way.poses = np.stack([geometry.yaw_transform(0.0, (2.0 * k, 0, 1.8)) for k in range(15)])
        way.scan = lambda i, p=points: Scan(p)  # type: ignore[method-assign,misc]
        assert frame_tilt(way, CONFIG) is None
        with pytest.raises(DatasetError, match="too few walls"):
            level_recording(way, None)


@pytest.mark.slow
def test_sweeps_are_gathered_until_they_show_walls(plaza: Plaza) -> None:
    """Of a planar scanner that looks sideways and forward, one sweep shows nothing."""

    class Sweeps(PlazaSequence):
        def scan(self, i: int) -> Scan:
            whole = super().scan(i)
            near = np.abs(whole.points[:, 0]) < 0.6
            return Scan(whole.points[near], T_odom_sensor=self.poses[i])

    way = Sweeps(plaza.thinned(3), steps=120)
    way.poses = np.stack([geometry.yaw_transform(0.1, (-14 + 0.3 * k, 0, 1.8)) for k in range(120)])
    T = tilt(5.0)
    found = tilt_of(leaning(way, T))
    assert found.is_significant and angle_deg(found.up, T[:3, :3] @ Z) < 0.5


@pytest.mark.parametrize("seed", range(2))
def test_levelling_turns_as_little_as_it_can_about_the_first_pose(seed: int) -> None:
    rng = np.random.default_rng(seed)
    T_odom_first = geometry.rigid(
        Rotation.random(random_state=seed).as_matrix(), rng.normal(size=3)
    )
    up = rng.normal(size=3)
    up /= np.linalg.norm(up)
    found = Tilt(up, 0.1)
    T = level_transform(found, T_odom_first)
    np.testing.assert_allclose(T[:3, :3] @ up, Z, atol=1e-12)
    np.testing.assert_allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=1e-12)
    np.testing.assert_allclose((T @ T_odom_first)[:3, 3], T_odom_first[:3, 3], atol=1e-12)
    assert abs(np.degrees(geometry.rotation_angle(T)) - found.tilt_deg) < 1e-9
    np.testing.assert_array_equal(level_transform(Tilt(Z, 0.0), np.eye(4)), np.eye(4))


@pytest.mark.slow
def test_a_map_of_a_leaning_odometry_is_levelled(plaza: Plaza) -> None:
    """The note, the level map, and where a scan without a pose is then found."""
    T_odom_world = tilt(4.0)
    mapped = leaning(PlazaSequence(plaza), T_odom_world)
    config = Config.preset("geo")
    leant = build_map(mapped, config)
    assert "tilted by" in leant.metadata["frame"] and "T_map_odom" not in leant.metadata
    assert "frame" not in build_map(PlazaSequence(plaza), config).metadata
    level = config.model_copy(update={"mapping": config.mapping.model_copy(update={"level": True})})
    prior_map = build_map(mapped, level)
    T_map_odom = np.array(json.loads(prior_map.metadata["T_map_odom"]))
    T_map_world = T_map_odom @ T_odom_world
    assert angle_deg(T_map_world[:3, :3] @ Z, Z) < 0.3
    # A compact map keeps its path in steps of a centimetre or two, and of a thousandth.
    np.testing.assert_allclose(prior_map.trajectory, T_map_odom @ mapped.poses, atol=0.02)
    truth = geometry.yaw_transform(1.0, (3.0, -2.0, 1.7))
    result = Localizer(prior_map).localize(plaza.scan(truth, posed=False))
    assert result.localized and result.attitude == "estimated"
    delta = geometry.inverse(T_map_world @ truth) @ result.T_map_sensor
    assert np.linalg.norm(delta[:3, 3]) < 0.3
