"""Every dataset's format: points, poses and stamps, against the truth."""

from __future__ import annotations

import pickle
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from samples.datasets import (
    HELIPR_POINTS,
    START,
    Drive,
    boreas,
    helipr,
    kitti,
    kitti_raw,
    mulran,
    nclt,
    newer_college,
    nuscenes,
    wild_places,
)

from segloc import geometry
from segloc.errors import DatasetError
from segloc.tools.datasets import open_sequence, poses_at
from segloc.tools.io import Trajectory, write_tum

DRIVE = Drive.make()


def sensor_of(name: str) -> Callable[[Path, Drive], Path]:
    return lambda root, drive: helipr(root, drive, name)


WRITERS: dict[str, tuple[Callable[[Path, Drive], Path], str]] = {
    "KITTI odometry": (kitti, "velodyne"),
    "KITTI raw": (kitti_raw, "velodyne_points/data"),
    "Newer College": (newer_college, "raw_format/ouster_scan"),
    "MulRan": (mulran, "Ouster"),
    "NCLT": (nclt, "velodyne_sync"),
    "Boreas": (boreas, "lidar"),
    "nuScenes": (nuscenes, ""),
    "Wild-Places": (wild_places, "Clouds"),
} | {f"HeLiPR {name}": (sensor_of(name), f"LiDAR/{name}") for name in HELIPR_POINTS}


@pytest.mark.parametrize("name", WRITERS)
def test_points_poses_and_stamps_are_those_that_were_recorded(name: str, tmp_path: Path) -> None:
    write, inner = WRITERS[name]
    path = write(tmp_path, DRIVE)
    sequence = open_sequence(path)
    assert sequence.format == name.split(" ")[0] if "HeLiPR" in name else name
    assert sequence.indices.tolist() == list(range(len(DRIVE.stamps)))
    np.testing.assert_allclose(np.diff(sequence.stamps), 0.1, atol=1e-5)
    steps = geometry.inverse(sequence.poses[0]) @ sequence.poses
    truth = geometry.inverse(DRIVE.poses[0]) @ DRIVE.poses
    np.testing.assert_allclose(steps, truth, atol=2e-5)
    assert sequence.poses[0, 2, 2] > 0.99  # up is up
    clouds = []
    for i in range(len(sequence)):
        scan = sequence.scan(i)
        assert len(scan) == len(DRIVE.landmarks)
        assert scan.stamp == sequence.stamps[i]
        clouds.append(geometry.transform(scan.T_odom_sensor, scan.points))
        np.testing.assert_allclose(
            scan.points, DRIVE.seen(i), atol=3.5e-3
        )  # NCLT has steps of 5 mm
    np.testing.assert_allclose(clouds[-1], clouds[0], atol=8e-3)
    if inner:  # a path to the scans is a path to the recording
        within = open_sequence(path / inner)
        assert (within.format, within.name) == (sequence.format, sequence.name)
    assert len(pickle.loads(pickle.dumps(sequence)).scan(1)) == len(DRIVE.landmarks)
    part = open_sequence(path, select="1:2")
    assert part.poses is not None
    assert part.indices.tolist() == [1, 2]
    np.testing.assert_array_equal(part.scan(0).points, sequence.scan(1).points)
    without = open_sequence(path, poses="none")
    assert without.poses is None
    assert without.scan(0).T_odom_sensor is None


@pytest.mark.parametrize("name", WRITERS)
def test_a_scan_that_was_cut_off_is_named(name: str, tmp_path: Path) -> None:
    write, inner = WRITERS[name]
    path = write(tmp_path, DRIVE)
    folder = path / (inner or "sweeps/LIDAR_TOP")
    victim = sorted(folder.iterdir())[2]
    victim.write_bytes(victim.read_bytes()[:-3])
    sequence = open_sequence(path)
    assert len(sequence.scan(1)) == len(DRIVE.landmarks)
    with pytest.raises(DatasetError, match=victim.name.replace(".", r"\.")) as caught:
        sequence.scan(2)
    assert "\n" not in str(caught.value)


