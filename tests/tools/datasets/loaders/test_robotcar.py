"""Oxford RobotCar: sweeps, extrinsics, INS, RTK and visual odometry, our own interpolation."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from samples.datasets import FLIP, START, angles, made, matrix, us
from samples.robotcar import FRONT, write_ins, write_sweep

from segloc import geometry
from segloc.errors import DatasetError
from segloc.tools.datasets import open_sequence
from segloc.types import Float64


def car(time: float) -> Float64:
    """T_world_car in north, east, down: 10 m/s, turning right, a little nose up."""
    t = time - START
    T = matrix((5_735_000.0 + 10 * t, 620_000.0 + 2 * t, -110.0), (0, 0, 0.4 + 0.1 * t))
    return T @ matrix((0, 0, 0), (0.01, 0.02, 0.0))


def traversal(root: Path, *, seconds: float = 1.0, kind: str = "ins") -> tuple[Path, list[Float64]]:
    """A traversal with sweeps at 50 Hz, and the points of each in the world (z up)."""
    folder = made(root / "2014-11-21-16-07-03")
    stamps = START + 0.013 + 0.02 * np.arange(round(seconds / 0.02))
    rng, world = np.random.default_rng(1), []
    listed = []
    for stamp in stamps:
        angle, reach = rng.uniform(-2.3, 2.3, 40), rng.uniform(1, 20, 40)
        flat = np.column_stack([reach * np.cos(angle), reach * np.sin(angle), 0 * angle])
        write_sweep(folder / "lms_front", stamp, flat[:, :2])
        world.append(geometry.transform(FLIP @ car(stamp) @ FRONT, flat))
        listed.append(f"{us(stamp)} 1")
    (folder / "lms_front.timestamps").write_text("\n".join([*listed, f"{us(START + 99)} 1"]))
    times = START + np.arange(0.0, seconds + 0.05, 0.02)
    if kind == "vo":
        write_vo(made(folder / "vo") / "vo.csv", times)
    else:
        poses = np.array([car(time) for time in times])
        write_ins(folder / "gps" / f"{kind}.csv", times, poses, status=kind == "ins")
    return folder, world


def write_vo(path: Path, times: Float64) -> None:
    text = "source_timestamp,destination_timestamp,x,y,z,roll,pitch,yaw\n"
    for before, time in pairwise(times):
        step = geometry.inverse(car(before)) @ car(time)
        values = ",".join(f"{v:.15g}" for v in [*step[:3, 3], *angles(step)])
        text += f"{us(time)},{us(before)},{values}\n"
    path.write_text(text)


@pytest.mark.parametrize("kind", ["ins", "rtk"])
def test_sweeps_lie_where_they_were_taken(kind: str, tmp_path: Path) -> None:
    """Stamps lie between those of the poses: taking the earlier one would be 0.1 m off."""
    path, world = traversal(tmp_path, kind=kind)
    sequence = open_sequence(path)
    assert sequence.format == "Oxford RobotCar"
    assert sequence.track.source == f"gps/{kind}.csv"
    assert len(sequence) == 50
    assert sequence.notes == ("1 of the 51 scans in lms_front.timestamps are missing",)
    for i in (0, 7, 49):
        scan = sequence.scan(i)
        assert len(scan) == 40  # zeros are no returns
        np.testing.assert_allclose(
            geometry.transform(scan.T_odom_sensor, scan.points), world[i], atol=1e-4
        )
    assert scan.T_odom_sensor[2, 2] > 0.99  # z up
    inner = open_sequence(path / "lms_front")
    np.testing.assert_array_equal(inner.poses, sequence.poses)


def test_visual_odometry_chains_relative_poses(tmp_path: Path) -> None:
    path, world = traversal(tmp_path, kind="vo")
    sequence = open_sequence(path)
    clouds = []
    for i in (3, 40):
        scan = sequence.scan(i)
        clouds.append(geometry.transform(scan.T_odom_sensor, scan.points))
    T = FLIP @ car(START) @ FLIP  # the odometry starts here
    for cloud, i in zip(clouds, (3, 40), strict=True):
        np.testing.assert_allclose(geometry.transform(T, cloud), world[i], atol=1e-4)
    file = path / "vo" / "vo.csv"
    lines = file.read_text().splitlines()
    file.write_text("\n".join([*lines[:10], *lines[12:]]))
    unposed = open_sequence(path)
    assert unposed.poses is None
    assert any("vo.csv: row 10 does not start where the last" in note for note in unposed.notes)


def test_poses_before_the_ins_is_aligned_are_not_used(tmp_path: Path) -> None:
    path, _ = traversal(tmp_path)
    file = path / "gps" / "ins.csv"
    lines = file.read_text().splitlines()
    head = [line.replace("INS_SOLUTION_GOOD", "INS_ALIGNING") for line in lines[1:11]]
    file.write_text("\n".join([lines[0], *head, *lines[11:]]) + "\n")
    sequence = open_sequence(path)
    assert sequence.indices[0] == 10
    assert "gps/ins.csv: 10 poses left out: INS not aligned" in sequence.notes
    file.write_text("\n".join([lines[0], *head]) + "\n")
    unposed = open_sequence(path)
    assert unposed.poses is None
    assert any("ins.csv: the INS was never aligned" in note for note in unposed.notes)


def test_the_radar_sets_velodyne(tmp_path: Path) -> None:
    path, _ = traversal(tmp_path)
    stamp = us(START + 0.513)
    points = np.random.default_rng(2).uniform(-20, 20, (50, 3))
    data = np.vstack([points.T, np.ones(50)]).astype("<f4").tobytes()
    (made(path / "velodyne_left") / f"{stamp}.bin").write_bytes(data)
    with pytest.raises(DatasetError, match=r"--topic lms_front\|velodyne_left"):
        open_sequence(path)
    scan = open_sequence(path, topic="velodyne_left").scan(0)
    mounted = matrix((-0.60072, -0.34077, -0.26837), (-0.0053948, -0.041998, -3.1337))
    np.testing.assert_allclose(scan.points, geometry.transform(FLIP @ mounted, points), atol=1e-4)
