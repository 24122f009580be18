"""The same faults in a folder, a KITTI sequence and a bag: each is named with its place."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from samples.datasets import START, Drive, bag_writer, float_rows, kitti, ones
from samples.plaza import Plaza
from samples.real import real
from samples.walk import run

from segloc import Config, SegmentMap, geometry
from segloc.map.build import build_map
from segloc.tools.datasets import open_sequence
from segloc.tools.datasets.inspection import inspect
from segloc.tools.io import Trajectory, write_scan, write_tum
from segloc.types import Float64

COUNT = 12
DRIVE = Drive.make(COUNT)
HDL32E = np.linspace(-30.67, 10.67, 32)
VLP16 = np.linspace(-15.0, 15.0, 16)
Writer = Callable[[Path, list[Float64], Float64], Path]


def seen(beams: Float64, step_deg: float = 1.0) -> Float64:
    """What a sensor 1.8 m above the ground sees of a round yard of 20 m with walls."""
    elevation, azimuth = np.radians(
        np.meshgrid(beams, np.arange(0.0, 360.0, step_deg), indexing="ij")
    )
    down = np.maximum(-np.sin(elevation), 1e-9)
    reach = np.minimum(20.0 / np.cos(elevation), 1.8 / down)
    directions = [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth),
                  np.sin(elevation)]  # fmt: skip
    return (reach * np.array(directions)).reshape(3, -1).T


def folder(root: Path, clouds: list[Float64], poses: Float64) -> Path:
    path = root / "scans"
    path.mkdir()
    for i, cloud in enumerate(clouds):
        np.save(path / f"{i:06d}.npy", cloud.astype(np.float32))
    write_tum(path / "poses.tum", Trajectory(np.arange(len(clouds), dtype=float), poses))
    return path


def kitti_sequence(root: Path, clouds: list[Float64], poses: Float64) -> Path:
    path = kitti(root, Drive.make(len(clouds)))
    for i, cloud in enumerate(clouds):
        (path / "velodyne" / f"{i:06d}.bin").write_bytes(float_rows(cloud, ones(cloud)))
    write_tum(path / "poses.tum", Trajectory(np.arange(len(clouds), dtype=float), poses))
    return path


def bag(root: Path, clouds: list[Float64], poses: Float64) -> Path:
    writer = bag_writer("sqlite3")
    for i, (cloud, pose) in enumerate(zip(clouds, poses, strict=True)):
        writer.cloud("/points", START + 0.1 * i, cloud)
        writer.odometry("/odom", START + 0.1 * i, pose, "lidar")
    return writer.write(root / "drive")


WRITERS: dict[str, tuple[Writer, str]] = {
    "folder": (folder, "{:06d}.npy"),
    "kitti": (kitti_sequence, "{:06d}.bin"),
    "bag": (bag, "message {} of /points"),
}
each_format = pytest.mark.parametrize("name", WRITERS)


def problems(path: Path, sample: int = 20) -> str:
    found = inspect(open_sequence(path, "none"), sample)
    return "\n".join([*found.problems, *found.sensor_changes])


@pytest.mark.parametrize(("lost_s", "gaps"), [(0.0, 0), (9.0, 1)])
def test_poses_that_come_seldom_are_no_gaps(lost_s: float, gaps: int, tmp_path: Path) -> None:
    """Those of key frames are seconds apart; one of them that is much longer is named."""
    writer = bag_writer("mcap")
    for i, pose in enumerate(DRIVE.poses):
        stamp = START + 1.5 * i + (lost_s if i > 7 else 0.0)
        writer.cloud("/points", stamp, seen(VLP16))
        writer.odometry("/odom", stamp, pose, "lidar")
    recording = open_sequence(writer.write(tmp_path / "drive"))
    output = "\n".join(inspect(recording, 4).problems)
    assert output.count("gaps in the poses, the longest 10.5 s") == gaps
    assert output.count("gaps in the poses") == gaps


@each_format
@pytest.mark.parametrize("change", [1, 6, 11])
def test_a_sensor_that_changes_is_named_with_the_first_scan(
    name: str, change: int, tmp_path: Path
) -> None:
    write, place = WRITERS[name]
    clouds = [seen(HDL32E)] * change + [seen(VLP16)] * (COUNT - change)
    found = problems(write(tmp_path, clouds, DRIVE.poses), sample=4)
    where = place.format(change)
    assert (
        f"{where}: another sensor from here on: 3D, 16 beams, -15.0 to 15.0 deg; "
        "before: 3D, 32 beams, -30.7 to 10.7 deg"
    ) in found


@each_format
def test_one_scan_of_another_sensor(name: str, tmp_path: Path) -> None:
    write, place = WRITERS[name]
    clouds = [seen(HDL32E)] * COUNT
    clouds[5] = seen(VLP16, 0.5)
    found = problems(write(tmp_path, clouds, DRIVE.poses)).splitlines()
    changes = [line for line in found if "another sensor" in line]
    assert len(changes) == 2
    assert place.format(5) in changes[0]
    assert place.format(6) in changes[1]
    flat = seen(np.zeros(1), 0.1)
    clouds[5] = flat
    (tmp_path / "flat").mkdir()
    found = problems(write(tmp_path / "flat", clouds, DRIVE.poses)).splitlines()
    assert any(f"{place.format(5)}: another sensor from here on: 2D" in line for line in found)


@pytest.mark.slow
@each_format
def test_bursts_of_nan_are_counted_and_left_out(name: str, tmp_path: Path, plaza: Plaza) -> None:
    """NaN is no return: scans without any point are named, and a map is made of the rest."""
    write, place = WRITERS[name]
    poses = np.stack([geometry.yaw_transform(0.0, (2.0 * k - 12, 0.0, 1.8)) for k in range(COUNT)])
    clouds = [plaza.scan(pose).points.astype(np.float64) for pose in poses]
    for i, share in ((4, 1.0), (5, 1.0), (6, 0.5)):
        clouds[i] = clouds[i].copy()
        clouds[i][: int(share * len(clouds[i]))] = np.nan
    path = write(tmp_path, clouds, poses)
    found = problems(path)
    for i in (4, 5):
        assert f"{place.format(i)}: 0 points, the median is" in found
    assert f"{place.format(6)}: " not in found
    assert "another sensor" not in found
    if name != "folder":
        return
    config = Config.load(None, "geo").model_copy(update={"threads": 1})
    prior_map = build_map(open_sequence(path, "poses.tum"), config)
    assert isinstance(prior_map, SegmentMap)
    assert len(prior_map) > 20
    assert np.isfinite(prior_map.centroids).all()


def test_info_shows_pose_files_and_scans_without_points(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = folder(tmp_path, [np.zeros((0, 3))] * 3, DRIVE.poses[:3])
    (tmp_path / "scans.odometry.tum").write_text("")
    run("info", path)
    output = capsys.readouterr().out
    assert "problem: no points in any of the 3 scans" in output
    for name in ("poses.tum", "scans.odometry.tum"):
        assert f"note: {name} beside the scans may hold their poses: --poses {name}" in output


def test_real_sensors_are_told_from_each_other_and_from_nobody_else(tmp_path: Path) -> None:
    pytest.importorskip("laspy")
    both = tmp_path / "both"
    both.mkdir()
    for i, (source, number) in enumerate([("vlp16", 3), ("vlp16", 25), ("hdl32e", 4)]):
        scan = open_sequence(real(source)).scan(number)
        write_scan(both / f"{i:02d}.npy", scan.points)
    assert "02.npy: another sensor from here on: 3D, 32 beams" in problems(both)
    for source in ("vlp16", "hdl32e", "hdl64_drive"):
        assert "another sensor" not in problems(real(source), sample=4)
    assert "another sensor" not in problems(real("kitti00", "keyframes"))
