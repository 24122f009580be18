"""Bytes that are cut off or wrong: one clear line, or the points that are whole; never more."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from samples.datasets import Drive, kitti

from segloc import geometry
from segloc.errors import DatasetError
from segloc.motion import interpolated
from segloc.tools.datasets import open_sequence
from segloc.tools.datasets.layout import parse_float4
from segloc.tools.datasets.loaders import boreas, helipr, nclt, robotcar
from segloc.tools.datasets.ros.pointcloud2 import scan_of_pointcloud2
from segloc.tools.datasets.tracks import clean_track, euler_poses, read_table, rising
from segloc.tools.io.kitti_bin import parse_nuscenes
from segloc.tools.io.scans import write_scan
from segloc.types import Float64, Scan

COUNT = 7
PARSERS: dict[str, tuple[Callable[[bytes], Scan], int]] = {
    "float4": (parse_float4, 16),
    "nuScenes": (parse_nuscenes, 20),
    "NCLT": (nclt.parse, 8),
    "Boreas": (boreas.parse, 24),
    "LMS": (partial(robotcar.parse, sensor="lms_front"), 24),
} | {
    name: (partial(helipr.parse, layout=layout), layout.itemsize)
    for name, layout in helipr.POINTS.items()
}


@pytest.mark.parametrize("name", PARSERS)
@given(data=st.data())
def test_binary_scans_of_any_bytes(name: str, data: st.DataObject) -> None:
    """Whole points or an error: never points made of two."""
    parse, size = PARSERS[name]
    content = data.draw(st.binary(max_size=COUNT * size + 3))
    if len(content) % size:
        with pytest.raises(DatasetError, match=f"{len(content)} bytes are no") as caught:
            parse(content)
        assert "\n" not in str(caught.value)
    else:
        scan = parse(content)
        assert len(scan) + scan.dropped <= len(content) // size
        assert np.isfinite(scan.points).all()


@dataclass
class PointField:
    name: str
    offset: int
    datatype: int
    count: int = 1


@dataclass
class Message:
    """A PointCloud2."""

    height: int
    width: int
    point_step: int
    row_step: int
    data: np.ndarray
    is_bigendian: bool = False
    fields: list[PointField] = field(
        default_factory=lambda: [PointField(n, 4 * k, 7) for k, n in enumerate("xyz")]
    )


@given(
    st.integers(0, 5),
    st.integers(0, 5),
    st.integers(0, 40),
    st.integers(0, 200),
    st.binary(max_size=400),
    st.booleans(),
    st.lists(
        st.builds(
            PointField,
            st.sampled_from(["x", "y", "z", "t", "time", "timestamp", "ring"]),
            st.integers(0, 60),
            st.integers(0, 10),
            st.integers(0, 3),
        ),
        max_size=8,
    ),
)
def test_point_clouds_of_any_layout(
    height: int,
    width: int,
    step: int,
    stride: int,
    data: bytes,
    big: bool,
    fields: list[PointField],
) -> None:
    """A layout that fits gives at most its declared number of points; any other, one line."""
    content = np.frombuffer(data, np.uint8) if data else np.empty(0, np.uint8)
    message = Message(height, width, step, stride, content, big, fields)
    try:
        scan = scan_of_pointcloud2(message)
    except DatasetError as error:
        assert "\n" not in str(error)
    else:
        assert len(scan) + scan.dropped <= height * width


def test_point_clouds_that_do_not_fit() -> None:
    data = np.zeros(4 * 16, np.uint8)
    with pytest.raises(DatasetError, match="1 x 5 points need 80 bytes, but there are 64"):
        scan_of_pointcloud2(Message(1, 5, 16, 80, data))
    with pytest.raises(DatasetError, match="no field 'z'; fields: x, y"):
        scan_of_pointcloud2(
            Message(1, 4, 16, 64, data, fields=Message(0, 0, 0, 0, data).fields[:2])
        )
    content = np.full((4, 4), np.nan, np.float32)
    fields = [PointField(name, 4 * k, 7) for k, name in enumerate([*"xyz", "time"])]
    message = Message(1, 4, 16, 64, content.view(np.uint8).ravel(), fields=fields)
    assert scan_of_pointcloud2(message).dropped == 4  # not a number, and so are their times
    with pytest.raises(DatasetError, match="field z lies outside the 8 bytes of a point"):
        scan_of_pointcloud2(Message(1, 4, 8, 32, data))


# --- poses ----------------------------------------------------------------------------------------


@given(
    st.lists(st.floats(0.01, 2.0), min_size=1, max_size=8),
    st.lists(st.floats(-1.0, 12.0), min_size=1, max_size=20),
    st.integers(0, 2**31),
)
def test_interpolation_stays_between_neighbours(
    steps: list[float], times: list[float], seed: int
) -> None:
    """Exact at stamps, on the straight line and the shortest turn between, nothing beyond."""
    stamps = np.concatenate([[0.0], np.cumsum(steps)])
    rng = np.random.default_rng(seed)
    xyz = rng.normal(size=(len(stamps), 3)) * 10
    poses = euler_poses(xyz, rng.uniform(-1, 1, (len(stamps), 3)))
    np.testing.assert_allclose(interpolated(stamps, poses, stamps), poses, atol=1e-9)
    gap = 1.0
    for time, pose in zip(times, interpolated(stamps, poses, times, gap), strict=True):
        after = int(np.searchsorted(stamps, time))
        outside = not stamps[0] <= time <= stamps[-1]
        if outside or (time not in stamps and stamps[after] - stamps[after - 1] > gap):
            assert np.isnan(pose).all()
            continue
        if time in stamps:
            continue
        share = (time - stamps[after - 1]) / (stamps[after] - stamps[after - 1])
        a, b = poses[after - 1], poses[after]
        np.testing.assert_allclose(
            pose[:3, 3], (1 - share) * a[:3, 3] + share * b[:3, 3], atol=1e-6
        )
        whole = geometry.rotation_angle(geometry.inverse(a) @ b)
        part = geometry.rotation_angle(geometry.inverse(a) @ pose)
        assert part == pytest.approx(share * whole, abs=1e-6)


@given(st.lists(st.integers(-5, 5).map(float), max_size=9))
def test_as_many_stamps_are_kept_as_can_rise(values: list[float]) -> None:
    kept = np.array(values)[rising(np.array(values))]
    assert (np.diff(kept) > 0).all()
    most = max(
        len(chosen)
        for length in range(len(values) + 1)
        for chosen in itertools.combinations(values, length)
        if all(a < b for a, b in itertools.pairwise(chosen))
    )
    assert len(kept) == most


def test_a_wrong_stamp_or_a_clock_set_back_does_not_cost_the_rest() -> None:
    ahead, back = np.arange(100.0), np.arange(100.0)
    ahead[3] += 86400.0
    back[5:] -= 3600.0
    assert np.flatnonzero(~rising(ahead)).tolist() == [3]
    assert np.flatnonzero(~rising(back)).tolist() == [0, 1, 2, 3, 4]


def test_tracks_leave_out_what_is_wrong_and_say_so() -> None:
    stamps = np.array([0.0, 1.0, 1.0, np.nan, 2.0, 3.0])
    poses = np.tile(np.eye(4), (6, 1, 1))
    poses[4, 0, 3] = np.inf
    track = clean_track("odometry", stamps, poses)
    assert track.keys.tolist() == [0.0, 1.0, 3.0]
    assert track.note == (
        "odometry: 3 of 6 poses dropped: not finite, no unit quaternion, or stamp not rising"
    )
    assert track.gaps.tolist() == [2.0]
    with pytest.raises(DatasetError, match="none of its 1 poses is usable"):
        clean_track("odometry", stamps[3:4], poses[3:4])


def test_tables_of_numbers(tmp_path: Path) -> None:
    file = tmp_path / "poses.csv"
    file.write_text("\ufefft, x ,y\n1,2,3\n\n4,5,6\n")
    rows = read_table(file, ("y", "t"), header=True)
    assert rows.tolist() == [[3, 1], [6, 4]]
    with pytest.raises(DatasetError, match=r"poses\.csv: no column 'z' in its first line"):
        read_table(file, ("z",), header=True)
    for text in ("", "t\n", "t\n1\n2,3\nx\n", "t\n1;2\n"):
        file.write_text(text)
        with pytest.raises(DatasetError, match=r"poses\.csv: ") as caught:
            read_table(file, ("t",), header=True)
        assert "\n" not in str(caught.value)


# --- whole recordings -----------------------------------------------------------------------------


def test_opening_reads_no_scan(tmp_path: Path) -> None:
    path = kitti(tmp_path, Drive.make())
    for file in (path / "velodyne").iterdir():
        file.write_bytes(b"x")
    sequence = open_sequence(path)
    assert len(sequence) == 5
    assert sequence.poses is not None
    with pytest.raises(DatasetError, match=r"000003\.bin: cut off: 1 bytes"):
        sequence.scan(3)
    (path / "velodyne" / "000003.bin").unlink()
    with pytest.raises(DatasetError, match=r"000003\.bin: no such file"):
        sequence.scan(3)


def test_folders_of_the_same_names_are_not_mistaken(tmp_path: Path) -> None:
    for name in ("Ouster", "velodyne_sync", "lms_front", "lidar"):
        folder = tmp_path / name
        folder.mkdir()
        write_scan(folder / "000100.bin", np.ones((5, 3)))
        sequence = open_sequence(folder)
        assert sequence.format == "folder of scans"
        assert sequence.indices.tolist() == [100]


def test_a_scan_that_is_missing_shifts_no_pose(tmp_path: Path) -> None:
    drive = Drive.make(6)
    path = kitti(tmp_path, drive)
    (path / "velodyne" / "000002.bin").unlink()
    sequence = open_sequence(path)
    assert sequence.indices.tolist() == [0, 1, 3, 4, 5]
    world: list[Float64] = []
    for i in range(5):
        scan = sequence.scan(i)
        world.append(geometry.transform(scan.T_odom_sensor, scan.points))
    np.testing.assert_allclose(world[2], world[0], atol=1e-4)


@pytest.mark.parametrize("stride", [0, 16, 48, 3 * 48])
def test_a_row_step_that_is_wrong_where_all_bytes_are_there(stride: int) -> None:
    """Drivers leave it out, or give that of a point or of the whole cloud."""
    points = np.arange(36, dtype="<f4").reshape(9, 4)
    message = Message(3, 3, 16, stride, points.view(np.uint8).reshape(-1))
    np.testing.assert_array_equal(scan_of_pointcloud2(message).points, points[:, :3])
