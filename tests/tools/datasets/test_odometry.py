"""A simulated drive as a folder and as bags, its odometry, and the output of `segloc info`."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("embreex", reason="the simulator needs segloc-lab")
pytest.importorskip("rosbags")
pytest.importorskip("kiss_icp")

from samples.bags import BagWriter
from samples.datasets import START, Drive, kitti, numbered
from samples.real import real
from samples.walk import run
from segloc_lab.simulation import (
    Route,
    SimulatedSequence,
    car,
    hdl32e,
    record,
    simulate_session,
    town,
)
from segloc_lab.simulation.drives import mapped_way

from segloc import geometry, scan_odometry
from segloc.errors import DatasetError, InvalidScan
from segloc.frontend import LocalCloudConfig
from segloc.tools.datasets import NO_POSES, open_sequence
from segloc.tools.datasets.inspection import inspect
from segloc.tools.datasets.odometry import kept_odometry, lidar_odometry, odometry_path
from segloc.tools.io import Trajectory, read_trajectory, write_tum
from segloc.types import Float64, Int64, Scan


@dataclass
class Simulated:
    """A drive that moves while it scans."""

    folder: Path
    drive: SimulatedSequence

    def bag(self, kind: str, root: Path) -> Path:
        """Its scans in a bag, at the same times since START."""
        bag = BagWriter(kind)
        recording = open_sequence(self.folder, self.folder / "poses.tum", deskew=False)
        for i, stamp in enumerate(START + self.drive.stamps):
            scan = recording.scan(i)
            bag.cloud("/points", stamp, scan.points, times=("time", "f8", scan.times))
        return bag.write(root / kind)


@pytest.fixture(scope="module")
def simulated(tmp_path_factory: pytest.TempPathFactory) -> Simulated:
    world = town(3, size_m=150)
    way = mapped_way(world, np.random.default_rng(0), 60.0)
    route = Route(tuple(way), 1.1, length_m=32.0)
    sensor = hdl32e().thinned(4)
    drive = simulate_session(world, 0, route, sensor, 7, platform=car(), by_rate=True, skew=True)
    folder = record(drive, tmp_path_factory.mktemp("run") / "drive", workers=1)
    return Simulated(folder, drive)


@pytest.mark.slow
def test_odometry_follows_the_truth(simulated: Simulated, tmp_path: Path) -> None:
    """Times of points are used; stamps of poses are where they hold, the scans' ends."""
    bag_path = simulated.bag("sqlite3", tmp_path)
    bag = open_sequence(bag_path)
    assert bag.poses is None
    calls: list[tuple[int, int]] = []
    trajectory = lidar_odometry(bag, progress=lambda done, total: calls.append((done, total)))
    assert calls[-1] == (len(bag), len(bag))
    assert bag.stamps is not None
    late = trajectory.stamps - bag.stamps
    assert 0.08 < late.min() <= late.max() <= 0.1
    file = odometry_path(tmp_path / "sqlite3")
    assert file == (tmp_path / "sqlite3.odometry.tum").resolve()
    assert not kept_odometry(file, bag, bag_path)
    write_tum(file, trajectory)
    assert kept_odometry(file, bag, bag_path)
    os.utime(file, (0, 0))  # the scans are newer
    assert not kept_odometry(file, bag, bag_path)
    posed = open_sequence(tmp_path / "sqlite3", file)
    assert posed.indices[0] == 1  # the first scan began before the first pose
    settled = 8  # scans until it knows the speed
    truth = simulated.drive.truth[settled:]
    ours = geometry.inverse(posed.poses[settled - 1]) @ posed.poses[settled - 1 :]
    error = np.linalg.norm((ours - geometry.inverse(truth[0]) @ truth)[:, :3, 3], axis=1)
    assert geometry.distance_travelled(truth)[-1] > 20
    assert error.max() < 0.5


