"""Bags of every kind: clouds, topics, poses, times, and what is wrong with them."""

from __future__ import annotations

import pickle
import shutil
import sqlite3
import struct
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rosbags")

from samples.bags import KINDS, PACKING, BagWriter
from samples.datasets import START, Drive, matrix
from samples.mcap import Channel, write_mcap

from segloc import geometry
from segloc.errors import DatasetError
from segloc.tools.datasets import open_sequence
from segloc.tools.datasets.inspection import inspect
from segloc.tools.datasets.ros.bag_messages import livox_scan
from segloc.types import Float64

DRIVE = Drive.make(8)
MOUNT = matrix((0.4, 0.1, 1.2), (0.05, -0.02, 0.3))


def clouds(bag: BagWriter, topic: str = "/points", frame: str = "lidar") -> BagWriter:
    for i, stamp in enumerate(DRIVE.stamps):
        bag.cloud(topic, stamp, DRIVE.seen(i), frame)
    return bag


def times(step: float = 0.02) -> Float64:
    return np.arange(START - 0.05, DRIVE.stamps[-1] + 0.05, step)


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_clouds_stamps_and_odometry(kind: str, tmp_path: Path) -> None:
    """Poses are those at the stamps, though messages are recorded 30 ms later."""
    bag = clouds(BagWriter(kind))
    for time in times():
        bag.odometry("/odom", time, DRIVE.pose(time) @ geometry.inverse(MOUNT), "base_link")
    bag.tf("/tf_static", START - 1, MOUNT, "base_link", "lidar")
    path = bag.write(tmp_path / "drive", "LZ4" if kind == "ros1" else "")
    sequence = open_sequence(path)
    assert (sequence.name, sequence.frame, len(sequence)) == ("drive", "lidar", 8)
    assert {"ros1": "ROS 1", "sqlite3": "SQLite", "mcap": "MCAP"}[kind] in sequence.format
    np.testing.assert_allclose(sequence.stamps, DRIVE.stamps, atol=1e-6)
    np.testing.assert_allclose(sequence.poses, DRIVE.poses, atol=1e-4)
    assert sequence.track.source == "/odom"
    for i in (5, 0, 7):  # in any order
        np.testing.assert_allclose(sequence.scan(i).points, DRIVE.seen(i), atol=1e-5)
    again = pickle.loads(pickle.dumps(sequence))
    np.testing.assert_array_equal(again.scan(3).points, sequence.scan(3).points)
    inside = next(path.glob("*.[dm]*[b3p]")) if path.is_dir() else path
    np.testing.assert_array_equal(open_sequence(inside).scan(2).points, sequence.scan(2).points)
    assert open_sequence(path, poses="none").poses is None


@pytest.mark.parametrize("kind", KINDS)
def test_compression_makes_no_difference(kind: str, tmp_path: Path) -> None:
    plain = open_sequence(clouds(BagWriter(kind)).write(tmp_path / "plain"))
    packed = open_sequence(clouds(BagWriter(kind)).write(tmp_path / "packed", PACKING[kind]))
    np.testing.assert_array_equal(plain.stamps, packed.stamps)
    np.testing.assert_array_equal(plain.scan(5).points, packed.scan(5).points)


def test_a_recording_in_several_bags(tmp_path: Path) -> None:
    plain = open_sequence(clouds(BagWriter("ros1")).write(tmp_path / "plain"))
    several = tmp_path / "several"
    several.mkdir()
    for part in range(2):
        bag = BagWriter("ros1")
        for i in range(4 * part, 4 * part + 4):
            bag.cloud("/points", DRIVE.stamps[i], DRIVE.seen(i))
        bag.write(several / f"part_{1 - part}")
    whole = open_sequence(several)
    np.testing.assert_array_equal(whole.stamps, plain.stamps)
    np.testing.assert_array_equal(whole.scan(5).points, plain.scan(5).points)


@pytest.mark.parametrize("kind", KINDS)
def test_poses_from_tf(kind: str, tmp_path: Path) -> None:
    """map -> odom -> base -> lidar, the second the finest and the last fixed."""
    bag = clouds(BagWriter(kind))
    shift = geometry.yaw_transform(0.5, (100.0, 50.0, 0.0))
    for k, time in enumerate(times()):
        body = geometry.inverse(shift) @ DRIVE.pose(time) @ geometry.inverse(MOUNT)
        bag.tf("/tf", time, body, "odom", "base_link")
        if k % 5 == 0 or time + 0.1 > times()[-1]:
            bag.tf("/tf", time, shift, "map", "/odom")
    bag.tf("/tf_static", START - 1, MOUNT, "base_link", "lidar")
    sequence = open_sequence(bag.write(tmp_path / "drive"))
    assert sequence.track.source == "tf, map to lidar"
    np.testing.assert_allclose(sequence.poses, DRIVE.poses, atol=1e-4)


