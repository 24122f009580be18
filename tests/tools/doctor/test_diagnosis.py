"""Faults of a recording are named; correct recordings have none."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from samples.on_board import HIGH, LOW, beside, masted, with_mast
from samples.plaza import Plaza, PlazaSequence
from samples.real import real
from samples.walk import Points, Poses, Walk, as_folder, in_view, run, written
from scipy.spatial.transform import Rotation

from segloc import (
    Config,
    DatasetError,
    Localizer,
    MemoryRecording,
    NotLocalized,
    Reason,
    SegmentMap,
    build_map,
    geometry,
)
from segloc.frontend.local_cloud import LocalCloudConfig
from segloc.tools.datasets import open_sequence
from segloc.tools.datasets.signature import signature
from segloc.tools.doctor import (
    Fault,
    Finding,
    body_findings,
    examine,
    faulty_points,
    first_fault,
    hint,
    pose_findings,
    sample_scans,
    scan_findings,
)
from segloc.types import Float64, Recording, Reposed, Scan

MIRROR = np.diag([1.0, -1.0, 1.0, 1.0])
T_CAMERA_SENSOR = np.array([[0.0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]])


def turned(axis: str, degrees: float) -> Points:
    R = Rotation.from_euler(axis, degrees, degrees=True).as_matrix()
    return lambda points: points @ R.T


POINTS: dict[str, tuple[Points, Fault, str]] = {
    "millimetres": (lambda p: 1000 * p, Fault.MILLIMETRES, "in millimetres: divide them by 1000"),
    "centimetres": (lambda p: 100 * p, Fault.CENTIMETRES, "in centimetres: divide them by 100"),
    "world": (lambda p: p + [150.0, 40, 3], Fault.WORLD_COORDINATES, "outside its own points"),
    "utm": (lambda p: p + [455e3, 5428e3, 110], Fault.WORLD_COORDINATES, "world coordinates"),
    "camera": (
        lambda p: geometry.transform(T_CAMERA_SENSOR, p),
        Fault.CAMERA_AXES,
        "camera's .x right, y down, z forward.: write z, -x, -y",
    ),
    "z down": (lambda p: p * [1, -1, -1], Fault.Z_DOWN, "z axis points down: change the signs"),
    "on its side": (turned("y", 90), Fault.TILT, "tilted by about 90 degrees: set how"),
    "ground": (lambda p: p[p[:, 2] < -1.7], Fault.ONLY_GROUND, "nothing but ground in view"),
}
"""Faulty points by name: how they are made, their fault, and its message."""


def scalar_first(poses: Float64) -> Float64:
    """As a reader of qx qy qz qw takes a file of qw qx qy qz."""
    quaternions = Rotation.from_matrix(poses[:, :3, :3]).as_quat()[:, [3, 0, 1, 2]]
    return reposed(poses, Rotation.from_quat(quaternions).as_matrix(), poses[:, :3, 3])


def reposed(poses: Float64, rotations: Float64, positions: Float64) -> Float64:
    made = poses.copy()
    made[:, :3, :3], made[:, :3, 3] = rotations, positions
    return made


POSES: dict[str, tuple[Poses, Fault, str]] = {
    "inverse": (np.linalg.inv, Fault.POSES_INVERSE, "poses are inverse"),
    "wxyz": (scalar_first, Fault.POSES_WXYZ, "order qw qx qy qz .*: write them as qx qy qz qw"),
    "camera": (
        lambda T: T_CAMERA_SENSOR @ T @ np.linalg.inv(T_CAMERA_SENSOR),
        Fault.POSES_OF_CAMERA,
        "those of a camera",
    ),
    "camera's body": (
        lambda T: T @ np.linalg.inv(T_CAMERA_SENSOR),
        Fault.POSES_OF_CAMERA,
        "multiply each by T_camera_sensor from the right",
    ),
    "millimetres": (
        lambda T: reposed(T, T[:, :3, :3], 1000 * T[:, :3, 3]),
        Fault.POSES_IN_MILLIMETRES,
        "poses are in millimetres .*: divide their positions by 1000",
    ),
    "poses in feet": (
        lambda T: reposed(T, T[:, :3, :3], T[:, :3, 3] / 0.3048),
        Fault.FEET,
        "poses are in feet .*: multiply their positions",
    ),
    "points in feet": (
        lambda T: reposed(T, T[:, :3, :3], T[:, :3, 3] * 0.3048),
        Fault.FEET,
        "points are in feet .*: multiply them",
    ),
    "mirrored points": (
        lambda T: MIRROR @ T @ MIRROR,
        Fault.MIRRORED,
        "y axis of the points is mirrored .*: change the sign of y",
    ),
    "stuck": (
        lambda T: np.tile(T[:1], (len(T), 1, 1)),
        Fault.POSES_SMEAR,
        "stay in one place, but the scans move .*: odometry was stuck",
    ),
    "other order": (lambda T: T[::-1].copy(), Fault.POSES_SMEAR, "do not match at their poses"),
}
"""Likewise of poses."""


def noisy(poses: Float64, metres: float = 0.0, degrees: float = 0.0) -> Float64:
    rng = np.random.default_rng(0)
    made = poses.copy()
    made[:, :2, 3] += rng.normal(0, metres, (len(made), 2))
    yaw = Rotation.from_euler("z", rng.normal(0, degrees, (len(made), 1)), degrees=True).as_matrix()
    made[:, :3, :3] = made[:, :3, :3] @ yaw
    return made


def scans(recording: Recording, count: int = 5) -> list[Scan]:
    chosen = np.unique(np.linspace(0, len(recording) - 1, count).round().astype(int))
    return [recording.scan(int(i)) for i in chosen]


@pytest.mark.parametrize("name", POINTS)
def test_points_that_are_written_wrongly_are_named(name: str) -> None:
    written, fault, expected = POINTS[name]
    (finding,) = scan_findings(scans(Walk(written)), posed=True)
    assert finding.fault is fault and finding.wrong
    check_said(str(finding), expected)


def check_said(text: str, pattern: str) -> None:
    assert re.search(pattern, text), text
    assert "\n" not in text and ": " in text


@pytest.mark.slow
@pytest.mark.parametrize("name", POSES)
def test_poses_that_are_written_wrongly_are_named(name: str) -> None:
    means, fault, expected = POSES[name]
    walk = Walk()
    (finding,) = pose_findings(Reposed(walk, means(walk.poses)))
    assert finding.fault is fault and finding.wrong
    check_said(str(finding), expected)


@pytest.mark.parametrize(("metres", "degrees"), [(0.6, 0.0), (0.0, 8.0)])
def test_poses_that_are_somewhat_off_are_measured(metres: float, degrees: float) -> None:
    walk = Walk()
    (finding,) = pose_findings(Reposed(walk, noisy(walk.poses, metres, degrees)))
    assert finding.fault in (Fault.POSES_OFF, Fault.POSES_SMEAR)


def test_rooms_whose_neighbours_are_out_of_view_have_nothing_wrong() -> None:
    rng, scans, poses = np.random.default_rng(0), list[Float64](), list[Float64]()
    for room in range(8):
        half = rng.uniform(2.0, 3.3, 3)
        walls = rng.uniform(-half, half, (6000, 3))
        for axis in range(2):
            walls[axis::2, axis] = rng.choice([-1, 1], 3000) * half[axis]
        boxes = rng.uniform(-2.5, 2.5, (5, 1, 3)) + rng.uniform(-0.4, 0.4, (5, 300, 3))
        seen = np.concatenate([walls, boxes.reshape(-1, 3)]) + (7.0 * room, 0.0, 0.0)
        for x in (-1.1, 1.1):
            T = geometry.yaw_transform(0.7 * room, (7.0 * room + x, 0.0, 0.0))
            poses.append(T)
            scans.append(geometry.transform(geometry.inverse(T), seen))
    posed = np.array(poses)
    assert pose_findings(MemoryRecording([Scan(points) for points in scans], posed)) == []
    shuffled = [Scan(scans[k]) for k in rng.permutation(len(scans))]
    (finding,) = pose_findings(MemoryRecording(shuffled, posed))
    assert finding.fault is Fault.POSES_SMEAR


@pytest.mark.slow
def test_right_recordings_have_nothing_wrong() -> None:
    walk = Walk()
    assert scan_findings(scans(walk), posed=True) == [] == pose_findings(walk)
    assert first_fault(walk) is None


class Narrow(Walk):
    """A walk with a sensor that sees 120 degrees and turns by 110 degrees within two metres."""

    def __init__(self) -> None:
        super().__init__(in_view)
        for k, T in enumerate(self.poses):
            T[:] = geometry.yaw_transform(0.5 * k, (0.5 * k - 4.0, 1.0, 1.8))


@pytest.mark.slow
def test_scans_of_a_narrow_sensor_are_compared_where_they_share_their_view() -> None:
    walk = Narrow()
    assert pose_findings(walk) == []
    for name in ("inverse", "wxyz", "camera", "millimetres"):
        means, fault, _ = POSES[name]
        (finding,) = pose_findings(Reposed(walk, means(walk.poses)))
        assert finding.fault is fault, name


def test_python_refuses_to_map_what_the_command_line_refuses() -> None:
    walk = Walk()
    assert walk.poses is not None
    for name in ("inverse", "wxyz", "millimetres"):
        means, _, what = POSES[name]
        with pytest.raises(DatasetError, match=f"{what}.*; check=False builds the map anyway"):
            SegmentMap.from_scans(Reposed(walk, means(walk.poses)))
    there = [geometry.transform(T, walk.scan(k).points) for k, T in enumerate(walk.poses)]
    with pytest.raises(DatasetError, match="already in world coordinates"):
        build_map(there, poses=walk.poses)
    assert len(build_map(there, poses=walk.poses, check=False))


def test_organised_clouds_are_healthy(tmp_path: Path) -> None:
    def organised(points: Float64) -> Float64:
        return np.concatenate([points, np.full((len(points), 3), np.nan)])

    found = examine(open_sequence(raw_folder(tmp_path / "walk", organised)), sample=3)
    assert found.healthy and found.inspection.blank == 0.5
    assert {each.fault for each in found.findings} == {Fault.NO_POSES}


def test_points_for_missing_returns_are_counted_and_are_no_problem(tmp_path: Path) -> None:
    def with_missing(points: Float64) -> Float64:
        return np.concatenate([points, np.full((len(points) // 4, 3), 0.1), [[0.0, 3.4e38, 0.0]]])

    recording = open_sequence(raw_folder(tmp_path / "walk", with_missing))
    found = examine(recording, sample=3)
    assert found.healthy
    output = {finding.fault: str(finding) for finding in found.findings}
    assert output[Fault.MISSING_RETURNS].startswith("20% of the points stand for missing returns")
    assert "infinite or beyond 1e+08 m: they are dropped" in output[Fault.UNUSABLE_POINTS]


def raw_folder(folder: Path, written: Points) -> Path:
    folder.mkdir()
    walk = Walk()
    for i in range(3):
        np.save(folder / f"{i:04d}.npy", written(walk.scan(i).points.astype(np.float64)))
    return folder


def test_a_mounting_that_is_named_is_no_fault() -> None:
    mount = {"mount": {"rpy_deg": [180, 0, 0]}}
    config = LocalCloudConfig.model_validate(mount)
    flipped = scans(Walk(POINTS["z down"][0]))
    assert scan_findings(flipped, posed=True) != [] == scan_findings(flipped, config, posed=True)


@pytest.mark.data
@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(POINTS.keys() - {"ground"}))
def test_wrong_points_of_real_recordings_are_named(name: str) -> None:
    written, fault, _ = POINTS[name]
    recording = open_sequence(real("hdl32e"))
    wrong = [Scan(written(scan.points.astype(np.float64))) for scan in scans(recording)]
    assert scan_findings(wrong)[0].fault is fault


class Rewritten:
    """A real recording with something wrong."""

    def __init__(self, recording: Any, points: Points, poses: Poses) -> None:
        self._recording, self._points = recording, points
        self.poses = poses(recording.poses)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._recording, name)

    def __len__(self) -> int:
        return len(self._recording)

    def scan(self, i: int) -> Scan:
        return Scan(self._points(self._recording.scan(i).points.astype(np.float64)))


@pytest.mark.data
@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "name"),
    [
        *((POINTS, name) for name in ("on its side", "z down", "camera")),
        *((POSES, name) for name in ("inverse", "wxyz", "camera", "other order")),
    ],
)
def test_one_sentence_alone_names_what_is_wrong_with_a_real_recording(
    kind: dict[str, Any], name: str
) -> None:
    """Poses are not blamed for axes, also where a ceiling is like a floor, nor called tilted."""
    folder = real("vlp16_corridor")
    recording = open_sequence(folder / "scans", folder / "poses.tum")
    (wrong, fault, _), right = kind[name], lambda as_is: as_is
    changes = (wrong, right) if kind is POINTS else (right, wrong)
    found = examine(Rewritten(recording, *changes), sample=4)
    assert [one.fault for one in found.findings if one.wrong] == [fault]


DRIVES = [
    ("quadruped", "offices", "mid360"),
    ("handheld", "park", "mid360"),
    ("drone", "meadow", "vlp16"),
]


@pytest.mark.slow
@pytest.mark.parametrize(("platform", "scene", "sensor"), DRIVES)
def test_simulated_drives_of_every_platform_have_nothing_wrong(
    platform: str, scene: str, sensor: str
) -> None:
    pytest.importorskip("embreex", reason="the simulator needs segloc-lab")
    from segloc_lab.simulation import PLATFORMS, SCENES, SENSORS, Conditions, simulate_sessions

    size = {} if scene in ("offices", "warehouse") else {"size_m": 150.0}
    (drive,) = simulate_sessions(
        SCENES[scene](3, **size),
        SENSORS[sensor](),
        [Conditions()],
        length_m=30.0,
        spacing_m=1.5,
        seed=2,
        platform=PLATFORMS[platform](),
    )
    found = [*scan_findings(scans(drive), posed=True), *pose_findings(drive)]
    assert not [str(finding) for finding in found if finding.wrong]
    inverse = Reposed(drive, np.linalg.inv(drive.poses))
    assert platform == "drone" or pose_findings(inverse)[0].fault is Fault.POSES_INVERSE


@pytest.mark.slow
def test_verbs_say_what_is_wrong(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    good, bad = written(tmp_path / "good"), written(tmp_path / "bad", poses=np.linalg.inv)
    down = written(tmp_path / "down", points=POINTS["z down"][0])
    site, poses = tmp_path / "site.segmap", ["--poses", "poses.tum"]
    page = tmp_path / "page.html"
    assert run("doctor", good, *poses, "--html", page) == 0
    assert capsys.readouterr().out.splitlines()[-1] == "no problems found"
    assert page.read_text("utf-8").count("data:image/png;base64,") == 1
    for folder, expected, shown in [
        (bad, "problem: the poses are inverse", "red points lie off scan "),
        (down, "problem: the ground lies", "red points show it"),
    ]:
        assert run("doctor", folder, *poses, "--html", page) == 1
        assert capsys.readouterr().out.splitlines()[1].startswith(expected)
        text = page.read_text("utf-8")
        assert '<p class="bad">1 problem</p>' in text and shown in text
        assert expected.removeprefix("problem: ") in text and "://" not in text
        assert run("map", "build", folder, *poses, "--out", site) == 1
        error = capsys.readouterr().err
        assert expected.removeprefix("problem: ") in error and "--unchecked" in error
        assert not site.exists()
    assert run("map", "build", bad, *poses, "--out", site, "--unchecked") == 0
    assert run("map", "build", good, *poses, "--out", site) == 0
    capsys.readouterr()
    out = ["--map", site, "--select", "3:4", "--out", tmp_path / "out"]
    assert run("localize", down, *out) == 0
    hint = " ".join(capsys.readouterr().err.split())
    assert "2 of 2 queries failed. Likely cause: the ground lies" in hint
    assert run("localize", good, *out) == 0
    assert "not localized" not in capsys.readouterr().err


class OutAndBack(PlazaSequence):
    """A walk out and back beside itself; the poses of the way back are shifted."""

    def __init__(self, shift_m: tuple[float, float] = (0.0, 0.0)) -> None:
        super().__init__(Plaza(1, objects=90), steps=15)
        back = self.poses[::-1] @ geometry.yaw_transform(np.pi, (0.0, 0.5, 0.0))
        self._truth = np.concatenate([self.poses, back])
        self.poses = self._truth.copy()
        self.poses[len(back) :, :2, 3] += shift_m
        self.indices = np.arange(len(self.poses))
        self.stamps = self.indices.astype(np.float64)

    def scan(self, i: int) -> Scan:
        seen = self._plaza.scan(self._truth[i], seed=i)
        return Scan(seen.points[:: len(seen.points) // 20_000], T_odom_sensor=self.poses[i])


@pytest.mark.slow
def test_two_passes_that_disagree_are_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    poses, site = ["--poses", "poses.tum"], tmp_path / "site.segmap"
    off = as_folder(tmp_path / "off", OutAndBack((1.2, 1.6)))
    good = as_folder(tmp_path / "good", OutAndBack())
    assert run("doctor", good, *poses) == 0
    assert "off scans" not in capsys.readouterr().out
    assert run("map", "build", good, *poses, "--out", tmp_path / "good.segmap") == 0

    assert run("doctor", off, *poses) == 1
    found = capsys.readouterr().out
    assert re.search(
        r"problem: scans \d+ to 29 are 2\.0 m and 0\.\d degrees off scans \d+ to", found
    )
    assert "around x" in found and "`segloc align`" in found
    assert run("map", "build", off, *poses, "--out", site) == 1
    error = capsys.readouterr().err
    assert f"`segloc align {off} " in error and "--unchecked" in error
    assert not site.exists()
    assert run("map", "build", off, *poses, "--out", site, "--unchecked") == 0


def corridor(beams: int = 16) -> np.ndarray:
    """Return what a spinning sensor sees in a corridor of 60 x 3 x 2.6 m, (N, 3)."""
    up, turn = np.meshgrid(
        np.radians(np.linspace(-15, 15, beams)), np.radians(np.arange(0, 360, 0.4))
    )
    rays = np.stack([np.cos(up) * np.cos(turn), np.cos(up) * np.sin(turn), np.sin(up)], axis=-1)
    rays = rays.reshape(-1, 3)
    low, high = np.array([-20.0, -1.4, -1.2]), np.array([40.0, 1.6, 1.4])
    reach = (np.where(rays > 0, high, low) / np.where(rays == 0, 1e-9, rays)).min(axis=1)
    return rays * reach[:, None] * np.random.default_rng(0).normal(1.0, 1e-3, (len(rays), 1))


def thin(points: np.ndarray, count: int) -> np.ndarray:
    return points[np.random.default_rng(1).permutation(len(points))[:count]]


def patch(*spans: tuple[float, float]) -> np.ndarray:
    """Return points of a patch of surface with 1 cm of noise."""
    rng = np.random.default_rng(0)
    return rng.uniform(*np.transpose(spans), (6000, 3)) + rng.normal(0, 0.01, (6000, 3))


WALL = patch((2, 2), (-4, 4), (-1.2, 1.8))


@pytest.mark.parametrize("count", [600, 1500, 4000])
def test_nothing_is_claimed_of_axes_where_walls_hide_the_ground(count: int) -> None:
    """A thin level sensor in a corridor that sees one of its walls better than the other."""
    points = corridor()
    seen = points[(points[:, 1] < 1.5) | (points[:, 0] > 4.0)]
    for cloud in (thin(points, count), thin(seen, count)):
        assert not [each for each in scan_findings([Scan(cloud)]) if each.wrong]


def test_one_wall_is_a_single_plane() -> None:
    (finding,) = scan_findings([Scan(WALL)])
    assert finding.fault is Fault.SINGLE_PLANE and finding.wrong
    corner = np.concatenate([WALL, patch((-4, 2), (-4, -4), (-1.2, 1.8))])
    assert Fault.SINGLE_PLANE not in [each.fault for each in scan_findings([Scan(corner)])]


def test_the_points_that_show_a_fault_are_marked(plaza: Plaza) -> None:
    upright = plaza.scan(geometry.yaw_transform(0.3, (0.0, 0.0, 1.7)), posed=False).points
    down = Scan(upright * np.float32([1, -1, -1]))
    (finding,) = scan_findings([down])
    marked = faulty_points(finding, down, LocalCloudConfig())
    assert finding.fault is Fault.Z_DOWN and marked.sum() > 1000
    assert np.abs(down.points[marked, 2] - 1.7).max() < 0.8  # the ground
    box = ((-3.0, -2.0, -2.0), (3.0, 2.0, 2.0))
    body = Finding(Fault.BODY_IN_VIEW, "some", wrong=False, box=box)
    inside = faulty_points(body, down, LocalCloudConfig())
    assert np.array_equal(inside, (np.abs(down.points) <= [3.0, 2.0, 2.0]).all(axis=1))
    assert not faulty_points(Finding(Fault.NO_POSES, "none"), down, LocalCloudConfig()).any()


def test_gravity_that_the_ground_contradicts_is_named() -> None:
    """Also of a sensor that hangs upside down, which the right gravity explains."""
    (scan,) = scans(Walk(posed=False), 1)
    up, down = [0, 0, 1], [0, 0, -1]
    (finding,) = scan_findings([Scan(scan.points, gravity=up)], posed=True)
    assert finding.fault is Fault.GRAVITY and finding.wrong
    assert scan_findings([Scan(scan.points, gravity=down)], posed=True) == []
    hanging = scan.points * np.array([1, -1, -1])
    assert scan_findings([Scan(hanging, gravity=up)], posed=True) == []


@pytest.mark.slow
def test_failures_in_a_map_are_explained_by_gravity_and_by_ground_that_is_cut_off() -> None:
    walk = Walk(posed=False)
    config = Config.preset("profile").model_copy(update={"threads": 1})
    whole = build_map(Walk(), config)
    scan = walk.scan(6)
    found = Localizer(whole).localize(Scan(scan.points, gravity=[0, 0, 1]))
    assert not found.localized and found.reason is Reason.UNKNOWN_ATTITUDE
    assert "the ground lies above the sensor" in found.message
    cut = [Scan(walk.scan(k).points[walk.scan(k).points[:, 2] > 0.05]) for k in (3, 6, 9)]
    refused = [NotLocalized(reason=Reason.NOT_IN_MAP, message="")] * 3
    line = hint(cut, refused, prior_map=whole)
    assert line is not None and "no ground in the scans, but in the map" in line


@pytest.mark.parametrize("fault", [None, Fault.CAMERA_AXES])
def test_beams_tell_exchanged_axes_where_floor_and_walls_are_alike(fault: Fault | None) -> None:
    points = corridor()
    if fault is not None:
        points = geometry.transform(T_CAMERA_SENSOR, points)
    found = scan_findings([Scan(points)])
    assert [each.fault for each in found if each.wrong] == ([fault] if fault else [])
    seen = signature(points)
    assert seen is not None and seen.beams == 16


def arrays(file: Path) -> list[bytes]:
    """What a map holds, except for its texts."""
    site = SegmentMap.load(file)
    held = (site.vectors, site.centroids, site.cloud, site.trajectory)
    return [np.asarray(each).tobytes() for each in held]


@pytest.mark.slow
def test_the_robot_in_its_own_scans_is_named_and_its_box_drops_it_everywhere(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    clean = written(tmp_path / "clean", beside)
    seen = written(tmp_path / "seen", lambda points: with_mast(beside(points)))
    poses, config = ["--poses", "poses.tum"], tmp_path / "robot.yaml"
    assert run("doctor", clean, *poses) == 0
    assert "move with the sensor" not in capsys.readouterr().out
    assert run("doctor", seen, *poses) == 0
    told = capsys.readouterr().out
    assert re.search(r"note: 3.[0-9]% of the points move with the sensor", told)
    config.write_text(re.search(r"`(local_cloud: {body: .*})`", told)[1])
    (low, high) = Config.load(config).local_cloud.body
    assert np.all(np.array(low) < LOW) and np.all(np.array(high) > HIGH)
    assert np.all(np.array(high) - low < np.array(HIGH) - LOW + 0.7)
    assert run("doctor", seen, *poses, "--config", config) == 0
    assert "move with the sensor" not in capsys.readouterr().out
    maps = [tmp_path / f"{name}.segmap" for name in ("clean", "seen")]
    assert run("map", "build", clean, *poses, "--out", maps[0]) == 0
    assert run("map", "build", seen, *poses, "--config", config, "--out", maps[1]) == 0
    assert arrays(maps[0]) == arrays(maps[1])
    answers = []
    for folder, site in zip((clean, seen), maps, strict=True):
        out = tmp_path / f"found_{folder.name}"  # queries drop what the map dropped
        assert run("localize", folder, "--map", site, "--select", "3:5", "--out", out) == 0
        answers.append((out / "poses.tum").read_text())
    assert answers[0] == answers[1] != ""


def test_what_stands_beside_a_robot_at_rest_is_not_the_robot(plaza: Plaza) -> None:
    T = geometry.yaw_transform(0.2, (3.0, -2.0, 1.8))
    still = [masted(plaza.scan(T, seed=k)) for k in range(8)]
    assert body_findings(still, LocalCloudConfig()) == []
    assert pose_findings(MemoryRecording(still)) == []


def test_a_box_around_everything_is_named(plaza: Plaza) -> None:
    scans = [plaza.scan(geometry.yaw_transform(0.0, (k, 0.0, 1.8)), seed=k) for k in range(6)]
    config = LocalCloudConfig(body=((-100.0,) * 3, (100.0,) * 3))
    (finding,) = body_findings(scans, config)
    assert finding.wrong and "holds all points" in finding.what
    some = config.model_copy(update={"body": ((-100.0, -100.0, -100.0), (100.0, 100.0, 2.0))})
    assert all(not each.wrong for each in body_findings([*scans, Scan(scans[0].points[:5])], some))


@pytest.mark.data
@pytest.mark.slow
@pytest.mark.parametrize(
    ("folder", "inside"),
    [
        ("vlp16", (-1.5, 0.0, -0.2)),  # the roof rack of a car
        ("hdl32e", (0.8, -1.2, -0.8)),  # a corner of the roof
        ("vlp16_corridor/scans", (-0.8, 0.0, 0.0)),  # somebody walks behind the robot
    ],
)
def test_the_box_of_what_moves_with_a_real_sensor_is_small(
    folder: str, inside: tuple[float, float, float]
) -> None:
    (found,) = body_findings(
        sample_scans(open_sequence(real(*folder.split("/"))), 20), LocalCloudConfig()
    )
    box = np.array(yaml.safe_load(found.remedy.split("`")[1])["local_cloud"]["body"])
    assert np.all((box[0] < inside) & (inside < box[1]))
    assert np.all(box[1] - box[0] < 1.7)