def test_nclt_far_points_are_not_negative(tmp_path: Path) -> None:
    """Values of 32 768 and more, which int16 wraps: from 63.84 m on."""
    drive = Drive(DRIVE.stamps, np.array([[70.0, 80.0, 1.0], [-70.0, -80.0, 1.0]]))
    points = open_sequence(nclt(tmp_path, drive)).scan(0).points
    np.testing.assert_allclose(points, drive.seen(0), atol=3.5e-3)


def test_the_early_format_of_aeva(tmp_path: Path) -> None:
    sequence = open_sequence(helipr(tmp_path, DRIVE, "Aeva", early=True))
    np.testing.assert_allclose(sequence.scan(1).points, DRIVE.seen(1), atol=1e-5)


def test_several_sensors_have_to_be_chosen_from(tmp_path: Path) -> None:
    path = helipr(tmp_path, DRIVE, "Ouster", "Avia")
    with pytest.raises(DatasetError, match=r"several sensors.*--topic Ouster\|Avia"):
        open_sequence(path)
    assert open_sequence(path, topic="Avia").frame == "Avia"
    assert open_sequence(path / "LiDAR" / "Ouster").frame == "Ouster"
    with pytest.raises(DatasetError, match="no 'Aeva'; available: Ouster, Avia"):
        open_sequence(path, topic="Aeva")
    with pytest.raises(DatasetError, match="KITTI odometry has no topics, so no 'x'"):
        open_sequence(kitti(tmp_path, DRIVE), topic="x")


def test_poses_of_the_user_by_time_and_by_number(tmp_path: Path) -> None:
    path = mulran(tmp_path, DRIVE)
    late = DRIVE.stamps[1] + 0.02  # scan 0 and 1 are before them
    times = np.arange(late, DRIVE.stamps[-1] + 0.05, 0.03)
    poses = np.array([DRIVE.pose(t) for t in times])
    write_tum(tmp_path / "odometry.tum", Trajectory(times, poses))
    sequence = open_sequence(path, poses=str(tmp_path / "odometry.tum"))
    assert sequence.indices.tolist() == [2, 3, 4]
    assert sequence.notes[0].startswith(
        f"2 of 5 scans dropped: no pose in {tmp_path / 'odometry.tum'}"
    )
    np.testing.assert_allclose(sequence.poses, DRIVE.poses[2:], atol=2e-5)
    np.testing.assert_allclose(sequence.scan(0).points, DRIVE.seen(2), atol=1e-5)
    write_tum(tmp_path / "index.tum", Trajectory(np.arange(5.0), DRIVE.poses))
    np.testing.assert_allclose(
        open_sequence(path, poses=str(tmp_path / "index.tum")).poses, DRIVE.poses, atol=1e-8
    )


def test_truth_is_matched_scan_by_scan(tmp_path: Path) -> None:
    """Though a recording's own poses leave out its first scan, and the truth its last."""
    path = mulran(tmp_path, DRIVE)
    file = path / "global_pose.csv"
    rows = file.read_text().splitlines()
    kept = [row for row in rows if int(row.split(",")[0]) * 1e-9 > START + 0.05]
    file.write_text("\n".join(kept))
    sequence = open_sequence(path)
    assert sequence.indices.tolist() == [1, 2, 3, 4]
    truth = tmp_path / "truth.tum"
    write_tum(truth, Trajectory(DRIVE.stamps[:4], DRIVE.poses[:4]))
    known = poses_at(sequence, path, truth)
    np.testing.assert_allclose(known[:3], DRIVE.poses[1:4], atol=1e-6)
    assert np.isnan(known[3]).all()
    write_tum(truth, Trajectory(DRIVE.stamps, DRIVE.poses))
    np.testing.assert_allclose(poses_at(sequence, path, truth), DRIVE.poses[1:], atol=1e-6)