def test_odometry_of_an_unknown_body_is_not_used(tmp_path: Path) -> None:
    bag = clouds(BagWriter("sqlite3"))
    for time in times():
        bag.odometry("/odom", time, DRIVE.pose(time), "base_link")
    sequence = open_sequence(bag.write(tmp_path / "drive"))
    assert sequence.poses is None
    assert sequence.notes == (
        "no transform base_link -> lidar in the bag, so /odom is not used: record /tf_static, or "
        "set local_cloud.mount",
    )
    bag = clouds(BagWriter("sqlite3"))
    for time in times():
        bag.odometry("/odom", time, DRIVE.pose(time), "lidar")
    known = open_sequence(bag.write(tmp_path / "2"))
    np.testing.assert_allclose(known.poses, DRIVE.poses, atol=1e-4)


@pytest.mark.parametrize("kind", KINDS)
def test_topics(kind: str, tmp_path: Path) -> None:
    bag = clouds(clouds(BagWriter(kind), "/front", "front"), "/rear", "rear")
    bag.odometry("/odom", START, np.eye(4), "base")
    path = bag.write(tmp_path / "drive")
    several = r"several topics, choose one with --topic: /front \(8\), /rear \(8\)"
    with pytest.raises(DatasetError, match=several):
        open_sequence(path)
    assert open_sequence(path, topic="/rear").frame == "rear"
    with pytest.raises(DatasetError, match=r"no scans on '/odom'; available: /front \(8\)"):
        open_sequence(path, topic="/odom")
    other = BagWriter(kind)
    other.odometry("/odom", START, np.eye(4), "base")
    path = other.write(tmp_path / "other")
    with pytest.raises(DatasetError, match=r"no topic of scans; topics: /odom \(nav_msgs/msg/O"):
        open_sequence(path)


@pytest.mark.parametrize(
    ("field", "dtype", "unit", "since", "note"),
    [
        ("t", "u4", 1e9, 0.0, ""),
        ("t", "u4", 1e6, 0.0, "multiplied by 1000"),
        ("time", "f4", 1.0, 0.0, ""),
        ("time", "f4", 10.0, 0.0, "fractions of a turn of 0.1 s"),
        ("timestamp", "f8", 1.0, 1.0, ""),
        ("timestamp", "f4", 1.0, 1.0, "float32"),
    ],
)
def test_times_of_points(
    field: str, dtype: str, unit: float, since: float, note: str, tmp_path: Path
) -> None:
    """As Ouster, Velodyne, Hesai and others write them: each point as it was seen at its time."""
    bag = BagWriter("mcap")
    spread = np.linspace(0, 0.1, len(DRIVE.landmarks))
    for stamp in DRIVE.stamps:
        values = (spread + since * stamp) * unit
        bag.cloud("/points", stamp, DRIVE.swept(stamp + spread), times=(field, dtype, values))
    for time in np.arange(START - 0.05, DRIVE.stamps[-1] + 0.2, 0.02):
        bag.odometry("/odom", time, DRIVE.pose(time), "lidar")
    path = bag.write(tmp_path / "drive")
    sequence = open_sequence(path)
    assert field in sequence.fields
    assert [note in each for each in sequence.notes] == [True] * bool(note)
    raw = open_sequence(path, deskew=False).scan(0)
    if note == "float32":
        assert raw.times is None
        return
    np.testing.assert_allclose(raw.times, spread, atol=1e-5)
    for i in (0, 7):
        np.testing.assert_allclose(sequence.scan(i).points, DRIVE.seen(i), atol=2e-4)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("package", ["livox_ros_driver", "livox_ros_driver2"])
