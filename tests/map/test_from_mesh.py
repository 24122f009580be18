"""Maps of plans: scans of the furnished building are found, and a bad plan has one clear error."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from samples.storey import box, furnished, scan_in, storey, write_stl
from samples.walk import run

from segloc import (
    Config,
    ConfigError,
    DatasetError,
    InvalidScan,
    Localizer,
    Scan,
    SegmentMap,
    geometry,
)
from segloc.map.from_mesh import build_from_mesh
from segloc.map.plan_tour import PlanMesh, free_floors, storeys
from segloc.types import Float64

CONFIG = Config(threads=1)
SHIFT = np.array([3000.0, -2000.0, 100.0])
POSES = [
    geometry.yaw_transform(yaw, (x, y, 1.2))
    for x, y, yaw in ((3.0, 5.5, 0.3), (10.0, 5.4, 2.0), (15.0, 5.6, 4.0), (20.0, 5.5, 1.0))
]


@pytest.fixture(scope="module")
def plan() -> Float64:
    return storey(3)


@pytest.fixture(scope="module")
def site(plan: Float64) -> SegmentMap:
    return build_from_mesh(plan + SHIFT, CONFIG, tolerance=0.03)


def drives(built: Float64, north_m: float = 0.0) -> Iterator[list[Scan]]:
    """Four scans each along the corridor, with odometry in a frame of its own."""
    for k, pose in enumerate(POSES):
        T = geometry.yaw_transform(0, (0, north_m, 0)) @ pose
        path = [geometry.yaw_transform(0, (1.2 * i, 0, 0)) @ T for i in range(-2, 2)]
        scans = [scan_in(built, pose, 10 * k + i) for i, pose in enumerate(path)]
        odometry = [geometry.inverse(path[0]) @ pose for pose in path]
        yield [Scan(s.points, T_odom_sensor=T) for s, T in zip(scans, odometry, strict=True)]


def test_drives_in_the_furnished_building_are_found(site: SegmentMap, plan: Float64) -> None:
    localizer = Localizer(site)
    found = [localizer.localize(scans) for scans in drives(furnished(plan, 1))]
    errors = [
        np.linalg.norm(result.T_map_sensor[:3, 3] - T[:3, 3] - SHIFT - [1.2, 0, 0])
        for result, T in zip(found, POSES, strict=True)
        if result.T_map_sensor is not None
    ]
    assert len(errors) >= 3
    assert max(errors) < 0.1


def test_the_map_knows_that_it_is_of_a_plan(site: SegmentMap, tmp_path: Path) -> None:
    site.save(tmp_path / "plan.segmap")
    again = SegmentMap.load(tmp_path / "plan.segmap")
    assert again.metadata["source"] == "plan"
    assert again.metadata["tolerance_m"] == "0.03"
    assert not again.is_driven.any()
    text = str(again.info())
    assert "a plan, as built within 0.03 m" in text
    assert any("made from a plan" in note for note in Localizer(again).notes)


def test_scans_of_another_building_are_not_found(site: SegmentMap) -> None:
    localizer = Localizer(site)
    other = furnished(storey(8), 2) * [1.2, 1.4, 1.1]  # else shell and corridor would be the same
    assert not any(localizer.localize(scans).localized for scans in drives(other, 2.2))


def test_a_way_leads_through_all_rooms_of_each_storey(plan: Float64) -> None:
    both = np.concatenate([plan, plan + [0, 0, 3.05]]).astype(np.float32)
    found = list(storeys(free_floors(PlanMesh.of(both), 1.0)))
    assert len(found) == 2  # and no roof
    for k, floors in enumerate(found):
        (floor,) = floors  # rooms are connected by doorways
        assert 170 < floor.area_m2 < 264
        way = floor.way()
        assert np.abs(way[:, 2] - 1.0 - 3.05 * k).max() < 0.01
        assert floor.clearance.min() > 0.3
        near = np.linalg.norm(floor.eyes[:, None, :2] - way[None, :, :2], axis=2).min(axis=1)
        assert near.max() < 4.0


def test_no_viewpoint_lies_within_a_solid() -> None:
    block = box((30.0, 0.0, 0.0), (40.0, 10.0, 3.0))
    plan = np.concatenate([storey(3), block]).astype(np.float32)
    floors = free_floors(PlanMesh.of(plan), 1.0)
    assert floors and all(floor.eyes[:, 0].max() < 24 for floor in floors)


@pytest.mark.parametrize(
    ("triangles", "error", "message"),
    [
        (np.zeros((0, 3, 3)), DatasetError, "no triangles"),
        (np.full((5, 3, 3), np.nan), DatasetError, "no triangles"),
        (np.zeros((5, 3)), InvalidScan, r"\(T, 3, 3\)"),
        (np.zeros((5, 3, 3), np.int64), InvalidScan, "floating point"),
        (np.zeros((5, 3, 3)), DatasetError, "no floor"),
        (np.eye(3)[None], DatasetError, "no floor"),
        (np.array([np.eye(3), np.eye(3) + 1e6]), DatasetError, "km apart"),
        (np.array([np.eye(3), 2600.0 * np.eye(3)]), DatasetError, "2600 m high"),
        (1e-3 * storey(3), DatasetError, "no floor"),
    ],
)
def test_a_bad_plan_has_one_clear_error(
    triangles: Float64, error: type[Exception], message: str
) -> None:
    with pytest.raises(error, match=message):
        build_from_mesh(triangles, CONFIG)


@pytest.mark.parametrize("lengths", [{"tolerance": 0.0}, {"sensor_height": np.nan}])
def test_lengths_are_checked(lengths: dict[str, float], plan: Float64) -> None:
    with pytest.raises(ConfigError, match=next(iter(lengths))):
        build_from_mesh(plan, CONFIG, **lengths)


def test_broken_triangles_are_left_out_with_a_note(plan: Float64) -> None:
    notes: list[str] = []
    broken = np.concatenate([plan, np.full((2, 3, 3), np.inf)])
    with pytest.raises(DatasetError, match="no floor"):
        build_from_mesh(broken[-40:], CONFIG, note=notes.append)
    assert notes == ["2 triangles left out: corners are not finite"]


def test_the_command(tmp_path: Path, plan: Float64, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("trimesh")
    write_stl(tmp_path / "plan.stl", 1000 * plan)
    out = tmp_path / "plan.segmap"
    assert run("map", "from-mesh", tmp_path / "plan.stl", "--out", out) == 1
    assert "pass --unit" in capsys.readouterr().err
    told = ("--unit", "mm", "--tolerance", 0.02, "--threads", 1)
    assert run("map", "from-mesh", tmp_path / "plan.stl", *told, "--out", out) == 0
    shown = capsys.readouterr()
    assert "viewpoints" in shown.err
    assert "within 0.02 m (experimental)" in shown.out
    scan = scan_in(furnished(plan, 1), POSES[1], 1)
    assert isinstance(scan, Scan)
    np.save(tmp_path / "scan.npy", scan.points)
    assert run("localize", tmp_path / "scan.npy", "--map", out, "--threads", 1) == 0
    shown = capsys.readouterr()
    assert "localized at x" in shown.out
    assert "made from a plan" in shown.err
