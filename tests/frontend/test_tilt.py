"""Frames of poses that lean: noticed when a map is built of them, and turned."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from samples.plaza import Plaza, PlazaSequence
from samples.real import real
from scipy.spatial.transform import Rotation
from segloc_lab.simulation import record

from segloc import Config, Localizer, Scan, build_map, cli, geometry
from segloc.datasets import open_sequence
from segloc.errors import DatasetError
from segloc.frontend.gravity import angle_deg
from segloc.frontend.local_cloud import LocalCloudConfig
from segloc.frontend.tilt import Lean, frame_lean, level_transform, levelled
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


def lean_of(recording: Recording) -> Lean:
    lean = frame_lean(recording, CONFIG)
    assert lean is not None
    return lean


@pytest.mark.parametrize("angles", [(0.0, 0.0), (4.0, 0.0), (-3.0, 2.0), (15.0, 20.0)])
def test_a_leaning_frame_is_noticed(plaza: Plaza, angles: tuple[float, float]) -> None:
    T = tilt(*angles)
    lean = lean_of(leaning(PlazaSequence(plaza), T))
    assert angle_deg(lean.up, T[:3, :3] @ Z) < 0.1
    assert lean.noticed == any(angles)
    again = lean_of(leaning(PlazaSequence(plaza), T))
    np.testing.assert_array_equal(again.up, lean.up)


@pytest.mark.parametrize("slope_deg", [4.0, 12.0])
def test_a_hill_is_no_lean(slope_deg: float) -> None:
    """Though every scan, by itself, shows a ground that rises the same way all along."""
    hill = Plaza(1)
    rise = np.tan(np.radians(slope_deg))
    hill.points = hill.points.copy()
    hill.points[:, 2] += rise * hill.points[:, 0]
    way = PlazaSequence(hill)
    way.poses[:, 2, 3] += rise * way.poses[:, 0, 3]
    assert lean_of(way).tilt_deg < 0.3


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
        assert frame_lean(way, CONFIG) is None
        with pytest.raises(DatasetError, match="too few walls"):
            levelled(way, None)


def test_sweeps_are_gathered_until_they_show_walls(plaza: Plaza) -> None:
    """Of a planar scanner that looks sideways and forward, one sweep shows nothing."""

    class Sweeps(PlazaSequence):
        def scan(self, i: int) -> Scan:
            whole = super().scan(i)
            near = np.abs(whole.points[:, 0]) < 0.6
            return Scan(whole.points[near], T_odom_sensor=self.poses[i])

    way = Sweeps(plaza, steps=120)
    way.poses = np.stack([geometry.yaw_transform(0.1, (-14 + 0.3 * k, 0, 1.8)) for k in range(120)])
    T = tilt(5.0)
    lean = lean_of(leaning(way, T))
    assert lean.noticed and angle_deg(lean.up, T[:3, :3] @ Z) < 0.5


@pytest.mark.parametrize("seed", range(5))
def test_levelling_turns_as_little_as_it_can_about_the_first_pose(seed: int) -> None:
    rng = np.random.default_rng(seed)
    T_odom_first = geometry.rigid(
        Rotation.random(random_state=seed).as_matrix(), rng.normal(size=3)
    )
    up = rng.normal(size=3)
    up /= np.linalg.norm(up)
    lean = Lean(up, 0.1)
    T = level_transform(lean, T_odom_first)
    np.testing.assert_allclose(T[:3, :3] @ up, Z, atol=1e-12)
    np.testing.assert_allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=1e-12)
    np.testing.assert_allclose((T @ T_odom_first)[:3, 3], T_odom_first[:3, 3], atol=1e-12)
    assert abs(np.degrees(geometry.rotation_angle(T)) - lean.tilt_deg) < 1e-9
    np.testing.assert_array_equal(level_transform(Lean(Z, 0.0), np.eye(4)), np.eye(4))


@pytest.mark.parametrize(("name", "lean_deg"), [("0618", 1.9), ("0622b", 2.1)])
def test_real_maps_of_an_odometry_that_leans(name: str, lean_deg: float) -> None:
    pytest.importorskip("laspy")
    lean = lean_of(open_sequence(real("mid360_lab", name, "scans"), "poses.tum"))
    assert lean.noticed and abs(lean.tilt_deg - lean_deg) < 0.3


def test_real_poses_that_are_level(kitti: Path) -> None:
    recording = open_sequence(kitti / "keyframes", "keyframes.tum", "60:400")
    lean = lean_of(recording)
    assert not lean.noticed and lean.tilt_deg < 0.8
    T = tilt(4.0)
    turned = lean_of(leaning(recording, T))
    assert turned.noticed and angle_deg(turned.up, T[:3, :3] @ lean.up) < 0.3


@pytest.mark.slow
def test_a_town_mapped_by_a_leaning_odometry() -> None:
    """The note, the level map, and where a scan without a pose is then found."""
    pytest.importorskip("embreex")
    from segloc_lab.simulation import Route, simulate_session, town, vlp16

    world = town(3, size_m=150.0)
    nodes = tuple(world.roads.walk(np.random.default_rng(0), [0], 160.0, avoid=[]))
    sensor = vlp16(900)
    drive = simulate_session(world, 0, Route(nodes, length_m=150.0), sensor, 0)
    T_odom_world = tilt(4.0)
    mapped = leaning(drive, T_odom_world)
    config = Config.preset("geo")
    leant = build_map(mapped, config)
    assert "tilted by" in leant.metadata["frame"] and "T_map_odom" not in leant.metadata
    level = config.model_copy(update={"mapping": config.mapping.model_copy(update={"level": True})})
    prior_map = build_map(mapped, level)
    assert "turned by" in prior_map.metadata["frame"]
    T_map_odom = np.array(json.loads(prior_map.metadata["T_map_odom"]))
    T_map_world = T_map_odom @ T_odom_world
    assert angle_deg(T_map_world[:3, :3] @ Z, Z) < 0.3
    # A compact map keeps its path in steps of a centimetre or two, and of a thousandth.
    np.testing.assert_allclose(prior_map.trajectory, T_map_odom @ mapped.poses, atol=0.02)
    assert "frame" not in build_map(drive, config).metadata
    again = simulate_session(world, 1, Route(nodes, 0.2, 9.0, 150.0), sensor, 1)
    localizer = Localizer(prior_map)
    right = 0
    for i in range(2, len(again)):
        result = localizer.localize(again.scan(i).points)
        assert result.attitude == "estimated"
        if result.localized:
            delta = geometry.inverse(T_map_world @ again.truth[i]) @ result.T_map_sensor
            assert np.linalg.norm(delta[:3, 3]) < 1.0
            right += 1
    assert right >= 0.6 * (len(again) - 2), f"{right} of {len(again) - 2}"


@pytest.mark.slow
def test_the_command_line_says_that_a_map_leans(
    plaza: Plaza,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    folder = record(leaning(PlazaSequence(plaza), tilt(4.0)), tmp_path / "walk", workers=1)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "300")

    def run(*arguments: str) -> str:
        monkeypatch.setattr("sys.argv", ["segloc", *arguments])
        with pytest.raises(SystemExit) as end:
            cli.main()
        said = capsys.readouterr()
        assert not end.value.code, said.err
        return " ".join((said.out + said.err).split())

    build = ("map", "build", str(folder), "--poses", "poses.tum", "--method", "geo")
    said = run(*build, "--out", "leant.segmap")
    assert "the map's frame is tilted by 4.0 degrees" in said and "--level builds it level" in said
    said = run(*build, "--level", "--out", "level.segmap")
    assert "turned by 4.0 degrees" in said and "--level" not in said
    assert "turned by 4.0 degrees" in run("map", "info", "level.segmap")
    said = run("info", str(folder), "--poses", "poses.tum")
    assert "tilted by 4.0 degrees, as walls show" in said
    assert "15 estimated; tilt" in run("info", str(folder))
    said = run("localize", str(folder), "--map", "level.segmap", "--out", "found", "--select", "7")
    assert "localized at x" in said
    again = ("localize", str(folder), "--map", "level.segmap", "--poses", "poses.tum")
    again = (*again, "--select", "7:9", "--out", "found")
    assert "degrees off vertical: --level turns them" in run(*again)
    assert "degrees about the first" in run(*again, "--level")
    run("localize", str(folder), "--map", "level.segmap", "--out", "found", "--select", "7")
    record_line = (tmp_path / "found" / "localizations.jsonl").read_text()
    assert json.loads(record_line)["attitude"] == "estimated"