def test_poses_on_another_clock_are_refused(tmp_path: Path) -> None:
    path = mulran(tmp_path, DRIVE)
    write_tum(tmp_path / "gps.tum", Trajectory(DRIVE.stamps - START + 0.5, DRIVE.poses))
    with pytest.raises(DatasetError, match=r"gps\.tum: no pose for any scan: poses are from 0\.5"):
        open_sequence(path, poses=str(tmp_path / "gps.tum"))


def test_a_gap_in_the_poses_is_not_bridged(tmp_path: Path) -> None:
    drive = Drive(START + 0.5 * np.arange(12), DRIVE.landmarks)
    path = mulran(tmp_path, drive)
    file = path / "global_pose.csv"
    lines = file.read_text().splitlines()
    kept = [
        line for line in lines if not START + 1.9 < int(line.split(",")[0]) * 1e-9 < START + 3.6
    ]
    file.write_text("\n".join(kept))
    sequence = open_sequence(path)
    assert sequence.indices.tolist() == [0, 1, 2, 3, 8, 9, 10, 11]
    assert sequence.notes[0].startswith("4 of 12 scans dropped: no pose in global_pose.csv")


def test_points_with_times_are_brought_to_the_stamp(tmp_path: Path) -> None:
    """Each landmark is seen from where the sensor was at the point's own time."""
    path = boreas(tmp_path, DRIVE)
    for stamp in DRIVE.stamps:
        times = np.linspace(-0.05, 0.05, len(DRIVE.landmarks)).astype(np.float32)
        seen = DRIVE.swept(stamp + times.astype(np.float64))
        rows = np.column_stack([seen, np.ones((len(seen), 2)), times]).astype("<f4")
        (path / "lidar" / f"{round(stamp * 1e6)}.bin").write_bytes(rows.tobytes())
    for i in (1, 2, 3):  # inside the poses
        np.testing.assert_allclose(open_sequence(path).scan(i).points, DRIVE.seen(i), atol=2e-4)
    raw = open_sequence(path, deskew=False).scan(2)
    assert raw.times is not None
    assert np.abs(raw.points - DRIVE.seen(2)).max() > 0.1
    assert open_sequence(path).scan(2).times is None


def test_missing_times_and_calibration(tmp_path: Path) -> None:
    path = kitti(tmp_path, DRIVE)
    (path / "times.txt").write_text("0.0\n0.1\n")
    sequence = open_sequence(path)
    assert sequence.stamps is None
    assert sequence.notes == ("times.txt has 2 rows, but scans go up to 4: not used",)
    (path / "times.txt").unlink()
    assert open_sequence(path).notes == ("times.txt is missing: scans have no times",)
    text = (path / "calib.txt").read_text()
    (path / "calib.txt").write_text(text.replace("Tr", "Tx"))
    unposed = open_sequence(path)
    assert unposed.poses is None
    assert any("calib.txt: no line 'Tr'" in note for note in unposed.notes)
    raw = kitti_raw(tmp_path, DRIVE)
    (raw / "velodyne_points" / "timestamps.txt").write_text("yesterday\n")
    with pytest.raises(DatasetError, match=r"timestamps\.txt: "):
        open_sequence(raw)
    (raw.parent / "calib_imu_to_velo.txt").unlink()
    (raw / "velodyne_points" / "timestamps.txt").unlink()
    (note,) = [note for note in open_sequence(raw).notes if "calib" in note]
    assert "calib_imu_to_velo.txt is missing" in note


@pytest.mark.parametrize("name", ["MulRan", "NCLT", "Boreas", "Newer College", "HeLiPR Avia"])
@pytest.mark.parametrize("harm", [b"", b"\n\n", b"x,y\n", b"1,2,3\n"])
def test_pose_files_that_are_none(name: str, harm: bytes, tmp_path: Path) -> None:
    path = WRITERS[name][0](tmp_path, DRIVE)
    file = next(file for file in path.rglob("*") if file.suffix in (".csv", ".txt"))
    file.write_bytes(harm)
    assert open_sequence(path, poses="none").poses is None  # read on request only
    sequence = open_sequence(path)
    assert sequence.poses is None
    assert [file.name in note and "\n" not in note for note in sequence.notes] == [True]