def test_livox_messages(kind: str, package: str, tmp_path: Path) -> None:
    """The bytes as rosbags writes them by the message's definition, moved along the poses."""
    bag = BagWriter(kind)
    spread = np.linspace(0, 0.09, len(DRIVE.landmarks))
    for stamp in DRIVE.stamps:
        seen = DRIVE.swept(stamp + spread)
        seen[3] = 0.0  # no return
        bag.livox("/livox/lidar", stamp, seen, spread, package)
    bag.livox("/livox/lidar", DRIVE.stamps[-1] + 0.1, np.empty((0, 3)), np.empty(0), package)
    for time in np.arange(START - 0.05, DRIVE.stamps[-1] + 0.3, 0.02):
        bag.odometry("/odom", time, DRIVE.pose(time), "livox")
    bag.laser("/scan", START, np.ones(9), 0.5, 0.0)  # passed over
    sequence = open_sequence(bag.write(tmp_path / "drive"))
    assert (len(sequence), sequence.frame) == (9, "livox")
    assert sequence.fields == "x y z reflectivity tag line offset_time"
    for i in (0, 7):
        expected = np.delete(DRIVE.seen(i), 3, axis=0)
        np.testing.assert_allclose(sequence.scan(i).points, expected, atol=2e-4)
    assert len(sequence.scan(8)) == 0
    raw = sequence.raw(0)
    np.testing.assert_allclose(raw.times, np.delete(spread, 3), atol=1e-8)


def test_livox_messages_in_other_bytes() -> None:
    """Big-endian, and cut off anywhere."""
    packed = [struct.pack(f"{order}iII", 7, 8, 6) + b"livox\0" for order in "<>"]
    bodies = []
    for order, body in zip("<>", packed, strict=True):
        rest = struct.pack(f"{order}6xQIB3xI", 5, 2, 1, 2)
        point = [struct.pack(f"{order}I3f3B", 1000 * k, 1.0, k, 2.0, 9, 9, 9) for k in (1, 2)]
        bodies.append(body + rest + point[0] + b"\0" + point[1])
    little, big = b"\0\1\0\0" + bodies[0], b"\0\0\0\0" + bodies[1]
    for data in (little, big):
        scan = livox_scan(data, cdr=True)
        np.testing.assert_array_equal(scan.points, [[1, 1, 2], [1, 2, 2]])
        np.testing.assert_allclose(scan.times, [1e-6, 2e-6])
        for length in range(len(data)):
            with pytest.raises(DatasetError, match="cut off"):
                livox_scan(data[:length], cdr=True)


@pytest.mark.parametrize("kind", KINDS)
def test_sweeps_of_a_planar_scanner(kind: str, tmp_path: Path) -> None:
    bag = BagWriter(kind)
    step = 1.5 * np.pi / 270
    angles = -0.75 * np.pi + step * np.arange(271)
    ranges = 5 + np.cos(3 * angles)
    ranges[[0, 7, 9, 20]] = [np.inf, np.nan, 0.01, 31.0]  # what is no return
    hit = np.delete(np.arange(271), [0, 7, 9, 20])
    for k, stamp in enumerate(DRIVE.stamps):
        bag.laser("/scan", stamp, ranges, step, 1e-4 if k else 0.0)
    sequence = open_sequence(bag.write(tmp_path / "drive"))
    assert (sequence.frame, sequence.fields) == ("laser", "x y intensity time")
    assert inspect(sequence).sensor == "2D, one plane"
    assert sequence.scan(0).times is None
    scan = sequence.scan(5)
    expected = np.column_stack([ranges * np.cos(angles), ranges * np.sin(angles), 0 * angles])
    np.testing.assert_allclose(scan.points, expected[hit], atol=1e-5)
    np.testing.assert_allclose(scan.times, 1e-4 * hit, atol=1e-8)
    clouds(bag)  # clouds are preferred, and sweeps can still be chosen
    path = bag.write(tmp_path / "both")
    assert open_sequence(path).frame == "lidar"
    assert open_sequence(path, topic="/scan").frame == "laser"


def test_layouts_of_clouds(tmp_path: Path) -> None:
    """Big-endian, organised with padded rows, NaN, firings without return, no points."""
    points = DRIVE.seen(0)
    broken = points.copy()
    broken[:7] = np.nan
    broken[7:10] = 0.0
    bag = BagWriter("sqlite3")
    bag.cloud("/points", START, points, big=True)
    bag.cloud("/points", START + 0.1, points, height=4, padding=12)
    bag.cloud("/points", START + 0.2, broken)
    bag.cloud("/points", START + 0.3, points[:0])
    sequence = open_sequence(bag.write(tmp_path / "drive"))
    for i in (0, 1):
        np.testing.assert_allclose(sequence.scan(i).points, points, atol=1e-5)
    scan = sequence.scan(2)
    assert (len(scan), scan.dropped) == (len(points) - 10, 7)
    np.testing.assert_allclose(scan.points, points[10:], atol=1e-5)
    assert len(sequence.scan(3)) == 0