@pytest.mark.slow
def test_verbs_take_a_bag_without_poses(
    simulated: Simulated, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = simulated.bag("ros1", tmp_path)
    prior_map = tmp_path / "site.segmap"
    assert run("map", "build", path, "--out", prior_map) == 1
    output = capsys.readouterr().err
    assert "a map needs a pose for every scan: pass --poses FILE, or use --odom" in output
    options = ["--method", "geo", "--every", "10", "--threads", "1"]
    assert run("map", "build", path, "--odometry", "--out", prior_map, *options) == 0
    kept = tmp_path / "ros1.bag.odometry.tum"
    assert f"odometry written to {kept}" in capsys.readouterr().err.replace("\n", "")
    before = kept.read_bytes()
    out = tmp_path / "results"
    verb = ["localize", path, "--map", prior_map, "--out", out, "--odometry", "--every", "15"]
    assert run(*verb) == 0
    assert "odometry from" in capsys.readouterr().err
    assert kept.read_bytes() == before
    assert len(read_trajectory(out / "poses.tum")) >= 1
    assert run("odometry", path, "--out", tmp_path / "other.tum") == 0
    assert (tmp_path / "other.tum").read_bytes() == before
    assert run("info", path, "--poses", kept) == 0
    shown = capsys.readouterr().out
    for fact in ("ROS 1 bag", "3D, 32 beams", "10.0 Hz", "x y z intensity time", "lidar"):
        assert fact in shown


def test_points_on_the_robot_are_not_used(simulated: Simulated, tmp_path: Path) -> None:
    few = open_sequence(simulated.folder, NO_POSES, "0:5", deskew=False)
    clean, loaded, rng = tmp_path / "clean", tmp_path / "loaded", np.random.default_rng(0)
    for folder in (clean, loaded):
        folder.mkdir()
    for i in range(len(few)):
        points = few.raw(i).points
        mast = rng.uniform((-0.6, -0.4, -0.3), (-0.2, 0.4, 0.3), (400, 3)).astype(np.float32)
        np.save(clean / f"{i}.npy", points)
        np.save(loaded / f"{i}.npy", np.concatenate([mast, points]))
    config = LocalCloudConfig(body=((-0.7, -0.5, -0.4), (-0.1, 0.5, 0.4)))
    alone, without = (open_sequence(folder, NO_POSES) for folder in (clean, loaded))
    expected = lidar_odometry(alone).poses
    assert geometry.distance_travelled(expected)[-1] > 1.0
    assert (lidar_odometry(without, config.without_body).poses == expected).all()
    assert not np.allclose(lidar_odometry(without).poses, expected, atol=1e-3)


def test_odometry_is_kept_by_times_that_are_whole_seconds(tmp_path: Path) -> None:
    times = 1_600_000_000.0 + np.arange(3)
    path = numbered(tmp_path / "drive", [f"{t:.6f}.npy" for t in times])
    recording, poses = open_sequence(path), np.tile(np.eye(4), (3, 1, 1))
    for keys, kept in ((times, True), (np.arange(3.0), False)):
        write_tum(odometry_path(path), Trajectory(keys, poses))
        assert kept_odometry(odometry_path(path), recording, path) is kept


class Fake:
    """Stands in for kiss-icp: gives these poses."""

    last_delta = np.eye(4)

    def __init__(self, poses: list[Float64]) -> None:
        self._poses = iter(poses)

    def register_frame(self, points: Float64, times: Float64) -> None:
        self.last_pose = next(self._poses)


@dataclass
class Run:
    """A recording of as many scans, all alike."""

    count: int
    name = "run"
    stamps = None

    @property
    def indices(self) -> Int64:
        return np.arange(self.count)

    def __len__(self) -> int:
        return self.count

    def raw(self, i: int) -> Scan:
        return Scan(np.random.default_rng(0).normal(size=(100, 3)))

    def where(self, i: int) -> str:
        return f"scan {i}"


def moved(*ways: float) -> list[Float64]:
    return [geometry.yaw_transform(0.0, (way, 0.0, 0.0)) for way in ways]


@pytest.mark.parametrize(
    ("poses", "fault"),
    [
        (moved(0, 0.5, float("nan")), "not finite"),
        (moved(0, 0.5, 40), r"a step of 39\.5 m"),
        ([*moved(0, 0.7), np.eye(4)], "returned to the origin"),
        (moved(*np.arange(10) * 0.5), "scans do not match"),
    ],
)
def test_odometry_that_was_lost_is_an_error(
    poses: list[Float64], fault: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(scan_odometry, "_kiss_icp", lambda *_: Fake(poses))
    recording = Run(len(poses))
    with pytest.raises(DatasetError, match=rf"scan \d: odometry is lost: .*{fault}"):
        lidar_odometry(recording)


def test_voxels_follow_a_robot_out_of_a_room(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("kiss_icp")
    voxels, make = list[float](), scan_odometry._kiss_icp

    def counted(max_range_m: float, voxel_m: float) -> Any:
        voxels.append(voxel_m)
        return make(max_range_m, voxel_m)

    monkeypatch.setattr(scan_odometry, "_kiss_icp", counted)
    odometry, rng = scan_odometry.ScanOdometry(), np.random.default_rng(0)
    sides = np.repeat([[5.0, 4.0, 2.5], [60.0, 50.0, 12.0]], 3000, axis=0)
    for k in range(50):
        points = rng.uniform(-0.5, 0.5, (6000, 3))
        axis = rng.integers(0, 3, 6000)
        points[np.arange(6000), axis] = rng.choice([-0.5, 0.5], 6000)
        outside = min(max((k - 10) / 20, 0.0), 1.0)
        seen = rng.uniform(size=6000) < np.where(np.arange(6000) < 3000, 1 - outside, outside)
        T = geometry.yaw_transform(0.01 * k, (0.05 * k, 0.0, 0.0))
        pose, _ = odometry.add(Scan(geometry.transform(np.linalg.inv(T), (points * sides)[seen])))
        assert np.linalg.norm(pose[:3, 3] - T[:3, 3]) < 0.1
        assert geometry.rotation_angle(np.linalg.inv(pose) @ T) < np.radians(1.5)
    indoors, outdoors = voxels[1], voxels[-1]
    assert indoors < 0.4 and outdoors == 1.0


def test_odometry_is_lost_where_its_later_map_was_begun(monkeypatch: pytest.MonkeyPatch) -> None:
    ways = np.cumsum(np.random.default_rng(1).uniform(0.2, 0.6, 20)).tolist()
    given = iter([[], moved(*ways), moved(0.0, 0.5, 0.0)])
    monkeypatch.setattr(scan_odometry, "_kiss_icp", lambda *_: Fake(next(given)))
    odometry, points = scan_odometry.ScanOdometry(), np.random.default_rng(0).normal(size=(100, 3))
    for k in range(13):  # the tenth large scan begins another map
        pose, _ = odometry.add(Scan(points * (1.0 if k < 3 else 10.0)))
    assert pose[0, 3] == pytest.approx(ways[11] + 0.5)
    with pytest.raises(InvalidScan, match="returned to the origin"):
        odometry.add(Scan(points * 10.0))


def test_info_finds_what_is_wrong(tmp_path: Path) -> None:
    drive = Drive.make(60)
    path = kitti(tmp_path, drive)
    files = sorted((path / "velodyne").iterdir())
    files[0].write_bytes(files[0].read_bytes()[:-5])
    scattered = drive.seen(7)
    scattered[:100] = np.inf
    rows = np.column_stack([scattered, np.ones(len(scattered))]).astype("<f4")
    files[7].write_bytes(rows.tobytes())
    files[9].write_bytes(rows[200:230].tobytes())
    times = np.loadtxt(path / "times.txt")
    times[20:] += 3.0
    times[41] = times[40]
    np.savetxt(path / "times.txt", times)
    truth = tmp_path / "poses" / "00.txt"
    poses = np.loadtxt(truth)
    poses[30:, 3] += 50.0
    np.savetxt(truth, poses)
    sequence = open_sequence(path)
    found = inspect(sequence, sample=60)
    assert found.sampled == 59
    assert found.rate_hz == pytest.approx(10.0)
    text = "\n".join(found.problems)
    for problem in (
        "000000.bin: cut off: 4795 bytes",
        "000007.bin: 100 of 300 points are infinite",
        "000009.bin: 30 points, the median is 300",
        "stamps do not rise after scan 40",
        "1 gaps in time, the longest 3.10 s after scan 19",
        "poses jump 1 times, by 50",
    ):
        assert problem in text
    assert len(found.problems) == 6


@pytest.mark.slow
def test_odometry_of_a_real_car(tmp_path: Path) -> None:
    """It moves on, never backwards, and neither speed nor heading jump."""
    pytest.importorskip("laspy")
    drive, file = real("hdl64_drive"), tmp_path / "poses.tum"
    assert run("odometry", drive, "--out", file) == 0
    trajectory = read_trajectory(file)
    assert len(trajectory) == len(list(drive.glob("*.laz")))
    steps = np.linalg.inv(trajectory.poses[:-1]) @ trajectory.poses[1:]
    ahead, turns = steps[:, 0, 3], np.arctan2(steps[:, 1, 0], steps[:, 0, 0])
    assert 0.25 < ahead.min() <= ahead.max() < 0.45  # 10 km/h at 10 Hz
    assert np.abs(np.diff(ahead[1:])).max() < 0.06  # the first step is a guess
    assert np.abs(steps[:, 1:3, 3]).max() < 0.06
    assert 0 < turns.min() <= turns.max() < np.radians(1.0)
