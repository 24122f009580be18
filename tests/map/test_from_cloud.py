"""Maps of one finished cloud: scans are found in them, and nothing is made up."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from samples.io import pcd
from samples.plaza import Plaza, PlazaSequence
from samples.real import real
from samples.streams import off_m
from samples.walk import run
from scipy.spatial.transform import Rotation
from segloc_lab.padding import mirrored
from segloc_lab.recordings import posed

from segloc import Config, DatasetError, InvalidScan, Localizer, SegmentMap, geometry
from segloc.config import map_config
from segloc.likelihood import shipped_model
from segloc.map import voxel_cloud
from segloc.map.corridors import between_surfaces
from segloc.map.from_cloud import ThinCloud
from segloc.map.georeference import Georeference
from segloc.map.viewpoints import Occluders, Sight
from segloc.tools.cli.map_info import show
from segloc.tools.datasets import open_sequence
from segloc.tools.io import Trajectory, write_tum
from segloc.types import Float64, Pose

CONFIG = Config(threads=1)
UTM = np.array([500_000.25, 5_400_000.5, 300.0])
TILTED = Rotation.from_euler("xy", [12, 16], degrees=True).as_matrix()
CAMERA = np.array([[0.0, -1, 0], [0, 0, -1], [1, 0, 0]])
IN_PLACE = np.eye(4)


@pytest.fixture(scope="module")
def plaza() -> Plaza:
    """The middle of a plaza: viewpoints are sought in all of a cloud."""
    made = Plaza(0)
    made.points = made.points[np.hypot(made.points[:, 0], made.points[:, 1]) < 30.0]
    return made


@pytest.fixture(scope="module")
def site(plaza: Plaza) -> SegmentMap:
    return SegmentMap.from_cloud(plaza.points, CONFIG)


def errors_m(site: SegmentMap, plaza: Plaza, T_map_plaza: Pose = IN_PLACE) -> list[float]:
    localizer, walk = Localizer(site), PlazaSequence(plaza, 6, posed=False)
    found = [localizer.localize(walk.scan(i)) for i in range(len(walk))]
    return [
        off_m(r.T_map_sensor, T_map_plaza @ T)
        for r, T in zip(found, walk.poses, strict=True)
        if r.T_map_sensor is not None
    ]


def test_single_scans_are_found_in_a_cloud(site: SegmentMap, plaza: Plaza) -> None:
    errors = errors_m(site, plaza)
    assert len(errors) >= 5
    assert max(errors) < 0.5
    assert site.metadata["source"] == "cloud"
    assert site.has_ground and Localizer(site).likelihood.model is shipped_model()


@pytest.mark.data
def test_a_real_room_without_ground_is_found_and_not_believed_in_its_mirror_image() -> None:
    sessions = [real("mid360_lab", day) for day in ("0618", "0622c")]
    mapped, driven = (open_sequence(day / "scans", day / "poses.tum") for day in sessions)
    prior_map = SegmentMap.from_cloud(posed(mapped), CONFIG)
    assert not prior_map.has_ground
    here, there = Localizer(prior_map), Localizer(mirrored(prior_map))
    for k in range(0, len(driven), 8):
        points = driven.scan(k).points
        assert here.localize(points).localized and not there.localize(points).localized


def test_scans_are_on_walls_that_are_as_thick_as_those_of_the_cloud(
    site: SegmentMap, plaza: Plaza
) -> None:
    noise = np.random.default_rng(0).normal(0.0, 0.2, plaza.points.shape)
    thick = SegmentMap.from_cloud(plaza.points + noise, CONFIG)
    early = SegmentMap.from_cloud(plaza.points + noise, CONFIG)
    del early.metadata["thickness_m"]  # as those of 0.3.0
    walk = PlazaSequence(plaza, 6, posed=False)

    def log_ratios(mapped: SegmentMap) -> Float64:
        localizer = Localizer(mapped, CONFIG)
        scene = localizer.describe(walk.scan(2)).scene
        compared = localizer.likelihood.compared(localizer.likelihood.query(scene), walk.poses[2:3])
        return np.array([place.log_ratio for place in compared.places])

    assert log_ratios(thick).max() > log_ratios(early).max() + 1
    assert ", walls 0.1" in str(thick.info())
    assert Localizer(site).likelihood.config == map_config(site).verification


def test_utm_coordinates_keep_centimetres(plaza: Plaza) -> None:
    site = SegmentMap.from_cloud(np.array_split(plaza.points + UTM, 7), CONFIG)
    errors = errors_m(site, plaza, geometry.rigid(np.eye(3), UTM))
    assert len(errors) >= 5
    assert max(errors) < 0.5


def test_the_order_and_the_parts_of_a_cloud_do_not_matter(site: SegmentMap, plaza: Plaza) -> None:
    other = SegmentMap.from_cloud(iter([plaza.points[::2], plaza.points[1::2]]), CONFIG)
    assert len(other) == pytest.approx(len(site), rel=0.1)
    assert len(other.cloud) == pytest.approx(len(site.cloud), rel=0.01)


def test_free_space_is_known_along_a_trajectory_and_on_free_ground(
    site: SegmentMap, plaza: Plaza
) -> None:
    walk = PlazaSequence(plaza, 6)
    measured = SegmentMap.from_cloud(plaza.points, CONFIG, trajectory=walk.poses)
    assert len(measured.sensor_positions) == len(walk)
    assert len(site.sensor_positions) == len(site.trajectory) > 0
    assert len(site.merge(measured).sensor_positions)


def test_viewpoints_stand_on_the_ground_of_every_storey_and_not_on_the_roof() -> None:
    rng = np.random.default_rng(0)
    parts = []
    for low in (0.0, 3.0):  # two halls of 24 x 16 m, one above the other
        xy = rng.uniform([0, 0], [24, 16], (60_000, 2))
        for z in (low, low + 2.8):
            parts.append(np.column_stack([xy, np.full(len(xy), z)]))
        around = rng.uniform(0, 80, 40_000)
        x = np.clip(np.where(around < 40, around, 64 - around), 0, 24)
        y = np.clip(np.where(around < 40, around - 24, 80 - around), 0, 16)
        parts.append(np.column_stack([x, y, rng.uniform(low, low + 2.8, len(x))]))
        for x0, y0 in rng.uniform([3, 3], [21, 13], (6, 2)):  # columns and cupboards
            box = rng.uniform([x0, y0, low], [x0 + 0.8, y0 + 0.5, low + 2.0], (800, 3))
            parts.append(box)
    site = SegmentMap.from_cloud(np.concatenate(parts), CONFIG)
    heights = np.sort(np.unique(np.round(site.trajectory[:, 2, 3], 1)))
    assert np.isclose(heights, 1.0, atol=0.2).any()
    assert np.isclose(heights, 4.0, atol=0.2).any()
    assert (heights < 5.0).all()


def test_what_a_wall_hides_is_not_seen_and_the_wall_is_along_all_its_length() -> None:
    y, z = (grid.ravel() for grid in np.meshgrid(np.arange(-20, 20, 0.25), np.arange(0, 3, 0.25)))
    wall = np.column_stack([np.full(len(y), 2.0), y, z]).astype(np.float32)
    normals = np.tile(np.array([1, 0, 0], np.float32), (len(wall), 1))
    sight = Sight(np.array([0.0, 0.0, 1.5]), Occluders(wall, normals, 0.3))
    assert sight.sees(wall).all()
    assert not sight.sees(wall + [1.5, 0, 0])[np.abs(y) < 15].any()


def test_without_ground_viewpoints_lie_between_what_stands() -> None:
    rng = np.random.default_rng(3)
    s, z = rng.uniform(0, 80, 40_000), rng.uniform(0.3, 5, 40_000)
    side = rng.choice([-7.0, 7.0], len(s))  # two walls along a street that climbs by 8 degrees
    walls = np.column_stack([s, side, z + 0.14 * s]).astype(np.float32)
    far = walls[:4000] + np.array([0, 60, 0], np.float32)  # seen from nowhere between
    eyes = between_surfaces([walls, far[far[:, 1] > 60]], 1.0)
    assert 3 <= len(eyes) <= 12
    inside = np.abs(eyes[:, 1]) < 4
    assert inside[:3].all() and inside.mean() > 0.7
    height = eyes[inside, 2] - 0.14 * eyes[inside, 0]
    assert ((height > 0.3) & (height < 2.0)).all()
    along = np.abs(walls[:, None, 0] - eyes[inside, 0]).min(axis=1)
    assert (np.hypot(along, 7) < 15).mean() > 0.9
    assert not len(between_surfaces([np.zeros((50, 3), np.float32)], 1.0))


def test_a_cloud_without_ground_is_mapped(capsys: pytest.CaptureFixture[str]) -> None:
    rng = np.random.default_rng(1)
    xy = rng.uniform(-20, 20, (30, 2))
    poles = [np.append(p, 0) + rng.uniform([-0.3, -0.3, 0.5], [0.3, 0.3, 4], (400, 3)) for p in xy]
    notes: list[str] = []
    site = SegmentMap.from_cloud(np.concatenate(poles), CONFIG, note=notes.append)
    assert len(site) and len(site.trajectory) == len(site.sensor_positions) > 1
    assert Localizer(site).likelihood.model is shipped_model(ground=False)
    driven = np.tile(np.eye(4), (2, 1, 1))
    measured = SegmentMap.from_cloud(np.concatenate(poles), CONFIG, trajectory=driven)
    assert not measured.has_ground
    (told,) = notes
    assert "no ground: 0.0% of the area" in told and "--trajectory" in told
    assert f"{len(site.trajectory)} viewpoints lie between" in told
    show(site, "")
    assert f"{len(site.trajectory)} between what stands" in capsys.readouterr().out
    site.metadata["viewpoints"] = "lattice"  # of version 0.3.0: no free space is known
    assert not len(site.sensor_positions)


def test_what_is_no_cloud_is_refused() -> None:
    with pytest.raises(DatasetError, match="no points"):
        SegmentMap.from_cloud(np.full((5, 3), np.nan), CONFIG)
    with pytest.raises(InvalidScan, match="floating point"):
        SegmentMap.from_cloud(np.zeros((5, 3), np.int64), CONFIG)
    with pytest.raises(DatasetError, match="no points: 5 exactly 0, 0, 0"):
        SegmentMap.from_cloud(np.zeros((5, 3)), CONFIG)
    with pytest.raises(DatasetError, match="z axis"):
        SegmentMap.from_cloud(np.ones((5, 3)), CONFIG)


def pcd_file(path: Path, points: Float64, size: int = 8) -> Path:
    rows = np.rec.fromarrays(points.T.astype(f"<f{size}"), names="x,y,z")
    path.write_bytes(pcd(rows, "binary"))
    return path


@pytest.mark.parametrize(
    ("points", "cause", "remedy"),
    [
        (lambda p: 1000 * p, "millimetres", "divide it by 1000"),
        (lambda p: 100 * p, "centimetres", "divide it by 100;"),
        (lambda p: p @ CAMERA.T, "a camera's", "--level"),
        (lambda p: p[:, [1, 2, 0]], "the y axis points up", "--level"),
        (lambda p: p * [1, -1, -1], "the z axis points down", "--level"),
        (lambda p: p @ TILTED.T, "tilted by 19.9 degrees", "--level"),
        (lambda p: np.vstack([p, p + 2e5]), "another frame or unit", "--unchecked"),
    ],
)
def test_a_cloud_in_another_unit_or_frame_is_refused_before_the_work(
    plaza: Plaza,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    points: Callable[[Float64], Float64],
    cause: str,
    remedy: str,
) -> None:
    file, out = pcd_file(tmp_path / "cloud.pcd", points(plaza.points)), tmp_path / "a.segmap"
    assert run("map", "from-cloud", file, "--out", out) == 1
    (error,) = capsys.readouterr().err.splitlines()
    assert cause in error and remedy in error
    assert not out.exists()


def test_submaps_are_mapped_in_one_call_and_the_work_is_told_before(
    site: SegmentMap,
    plaza: Plaza,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("segloc.map.from_cloud._LONG_S", 0.1)
    poses = np.stack([geometry.yaw_transform(0.5 * k, (3.0 * k, 1.0, 0.0)) for k in range(3)])
    files = []
    for k, part in enumerate(np.array_split(plaza.points, 3)):
        inside = geometry.transform(geometry.inverse(poses[k]), part)
        files.append(pcd_file(tmp_path / f"{k}.pcd", inside))
    write_tum(tmp_path / "submaps.tum", Trajectory(np.arange(3.0), poses))
    placed, out = ("--poses", tmp_path / "submaps.tum"), tmp_path / "a.segmap"
    told = ("--epsg", 25832, "--origin", "500000,5400000")
    assert run("map", "from-cloud", *files, *placed, *told, "--out", out, "--threads", 1) == 0
    work = capsys.readouterr().err.splitlines()[0]
    assert f"{len(plaza.points) / 1e6:.1f} million points in 3 files by their headers" in work
    assert "minutes of processor time" in work and "GB of memory" in work
    built = SegmentMap.load(out)
    assert built.metadata["sequence"] == "0.pcd and 2 more"
    assert Georeference.of(built.metadata) == Georeference(25832, (5e5, 5.4e6, 0.0))
    assert len(built) == pytest.approx(len(site), rel=0.1)


def test_digits_that_float32_lost_are_refused_with_their_step(
    plaza: Plaza, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file, out = pcd_file(tmp_path / "utm.pcd", plaza.points + UTM, size=4), tmp_path / "a.segmap"
    assert run("map", "from-cloud", file, "--out", out) == 1
    assert "y comes in steps of 0.5 m" in capsys.readouterr().err
    assert run("map", "from-cloud", file, "--out", out, "--unchecked") == 0


@pytest.mark.parametrize("R", [TILTED, CAMERA @ TILTED])
def test_a_turned_cloud_is_levelled_and_answers_are_known_in_its_own_frame(
    plaza: Plaza, tmp_path: Path, R: Float64
) -> None:
    file, out = pcd_file(tmp_path / "cloud.pcd", plaza.points @ R.T), tmp_path / "a.segmap"
    assert run("map", "from-cloud", file, "--out", out, "--level", "--threads", 1) == 0
    site = SegmentMap.load(out)
    T_map_cloud = np.array(json.loads(site.metadata["T_map_cloud"]))
    up = T_map_cloud[:3, :3] @ R[:, 2]
    assert np.degrees(np.arccos(up[2])) < 0.5
    errors = errors_m(site, plaza, T_map_cloud @ geometry.rigid(R, np.zeros(3)))
    assert len(errors) >= 5
    assert max(errors) < 0.5


def test_trees_without_ground_are_levelled_by_the_lie_of_the_land() -> None:
    rng, R = np.random.default_rng(2), TILTED
    feet = np.column_stack([rng.uniform(0, 200, (300, 2)), np.zeros(300)])
    feet[:, 2] = np.sin(feet[:, 0] / 10)
    trees = feet[:, None] + rng.uniform([-0.6, -0.6, 0.4], [0.6, 0.6, 6], (300, 300, 3))
    cloud, notes = trees.reshape(-1, 3) @ R.T, list[str]()
    SegmentMap.from_cloud(cloud, CONFIG, note=notes.append)
    assert any("a slope of 20 degrees" in note and "--level" in note for note in notes)
    level = Config(threads=1, mapping={"level": True})
    site = SegmentMap.from_cloud(cloud, level, note=notes.append)
    up = site.T_map_cloud[:3, :3] @ R[:, 2]
    assert np.degrees(np.arccos(up[2])) < 1.0
    assert any("by the lie of the land" in note for note in notes)
    with pytest.raises(DatasetError, match="no plane"):
        SegmentMap.from_cloud(cloud[:3000], level)


def test_a_trajectory_is_turned_with_its_cloud(plaza: Plaza) -> None:
    walk, T = PlazaSequence(plaza, 6), np.eye(4)
    T[:3, :3] = TILTED
    config = Config(threads=1, mapping={"level": True})
    site = SegmentMap.from_cloud(plaza.points @ TILTED.T, config, trajectory=T @ walk.poses)
    np.testing.assert_allclose(site.trajectory[:, 2, 3], walk.poses[:, 2, 3], atol=0.3)


def test_stray_points_are_left_out_and_counted(
    site: SegmentMap, plaza: Plaza, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    strays = [[7e5, 0, 0], [0, 0, -1e12], [1e300, 1, 1], [np.nan, 0, 0], [0, np.inf, 0], [0, 0, 0]]
    points = np.vstack([strays[-1:], plaza.points[:99], strays[:-1], plaza.points[99:]])
    file, out = pcd_file(tmp_path / "cloud.pcd", points), tmp_path / "a.segmap"
    assert run("map", "from-cloud", file, "--out", out) == 0
    told = capsys.readouterr().err
    assert "left out: 2 not finite, 1 exactly 0, 0, 0, 3 more than 100 km from the others" in told
    np.testing.assert_array_equal(SegmentMap.load(out).vectors, site.vectors)


def test_there_is_nothing_to_remark_on_a_good_cloud(plaza: Plaza) -> None:
    notes: list[str] = []
    site = SegmentMap.from_cloud(plaza.points, CONFIG, note=notes.append)
    assert not notes and "frame" not in site.metadata


def test_a_thin_cloud_holds_a_point_a_voxel() -> None:
    cloud = ThinCloud()
    rng = np.random.default_rng(2)
    for _ in range(5):
        cloud.add(rng.uniform(0, 2, (50_000, 3)) + UTM)
    cloud.thin()
    assert len(cloud) <= 21**3
    assert np.abs(cloud.near(np.zeros(3), 10.0)).max() < 2.5


def test_large_clouds_are_thinned_in_slabs_to_the_same_points(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    points = np.random.default_rng(3).normal(0, 5, (20_000, 3)).astype(np.float32)
    points[:5_000, 0] = 0.25  # a wall, of which all points lie in one column of voxels
    whole = voxel_cloud.thin(points, UTM, 0.3)
    monkeypatch.setattr(voxel_cloud, "_AT_ONCE", 1_000)
    np.testing.assert_array_equal(voxel_cloud.thin(points, UTM, 0.3), whole)