def test_stamps_that_are_missing_or_do_not_rise(tmp_path: Path) -> None:
    bag = BagWriter("ros1", late_s=0.0)
    for k, shift in enumerate([0.0, 0.1, -0.3, 0.3, 0.3, 0.5]):
        bag.cloud("/points", START + shift, DRIVE.seen(0))
        bag.messages[-1] = (round((START + 0.1 * k) * 1e9), *bag.messages[-1][1:])
    sequence = open_sequence(bag.write(tmp_path / "back"))
    np.testing.assert_allclose(sequence.stamps - START, [0.0, 0.1, 0.3, 0.5], atol=1e-6)
    assert sequence.notes == ("2 of 6 messages dropped: stamps do not rise",)
    bag = BagWriter("ros1", late_s=START)
    for k in range(3):
        bag.cloud("/points", 0.0, DRIVE.seen(k))
    sequence = open_sequence(bag.write(tmp_path / "zero"))
    assert sequence.notes == ("/points has no stamps: using log times",)
    np.testing.assert_allclose(sequence.scan(2).points, DRIVE.seen(2), atol=1e-5)  # same time
    bag = BagWriter("ros1", late_s=START)
    for k, stamp in enumerate([0.0, START, START + 0.1]):
        bag.cloud("/points", stamp, DRIVE.seen(k))
    sequence = open_sequence(bag.write(tmp_path / "partly"))
    assert sequence.notes == ("1 of 3 messages dropped: no stamps",) and len(sequence) == 2


def test_two_sensors_on_one_topic(tmp_path: Path) -> None:
    bag = clouds(BagWriter("mcap"))
    bag.cloud("/points", DRIVE.stamps[-1] + 0.1, DRIVE.seen(0), "rear")
    message = r"message 8 of /points is in frame 'rear', those before it in 'lidar': two sensors"
    path = bag.write(tmp_path / "drive")
    with pytest.raises(DatasetError, match=message):
        open_sequence(path)


@pytest.mark.parametrize("kind", KINDS)
def test_bags_that_were_cut_off(kind: str, tmp_path: Path) -> None:
    """One line, or the scans before the cut; never another error, never other points."""
    path = clouds(BagWriter(kind)).write(tmp_path / "drive")
    file = next(path.glob("drive*.[dm]*[b3p]")) if path.is_dir() else path
    data = file.read_bytes()
    read = refused = 0
    for share in np.linspace(0, 0.999, 12):
        file.write_bytes(data[: int(share * len(data))])
        for place in {path, file}:
            try:
                sequence = open_sequence(place)
                for i in range(len(sequence)):
                    np.testing.assert_allclose(
                        sequence.scan(i).points, DRIVE.seen(int(sequence.indices[i])), atol=1e-5
                    )
                read += 1
            except DatasetError as error:
                assert "\n" not in str(error)
                assert str(path) in str(error)
                refused += 1
    assert refused >= 10


