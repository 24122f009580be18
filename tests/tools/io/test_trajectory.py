"""Trajectories: what is written comes back, and faults are named by line."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from samples.io import pcd
from scipy.spatial.transform import Rotation

from segloc.errors import DatasetError, SeglocError
from segloc.tools.io import Trajectory, read_trajectory, write_kitti, write_tum

GOOD = "0 1 2 3 0 0 0 1\n"


def path_of(count: int, seed: int = 0) -> Trajectory:
    rng = np.random.default_rng(seed)
    poses = np.tile(np.eye(4), (count, 1, 1))
    if count:
        poses[:, :3, :3] = Rotation.random(count, rng).as_matrix()
    poses[:, :3, 3] = rng.normal(size=(count, 3)) * 500
    return Trajectory(np.cumsum(rng.uniform(0.01, 2, count)) + 1.6e9, poses)


@settings(max_examples=40, deadline=None)
@given(count=st.integers(0, 30), seed=st.integers(0, 99))
def test_both_files_come_back(
    count: int, seed: int, tmp_path_factory: pytest.TempPathFactory
) -> None:
    folder, trajectory = tmp_path_factory.mktemp("path"), path_of(count, seed)
    write_tum(folder / "a.tum", trajectory)
    again = read_trajectory(folder / "a.tum")
    np.testing.assert_allclose(again.stamps, trajectory.stamps, rtol=0, atol=1e-6)
    np.testing.assert_allclose(again.poses, trajectory.poses, rtol=0, atol=5e-9)
    if count:
        write_kitti(folder / "a.txt", trajectory)
        again = read_trajectory(folder / "a.txt")
        np.testing.assert_array_equal(again.stamps, np.arange(count))
        np.testing.assert_allclose(again.poses, trajectory.poses, rtol=0, atol=1e-9)
    assert not list(folder.glob(".*"))


def test_written_tum_is_plain_and_of_unit_quaternions(tmp_path: Path) -> None:
    write_tum(tmp_path / "a.tum", path_of(50))
    lines = (tmp_path / "a.tum").read_text().splitlines()
    assert lines[0].startswith("#")
    for line in lines[1:]:
        assert all(len(word.partition(".")[2]) == 9 for word in line.split())
        quaternion = np.array(line.split()[4:], dtype=float)
        assert abs(np.linalg.norm(quaternion) - 1) < 3e-9
        assert quaternion[3] >= 0
    with pytest.raises(SeglocError, match="no folder"):
        write_tum(tmp_path / "missing" / "a.tum", path_of(1))
    twice = Trajectory(np.array([1.0, 1.0 + 1e-12]), np.tile(np.eye(4), (2, 1, 1)))
    with pytest.raises(DatasetError, match="equal to 9 decimals"):
        write_tum(tmp_path / "a.tum", twice)
    assert (tmp_path / "a.tum").read_text().splitlines() == lines


def test_comments_blank_lines_and_loose_quaternions(tmp_path: Path) -> None:
    text = "\ufeff# a comment\r\n\r\n0 1 2 3 0 0 0.71 0.71  # here\r\n\t0.5 1 2 3 0 0 0 -1\r\n"
    (tmp_path / "a.tum").write_text(text, newline="")
    trajectory = read_trajectory(tmp_path / "a.tum")
    assert trajectory.stamps.tolist() == [0, 0.5]
    quarter = Rotation.from_euler("z", 90, degrees=True).as_matrix()
    np.testing.assert_allclose(trajectory.poses[0, :3, :3], quarter, atol=1e-12)
    (tmp_path / "b.tum").write_text("# nothing found\n")
    assert len(read_trajectory(tmp_path / "b.tum")) == 0


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ("", "empty file"),
        (" \n", "empty file"),
        ("1 2 3\n", r"line 1: 3 columns, not 8 \(TUM\) or 12 \(KITTI\)"),
        (GOOD + "1 1 2 3 0 0 0\n", "line 2: 7 columns, not 8"),
        (GOOD + "1 0 0 0 0 1 0 0 0 0 1 0\n", "line 2: 12 columns, not 8"),
        ("# c\n\n" + GOOD + "1 1 2 3 0 0 0 one\n", "line 4: could not convert"),
        (GOOD + "1 1 nan 3 0 0 0 1\n", "line 2: a value that is not finite"),
        (GOOD + "1 1 inf 3 0 0 0 1\n", "line 2: a value that is not finite"),
        (GOOD + "nan 1 2 3 0 0 0 1\n", "line 2: a stamp that is not finite"),
        (GOOD + "1 1 2 3 0 0 0 nan\n", "line 2: a quaternion of length nan"),
        (GOOD + "1 1 2 3 0 0 0 0\n", "line 2: a quaternion of length 0, not 1"),
        (GOOD + "1 1 2 3 1e200 0 0 1e200\n", "line 2: a quaternion of length inf"),
        (GOOD + "0 1 2 3 0 0 0 1\n", "line 2: stamps that do not rise"),
        (GOOD + "-1 1 2 3 0 0 0 1\n", "line 2: stamps that do not rise"),
        ("1 0 0 0 0 1 0 0 0 0 1 0\n2 0 0 0 0 1 0 0 0 0 1 0\n", "line 2: not a rigid"),
        ("1 0 0 0 0 1 0 0 0 0 -1 0\n", "line 1: not a rigid"),
        ("1 0 0 0 0 1 0 nan 0 0 1 0\n", "line 1: a value that is not finite"),
    ],
)
def test_faults_are_named_by_file_and_line(text: str, fault: str, tmp_path: Path) -> None:
    path = tmp_path / "path.tum"
    path.write_text(text)
    with pytest.raises(DatasetError, match=fault) as caught:
        read_trajectory(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert "\n" not in str(caught.value)


@settings(max_examples=100, deadline=None)
@given(noise=st.binary(max_size=200), cut=st.integers(0, 200))
def test_damaged_files_never_crash(
    noise: bytes, cut: int, tmp_path_factory: pytest.TempPathFactory
) -> None:
    folder = tmp_path_factory.mktemp("path")
    write_tum(folder / "a", path_of(4))
    data = (folder / "a").read_bytes()
    (folder / "a").write_bytes(data[:cut] + noise + data[cut + len(noise) // 2 :])
    try:
        assert len(read_trajectory(folder / "a")) <= 5
    except DatasetError as error:
        assert "\n" not in str(error)


def test_lookup() -> None:
    trajectory = path_of(5)
    for i, stamp in enumerate(trajectory.stamps):
        found = trajectory.at(float(stamp))
        np.testing.assert_array_equal(found, trajectory.poses[i])
        found[:] = 0  # a copy
    first, last = float(trajectory.stamps[0]), float(trajectory.stamps[-1])
    assert trajectory.at(first + 1e-6) is None
    for stamp in (first - 1, last + 1, float("nan"), float("inf")):
        assert trajectory.at(stamp) is None
    assert path_of(0).at(0.0) is None


def test_a_trajectory_is_checked_and_keeps_its_own_data() -> None:
    stamps, poses = np.arange(3.0), np.tile(np.eye(4), (3, 1, 1))
    trajectory = Trajectory(stamps, poses)
    poses[:] = 0
    assert trajectory.poses[2, 2, 2] == 1
    with pytest.raises(ValueError, match="read-only"):
        trajectory.poses[0] = 0
    with pytest.raises(DatasetError, match="do not match"):
        Trajectory(stamps, trajectory.poses[:2])
    with pytest.raises(DatasetError, match="pose 1: stamps that do not rise"):
        Trajectory(np.zeros(3), trajectory.poses)
    with pytest.raises(DatasetError, match="pose 0: not a rigid transform"):
        Trajectory(stamps, poses)


ROW = (1.5, 10.0, 20.0, 30.0, 0.1, 0.2, 0.3, 0.927361849549570)  # stamp, position, qx qy qz qw
TABLES = {
    "commas": ("", "{0},{1},{2},{3},{4},{5},{6},{7}", 1.0),
    "semicolons": ("", "{0}; {1}; {2}; {3}; {4}; {5}; {6}; {7};", 1.0),
    "tabs": ("", "{0}\t{1}\t{2}\t{3}\t{4}\t{5}\t{6}\t{7}", 1.0),
    "EuRoC": (
        "#timestamp [ns],p_RS_R_x [m],p_RS_R_y [m],p_RS_R_z [m],q_RS_w [],q_RS_x [],q_RS_y [],"
        "q_RS_z [],v_RS_R_x [m s^-1],b_w_RS_S_x [rad s^-1]",
        "{0},{1},{2},{3},{7},{4},{5},{6},9,9",
        1e9,
    ),
    "EuRoC, by name": (
        "#timestamp,p_x,p_y,p_z,q_w,q_x,q_y,q_z",
        "{0},{1},{2},{3},{7},{4},{5},{6}",
        1.0,
    ),
    "header": ("timestamp tx ty tz qx qy qz qw", "{0} {1} {2} {3} {4} {5} {6} {7}", 1.0),
    "more columns": ("num,t,x,y,z,qx,qy,qz,qw", "7,{0},{1},{2},{3},{4},{5},{6},{7}", 1.0),
    "rostopic": (
        "%time,field.header.seq,field.header.stamp,field.child_frame_id,"
        "field.pose.pose.position.x,field.pose.pose.position.y,field.pose.pose.position.z,"
        "field.pose.pose.orientation.x,field.pose.pose.orientation.y,"
        "field.pose.pose.orientation.z,field.pose.pose.orientation.w,field.twist.twist.linear.x",
        "9,1,{0},base,{1},{2},{3},{4},{5},{6},{7},3",
        1.0,
    ),
    "two times": ("sec,nsec,x,y,z,qx,qy,qz,qw", "1,500000000,{1},{2},{3},{4},{5},{6},{7}", 1.0),
    "capitals": ('"Time","X","Y","Z","QX","QY","QZ","QW"', "{0},{1},{2},{3},{4},{5},{6},{7}", 1.0),
    "a remark": ("# x y z of the robot", "{0} {1} {2} {3} {4} {5} {6} {7}", 1.0),
}


@pytest.mark.parametrize("name", TABLES)
def test_tables_of_poses_are_read_by_their_names(name: str, tmp_path: Path) -> None:
    header, row, scale = TABLES[name]
    lines = [header] * bool(header)
    for shift in (0.0, 1.0) if name != "two times" else (0.0,):
        stamp = scale * (ROW[0] + shift)
        lines.append(row.format(int(stamp) if scale > 1 else stamp, *ROW[1:]))
    (tmp_path / "poses.csv").write_text("\r\n".join(lines) + "\r\n")
    found = read_trajectory(tmp_path / "poses.csv")
    assert found.stamps[0] == pytest.approx(ROW[0], abs=1e-9)
    assert found.poses[0, :3, 3].tolist() == list(ROW[1:4])
    quaternion = Rotation.from_matrix(found.poses[0, :3, :3].copy()).as_quat()
    np.testing.assert_allclose(quaternion * np.sign(quaternion[3]), ROW[4:], atol=1e-9)


FORMS = (
    "12", "13", "16", "16 by column", "17", "7", "radians", "degrees", "degrees by value",
    "no time", "decimal commas", "g2o", "g2o numbers", "pcd", "npy", "npy 3x4",
)  # fmt: skip


def written(form: str, trajectory: Trajectory) -> bytes:
    """A file of poses as trackers, loggers and SLAM write it."""
    stamps, T = trajectory.stamps, trajectory.poses
    turns = Rotation.from_matrix(T[:, :3, :3].copy())
    xyz, q, rpy = T[:, :3, 3], turns.as_quat(), turns.as_euler("xyz")
    if form.startswith("npy"):
        buffer = io.BytesIO()
        np.save(buffer, T[:, :3] if "3x4" in form else T)
        return buffer.getvalue()
    if form == "pcd":  # LIO-SAM's transformations.pcd
        rows = np.rec.fromarrays(
            [*np.float32(np.vstack([xyz.T, 0 * stamps, rpy.T])), stamps],
            names="x,y,z,intensity,roll,pitch,yaw,time",
        )
        return pcd(rows, "binary")
    if form.startswith("g2o"):
        first, step = (7, 3) if "numbers" in form else (0, 1)
        lines = [
            f"VERTEX_SE3:QUAT {first + step * k} " + " ".join(map(repr, [*map(float, row)]))
            for k, row in enumerate(np.hstack([xyz, q]))
        ]
        return "\n".join(["FIX 0", *reversed(lines), "EDGE_SE3:QUAT 0 1 0 0 0"]).encode()
    header, columns = {
        "12": ("", [T[:, :3].reshape(-1, 12)]),
        "13": ("", [stamps, T[:, :3].reshape(-1, 12)]),
        "16": ("", [T.reshape(-1, 16)]),
        "16 by column": ("", [T.transpose(0, 2, 1).reshape(-1, 16)]),
        "17": ("", [stamps, T.reshape(-1, 16)]),
        "7": ("", [xyz, q]),
        "radians": ("time,x,y,z,roll [rad],pitch,yaw", [stamps, xyz, rpy]),
        "degrees": ("time,x,y,z,roll_deg,pitch_deg,yaw_deg", [stamps, xyz, np.degrees(rpy)]),
        "degrees by value": ("time,x,y,z,roll,pitch,yaw", [stamps, xyz, np.degrees(rpy)]),
        "no time": ("x,y,z,qx,qy,qz,qw", [xyz, q]),
        "decimal commas": ("", [stamps, xyz, q]),
    }[form]
    rows = ["".join([header, "\n"] if header else [])]
    for row in np.column_stack(columns):
        words = [f"{value:.12f}" for value in row]
        if form == "decimal commas":
            words = [word.replace(".", ",") for word in words]
        rows.append(("," if header else " ").join(words) + "\n")
    return "".join(rows).encode()


@pytest.mark.parametrize("form", FORMS)
def test_poses_in_the_forms_that_programs_write(form: str, tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    poses = np.tile(np.eye(4), (6, 1, 1))
    poses[:, :3, :3] = Rotation.random(6, rng).as_matrix()
    poses[:, :3, 3] = rng.uniform(-90, 90, (6, 3))
    trajectory = Trajectory(1.6e9 + 0.1 * np.arange(6), poses)
    (tmp_path / "poses").write_bytes(written(form, trajectory))
    found = read_trajectory(tmp_path / "poses")
    timed = form in ("13", "17", "radians", "pcd", "decimal commas") or "degrees" in form
    expected = trajectory.stamps if timed else 7 + 3 * np.arange(6)
    expected = expected if timed or "numbers" in form else np.arange(6)
    np.testing.assert_allclose(found.stamps, expected, rtol=0, atol=1e-5)
    np.testing.assert_allclose(found.poses, poses, rtol=0, atol=1e-5)


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ("time,x,y,yaw\n0,1,2,3\n", "line 1: header without columns for time, x"),
        ("time,lat,lon,alt\n0,48,8,3\n", "it names time, lat, lon, alt"),
        ("\tTX\tTY\tTZ\tRX\tRY\tRZ\n0\t1\t2\t3\t0\t0\t0\n", "name Euler angles roll, pitch, yaw"),
        ("0 1 2 3 0 0 0.1\n", "Euler angles need a first line: time x y z roll pitch yaw"),
        ("1 2 3 0 0 0.1\n", "line 1: 6 columns, .* first line: x y z roll pitch yaw"),
        ("0 1 2 3\n", "positions without rotations"),
        ('{"frames": []}', "JSON, not a table of poses"),
        ("VERTEX_XY 0 1 2\n", "a g2o file without VERTEX_SE3"),
        ("VERTEX_SE3:QUAT 0 1 2\n", "line 1: not a vertex"),
        ("1 0 0 5 0 1 0 6 0 0 1 7 0 0 0 2\n", "line 1: not a rigid transform"),
        (pcd(np.zeros(2, [(a, "<f4") for a in "xyz"]), "ascii").decode(), "transformations.pcd"),
    ],
)
def test_poses_that_columns_do_not_tell_are_refused(text: str, fault: str, tmp_path: Path) -> None:
    (tmp_path / "poses").write_text(text)
    with pytest.raises(DatasetError, match=fault) as caught:
        read_trajectory(tmp_path / "poses")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("names", "second"),
    [
        ("stamp.sec,stamp.nanosec", "7,500000000"),
        ("time_sec,time_nsec", "7,500000000"),
        ("header.stamp.sec,header.stamp.nanosec", "7,500000000"),
        ("seconds", "7.5"),
        ("epoch", "7.5"),
        ("time_ns", "7500000000"),
    ],
)
def test_times_by_their_names(tmp_path: Path, names: str, second: str) -> None:
    first = ",".join("0" for _ in names.split(","))
    rows = "".join(f"{t},1,2,3,0,0,0,1\n" for t in (first, second))
    (tmp_path / "a.csv").write_text(f"{names},x,y,z,qx,qy,qz,qw\n{rows}")
    assert read_trajectory(tmp_path / "a.csv").stamps.tolist() == pytest.approx([0.0, 7.5])
