"""Bags whose sensor has no poses: how it is mounted, and which way is down."""

from __future__ import annotations

import pickle
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rosbags")

from samples.bags import KINDS, BagWriter
from samples.datasets import START, Drive, matrix

from segloc.frontend.gravity import angle_deg
from segloc.tools.datasets import RecordedSequence, open_sequence
from segloc.types import Float64

DRIVE = Drive.make(6)
LIDAR = matrix((0.3, 0.0, 1.2), (0.1, 0.4, -0.5))  # T_base_lidar
IMU = matrix((0.1, 0.0, 0.5), (np.pi, 0.0, 0.3))  # T_base_imu: upside down
Z = np.array([0.0, 0.0, 1.0])
TIMES = np.arange(START - 0.6, DRIVE.stamps[-1] + 0.6, 0.01)


def leaning(time: float) -> Float64:
    """R_world_base: slowly rolling."""
    return matrix((0, 0, 0), (0.1 + 0.1 * (time - START), -0.05, 0.7))[:3, :3]


def felt(time: float, length: float = 9.81) -> Float64:
    """At rest an accelerometer measures upwards."""
    up: Float64 = IMU[:3, :3].T @ leaning(time).T @ (length * Z)
    return up


def down(time: float) -> Float64:
    """In the LiDAR's frame."""
    direction: Float64 = -(LIDAR[:3, :3].T @ leaning(time).T @ Z)
    return direction


def bag_of(
    kind: str,
    acceleration: Callable[[float], Float64] | None = None,
    *,
    times: Float64 = TIMES,
    placed: bool = True,
) -> BagWriter:
    """The drive's clouds, an IMU that measures this, and both in tf unless not placed."""
    bag = BagWriter(kind)
    for time in times if acceleration else ():
        bag.imu("/imu", time, acceleration(time))
    for i, stamp in enumerate(DRIVE.stamps):
        bag.cloud("/points", stamp, DRIVE.seen(i), "lidar")
    if placed:
        bag.tf("/tf_static", START - 1, LIDAR, "base_link", "lidar")
        bag.tf("/tf_static", START - 1, IMU, "base_link", "imu")
    return bag


def opened(bag: BagWriter, path: Path, **options: object) -> RecordedSequence:
    return open_sequence(bag.write(path), **options)


def errors(sequence: RecordedSequence) -> list[float]:
    """Degrees between each scan's gravity and the true one."""
    found = []
    for i, stamp in enumerate(DRIVE.stamps):
        gravity = sequence.scan(i).gravity
        found.append(angle_deg(gravity, down(stamp)))
    return found


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("length", [9.81, 1.0])
def test_gravity_of_accelerometers(kind: str, length: float, tmp_path: Path) -> None:
    """In m/s2, or in g as Livox' drivers have it; an average over shaking."""
    rng = np.random.default_rng(0)
    bag = bag_of(kind, lambda time: felt(time, length) + 0.1 * length * rng.normal(size=3))
    sequence = opened(bag, tmp_path / "drive")
    assert sequence.poses is None and sequence.notes == ()
    assert sequence.gravity is not None and sequence.gravity.name == "/imu"
    assert max(errors(sequence)) < 2.0
    np.testing.assert_allclose(sequence.scan(0).T_base_sensor, LIDAR, atol=1e-6)
    again = pickle.loads(pickle.dumps(sequence))
    np.testing.assert_array_equal(again.scan(3).gravity, sequence.scan(3).gravity)


def test_known_orientations_are_preferred(tmp_path: Path) -> None:
    """While it brakes: the accelerations alone are 9 degrees off."""
    rough, known = bag_of("mcap"), bag_of("mcap")
    for time in TIMES:
        acceleration = felt(time) + IMU[:3, :3].T @ leaning(time).T @ np.array([1.6, 0, 0])
        rough.imu("/imu", time, acceleration)
        known.imu("/imu", time, acceleration, orientation=leaning(time) @ IMU[:3, :3])
    assert 8.0 < max(errors(opened(rough, tmp_path / "rough"))) < 11.0
    sequence = opened(known, tmp_path / "known")
    assert max(errors(sequence)) < 0.1
    assert (
        sequence.scan(0).gravity_error_deg < opened(rough, tmp_path / "2").scan(0).gravity_error_deg
    )
    belied = bag_of("mcap")  # another convention: north, east, down
    for time in TIMES:
        flipped = np.diag([1.0, -1, -1]) @ leaning(time) @ IMU[:3, :3]
        belied.imu("/imu", time, felt(time), orientation=flipped)
    assert max(errors(opened(belied, tmp_path / "belied"))) < 0.5