@pytest.mark.parametrize("name", ["MulRan", "NCLT", "Boreas", "Newer College"])
def test_a_table_with_names_is_read_by_them(name: str, tmp_path: Path) -> None:
    """Not as the set's own layout, whatever the file is called."""
    path, table = WRITERS[name][0](tmp_path, DRIVE), tmp_path / "mine.csv"
    stamps = open_sequence(path).stamps
    rows = [f"{stamp:.6f},{k},0,0,0,0,0.6,0.8\n" for k, stamp in enumerate(stamps)]
    for head in ("timestamp,x,y,z,qx,qy,qz,qw", "#timestamp [s],p_x,p_y,p_z,q_x,q_y,q_z,q_w"):
        table.write_text(f"{head}\n{''.join(rows)}")
        poses = open_sequence(path, table).poses
        np.testing.assert_allclose(poses[:, 0, 3], range(len(stamps)), atol=1e-6)
        np.testing.assert_allclose(poses[:, 1, 0], 0.96, atol=1e-6)


def test_matrices_are_of_the_camera_in_kitti_whatever_their_width(tmp_path: Path) -> None:
    path, T = kitti(tmp_path, DRIVE), np.tile(np.eye(4), (len(DRIVE.stamps), 1, 1))
    T[:, 2, 3] = range(len(T))  # ahead of a camera
    np.save(tmp_path / "rows.npy", T[:, :3])
    np.save(tmp_path / "whole.npy", T)
    np.savetxt(tmp_path / "sixteen.txt", T.reshape(-1, 16))
    first, *others = (
        open_sequence(path, tmp_path / name).poses
        for name in ("rows.npy", "whole.npy", "sixteen.txt")
    )
    assert np.abs(first[-1, :3, 3]).argmax() == 0  # ahead of a LiDAR
    for poses in others:
        np.testing.assert_allclose(poses, first, atol=1e-9)


@pytest.mark.parametrize("name", ["KITTI odometry", "KITTI raw", "NCLT"])
def test_what_lies_beside_a_link_is_found(name: str, tmp_path: Path) -> None:
    path = WRITERS[name][0](tmp_path, DRIVE)
    plain, disk = open_sequence(path), tmp_path / "disk"
    disk.mkdir()
    path.rename(disk / "elsewhere")
    path.symlink_to(disk / "elsewhere")
    linked = open_sequence(path)
    assert linked.format == plain.format
    np.testing.assert_array_equal(linked.poses, plain.poses)


def test_blank_lines_stand_for_scans_that_are_missing(tmp_path: Path) -> None:
    path = kitti_raw(tmp_path, DRIVE)
    whole = open_sequence(path)
    file = path / "velodyne_points" / "timestamps.txt"
    lines = file.read_text().rstrip("\n").split("\n")
    lines[1] = ""
    file.write_text("\n".join(lines))
    with pytest.raises(DatasetError, match="no time for scan 1"):
        open_sequence(path)
    sorted((path / "velodyne_points" / "data").iterdir())[1].unlink()
    left = open_sequence(path)
    assert left.stamps.tolist() == np.delete(whole.stamps, 1).tolist()


def test_sweeps_without_files_are_left_out(tmp_path: Path) -> None:
    path = nuscenes(tmp_path, DRIVE)
    whole = open_sequence(path)
    whole.source.paths[1].unlink()
    left = open_sequence(path)
    assert left.stamps.tolist() == np.delete(whole.stamps, 1).tolist()
    assert f"1 of {len(whole)} sweeps left out: no files" in left.notes
    assert all(len(left.scan(i)) for i in range(len(left)))