def test_of_several_bags_the_damaged_one_is_named(tmp_path: Path) -> None:
    folder = tmp_path / "drive"
    folder.mkdir()
    for k in range(3):
        clouds(BagWriter("ros1")).write(folder / f"part_{k}")
    last = folder / "part_2.bag"
    last.write_bytes(last.read_bytes()[: last.stat().st_size // 2])
    with pytest.raises(DatasetError, match=r"part_2\.bag: "):
        open_sequence(folder)


# --- MCAP of others -------------------------------------------------------------------------------

POINT_CLOUD = "sensor_msgs/msg/PointCloud2"
BESIDE: dict[str, Channel] = {
    "json": ("/log", "json", "foxglove.Log", b"{}", "jsonschema"),
    "protobuf": ("/image", "protobuf", "foxglove.Image", b"\xff\xfe\0", "protobuf"),
    "broken": ("/thing", "cdr", "my_msgs/msg/Thing", b"Type[] x\nfloat32 <<< y\n", "ros2msg"),
    "empty": ("/meta", "cdr", "RealsenseMetadata", b"", "ros2msg"),
}  # fmt: skip
DEFINITIONS = {
    "whole": b"",  # the bag's own
    "only a name": POINT_CLOUD.encode(),
    "another message": b"bool is_dense\n",
}


def written(path: Path, definition: str = "whole", *beside: Channel, **options: object) -> Path:
    bag = clouds(BagWriter("sqlite3"))
    text = DEFINITIONS[definition] or bag.store.generate_msgdef(POINT_CLOUD)[0].encode()
    messages = [
        (0, time, bytes(bag.store.serialize_cdr(message, kind)))
        for time, _, kind, message in bag.messages
    ]
    messages += [(k, messages[-1][1] + 1, b"\0\1\0\0{}") for k in range(1, len(beside) + 1)]
    channels = [("/points", "cdr", POINT_CLOUD, text, "ros2msg"), *beside]
    return write_mcap(path, channels, messages, **options)  # type: ignore[arg-type]


@pytest.mark.parametrize("options", [{}, {"chunked": True}, {"profile": ""}])
@pytest.mark.parametrize("definition", DEFINITIONS)
def test_clouds_beside_other_channels(
    definition: str, options: dict[str, object], tmp_path: Path
) -> None:
    path = written(tmp_path / "drive.mcap", definition, *BESIDE.values(), **options)
    sequence = open_sequence(path)
    assert len(sequence) == 8
    np.testing.assert_allclose(sequence.scan(5).points, DRIVE.seen(5), atol=1e-5)


def test_mcap_of_ros1(tmp_path: Path) -> None:
    bag = clouds(BagWriter("ros1"))
    messages = [
        (0, time, bytes(bag.store.serialize_ros1(message, kind)))
        for time, _, kind, message in bag.messages
    ]
    text = bag.store.generate_msgdef(POINT_CLOUD)[0].encode()
    channel = ("/points", "ros1", "sensor_msgs/PointCloud2", text, "ros1msg")
    path = write_mcap(tmp_path / "drive.mcap", [channel], messages, profile="ros1")
    sequence = open_sequence(path)
    np.testing.assert_allclose(sequence.stamps, DRIVE.stamps, atol=1e-6)
    np.testing.assert_allclose(sequence.scan(5).points, DRIVE.seen(5), atol=1e-5)


UNREAD = {
    "foxglove.PointCloud": ("protobuf", "republish it as sensor_msgs/msg/PointCloud2"),
    "sensor_msgs/msg/PointCloud": ("cdr", "republish it as sensor_msgs/msg/PointCloud2"),
    "point_cloud_interfaces/msg/CompressedPointCloud2": ("cdr", "point_cloud_transport republish"),
    "nebula_msgs/msg/NebulaPackets": ("cdr", "sensor's driver"),
    "pandar_msgs/msg/PandarScan": ("cdr", "sensor's driver"),
    "rslidar_msg/msg/RslidarPacket": ("cdr", "sensor's driver"),
}


@pytest.mark.parametrize("kind", UNREAD)
def test_clouds_that_are_not_read_are_named_with_a_remedy(kind: str, tmp_path: Path) -> None:
    encoding, remedy = UNREAD[kind]
    schema = "protobuf" if encoding == "protobuf" else "ros2msg"
    channel = ("/cloud", encoding, kind, b"", schema)
    path = write_mcap(tmp_path / "drive.mcap", [channel], [(0, 1, b"\0\1\0\0")])
    with pytest.raises(DatasetError, match=rf"/cloud \({kind}.*{remedy}"):
        open_sequence(path)
    beside = written(tmp_path / "both.mcap", "whole", channel)
    assert len(open_sequence(beside)) == 8
    with pytest.raises(DatasetError, match=remedy):
        open_sequence(beside, topic="/cloud")


# --- a recorder that was killed -------------------------------------------------------------------


def test_what_a_killed_recorder_left_in_its_log(tmp_path: Path) -> None:
    whole = clouds(BagWriter("sqlite3")).write(tmp_path / "drive")
    file = next(whole.glob("*.db3"))
    killed = tmp_path / "killed"
    killed.mkdir()
    database = sqlite3.connect(file, isolation_level=None)
    rows = database.execute("SELECT * FROM messages WHERE id > 3").fetchall()
    database.execute("DELETE FROM messages WHERE id > 3")
    database.execute("PRAGMA journal_mode=WAL")
    database.execute("PRAGMA wal_autocheckpoint=0")
    database.executemany("INSERT INTO messages VALUES (?, ?, ?, ?)", rows)
    for part in whole.iterdir():
        shutil.copy(part, killed / part.name)
    database.close()
    before = {part.name: part.read_bytes() for part in killed.iterdir()}
    assert any(name.endswith("-wal") for name in before)
    sequence = open_sequence(killed)
    assert len(sequence) == 8
    np.testing.assert_allclose(sequence.scan(7).points, DRIVE.seen(7), atol=1e-5)
    assert len(open_sequence(killed / file.name)) == 8
    assert {part.name: part.read_bytes() for part in killed.iterdir()} == before
    for part in killed.glob("*.db3-*"):
        part.unlink()
    short = open_sequence(killed)
    assert len(short) == 3
    assert any("3 of 8 messages" in note for note in short.notes)


def test_messages_that_are_compressed_singly_without_metadata(tmp_path: Path) -> None:
    zstd = pytest.importorskip("backports.zstd")
    path = clouds(BagWriter("sqlite3")).write(tmp_path / "drive")
    file = next(path.glob("*.db3"))
    (path / "metadata.yaml").unlink()
    with sqlite3.connect(file) as database:
        for number, data in database.execute("SELECT id, data FROM messages").fetchall():
            packed = zstd.compress(data)
            database.execute("UPDATE messages SET data = ? WHERE id = ?", (packed, number))
    database.close()
    np.testing.assert_allclose(open_sequence(path).scan(5).points, DRIVE.seen(5), atol=1e-5)


# --- clouds in a world's frame --------------------------------------------------------------------

ROOM = np.random.default_rng(4).uniform((-20, -15, 0), (30, 15, 5), (40, 3))
"""Corners of boxes about a drive, 40 cm wide."""


def room_seen(T: Float64) -> Float64:
    """Points on the boxes as a sensor at T sees them, not the same each time."""
    rng = np.random.default_rng(int(1000 * abs(T[0, 3])))
    points = ROOM[rng.integers(0, len(ROOM), 6000)] + rng.uniform(0, 2.0, (6000, 3))
    return geometry.transform(geometry.inverse(T), points)


def world_bag(names: str, poses: Float64, *, by_tf: bool) -> BagWriter:
    """Clouds of FAST-LIO: registered, in the world; in the body's frame; or mislabelled ones."""
    bag = BagWriter("sqlite3")
    for k, T in enumerate(poses):
        stamp = START + 0.1 * k
        seen = room_seen(T)
        if "world" in names:
            bag.cloud("/cloud_registered", stamp, geometry.transform(T, seen), "camera_init")
        if "body" in names:
            bag.cloud("/cloud_registered_body", stamp, seen, "body")
        if "mislabelled" in names:
            turned = matrix((0.3, 0.0, 0.5), (0.0, 0.0, 2.0))  # the mount of the sensor
            bag.cloud("/points", stamp, geometry.transform(turned, seen), "camera_init")
        if by_tf:
            bag.tf("/tf", stamp, T, "camera_init", "body")
        else:
            bag.odometry("/Odometry", stamp, T, "body", "camera_init")
    return bag


DRIVEN = np.stack([matrix((0.8 * k, 0.0, 1.0), (0.0, 0.0, 0.05 * k)) for k in range(12)])


@pytest.mark.parametrize("by_tf", [False, True])
def test_clouds_in_a_worlds_frame_are_refused(by_tf: bool, tmp_path: Path) -> None:
    path = world_bag("world", DRIVEN, by_tf=by_tf).write(tmp_path / "world")
    for poses in (None, "none"):  # with any poses, so for --odometry, too
        with pytest.raises(DatasetError, match=r"/cloud_registered.*'camera_init'.*record the"):
            open_sequence(path, poses)
    both = world_bag("world body", DRIVEN, by_tf=by_tf).write(tmp_path / "both")
    with pytest.raises(DatasetError, match="use --topic /cloud_registered_body"):
        open_sequence(both, topic="/cloud_registered")
    body = open_sequence(both, topic="/cloud_registered_body")
    np.testing.assert_allclose(body.poses, DRIVEN, atol=1e-4)


def test_clouds_of_the_sensor_are_read_whatever_their_frame_is_called(tmp_path: Path) -> None:
    path = world_bag("mislabelled", DRIVEN, by_tf=False).write(tmp_path / "drive")
    sequence = open_sequence(path)
    assert len(sequence) == 12
    assert any("local_cloud.mount" in note for note in sequence.notes)
    still = np.tile(DRIVEN[:1], (12, 1, 1))  # clouds of a robot at rest are the same in any frame
    parked = world_bag("world", still, by_tf=True).write(tmp_path / "parked")
    assert len(open_sequence(parked)) == 12