def test_what_is_no_gravity_is_not_taken(tmp_path: Path) -> None:
    """Free fall, braking, too few values, values on another clock, NaN: none, and no error."""
    rng = np.random.default_rng(1)
    cases = {
        "fall": lambda t: np.zeros(3),
        "braking": lambda t: felt(t) + [4.0, 0, 0],
        "shaken": lambda t: felt(t) + rng.normal(0, 4.0, 3),
        "nan": lambda t: np.full(3, np.nan),
        "huge": lambda t: np.full(3, 1e308),
    }
    for name, acceleration in cases.items():
        bag = bag_of("sqlite3", acceleration)
        assert opened(bag, tmp_path / name).scan(2).gravity is None, name
    for name, times in (("few", TIMES[::40]), ("clock", TIMES - 1000.0)):
        bag = bag_of("sqlite3", felt, times=times)
        assert opened(bag, tmp_path / name).scan(2).gravity is None, name


def test_an_imu_whose_place_is_not_known(tmp_path: Path) -> None:
    """Taken as aligned with the sensor, with a note, unless that cannot be."""
    bag = bag_of("sqlite3", placed=False)
    for time in TIMES:
        bag.imu("/other", time, 9.81 * Z, "there")
        bag.imu("/imu", time, 9.81 * Z) if time > START else None
    sequence = opened(bag, tmp_path / "aligned")
    message = "/other: no transform lidar -> there in the bag: assumed aligned"
    assert sequence.notes == (message,)
    np.testing.assert_allclose(sequence.scan(1).gravity, -Z, atol=1e-9)
    over = bag_of("sqlite3", lambda time: -9.81 * Z, placed=False)
    assert opened(over, tmp_path / "over").scan(1).gravity is None
    own = bag_of("sqlite3", placed=False)
    for time in TIMES:
        own.imu("/imu", time, -9.81 * Z, "lidar")  # in the sensor's own frame: upside down
    sequence = opened(own, tmp_path / "own")
    assert sequence.notes == ()
    np.testing.assert_allclose(sequence.scan(1).gravity, Z, atol=1e-9)


def test_poses_come_before_gravity(tmp_path: Path) -> None:
    bag = bag_of("mcap", felt)
    for time in TIMES:
        bag.odometry("/odom", time, DRIVE.pose(time), "base_link")
    sequence = opened(bag, tmp_path / "drive")
    assert sequence.gravity is None and sequence.scan(2).gravity is None
    T = sequence.scan(2).T_odom_sensor
    np.testing.assert_allclose(T, DRIVE.poses[2] @ LIDAR, atol=1e-4)
    assert opened(bag, tmp_path / "2", poses="none").scan(2).gravity is not None


def test_odometry_of_a_base_that_is_said_by_hand(tmp_path: Path) -> None:
    """Where tf does not have the sensor on the base."""
    bag = bag_of("mcap", placed=False)
    for time in TIMES:
        bag.odometry("/odom", time, DRIVE.pose(time), "base_link")
    assert opened(bag, tmp_path / "unknown").poses is None
    sequence = opened(bag, tmp_path / "noted", T_base_sensor=LIDAR)
    np.testing.assert_allclose(sequence.poses, DRIVE.poses @ LIDAR, atol=1e-4)
    np.testing.assert_array_equal(sequence.scan(0).T_base_sensor, LIDAR)


def test_only_a_frame_named_as_a_base_is_one(tmp_path: Path) -> None:
    for parent, expected in (("robot1/base_footprint", LIDAR), ("camera", None)):
        bag = bag_of("sqlite3", placed=False)
        bag.tf("/tf_static", START - 1, LIDAR, parent, "lidar")
        bag.tf("/tf", START - 1, np.eye(4), "odom", parent)
        bag.tf("/tf", START + 1, matrix((1, 0, 0), (0, 0, 0)), "odom", parent)
        path = tmp_path / parent.replace("/", "_")
        T = opened(bag, path, poses="none").scan(0).T_base_sensor
        assert (T is None) == (expected is None)
        if expected is not None:
            np.testing.assert_allclose(T, expected, atol=1e-6)
