"""Ouster's packets in captures and in bags, against the documented geometry and Ouster's SDK."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from samples.datasets import START, Drive, write_pcap
from samples.ouster import (
    COLUMNS,
    PIXELS,
    TURN_S,
    Ouster,
    capture,
    imu_packet,
    ip_packets,
    recorded,
)

from segloc.errors import DatasetError
from segloc.tools.datasets import open_sequence
from segloc.tools.datasets.packets.ouster_packets import gather, read_sensor
from segloc.types import Float64, Scan


def expected(sensor: Ouster, turn: int) -> Float64:
    """Points of a turn, column by column, by the formulas of the documentation, one by one."""
    points = []
    for column, ranges in enumerate(sensor.ranges(turn) * 1e-3):
        encoder = 2 * np.pi * (1 - column / COLUMNS)
        for r, altitude, azimuth in zip(ranges, sensor.altitudes, sensor.azimuths, strict=True):
            if r == 0:
                continue
            n, phi, theta = 15.8e-3, np.radians(altitude), encoder - np.radians(azimuth)
            x = (r - n) * np.cos(theta) * np.cos(phi) + n * np.cos(encoder)
            y = (r - n) * np.sin(theta) * np.cos(phi) + n * np.sin(encoder)
            points.append((-x, -y, (r - n) * np.sin(phi) + 36.18e-3))
    return np.array(points)


def check(scan: Scan, sensor: Ouster, turn: int) -> None:
    np.testing.assert_allclose(scan.points, expected(sensor, turn), atol=2e-5)
    column = np.repeat(np.arange(COLUMNS), (sensor.ranges(turn) > 0).sum(axis=1))
    np.testing.assert_allclose(scan.times, TURN_S * column / COLUMNS, atol=1e-8)


@pytest.mark.parametrize("profile", PIXELS)
def test_turns_of_a_capture(profile: str, tmp_path: Path) -> None:
    sensor = Ouster(profile)
    sequence = open_sequence(recorded(tmp_path / "drive.pcap", sensor, 4))
    assert (sequence.format, sequence.frame, len(sequence)) == ("Ouster packets", "os_sensor", 4)
    first = START + TURN_S * (np.arange(4) + 16 / COLUMNS)
    np.testing.assert_allclose(sequence.stamps, first, atol=2e-6)
    for turn in (3, 0):
        check(sequence.scan(turn), sensor, turn)


@pytest.mark.parametrize("layout", ["new", "old", "oldest"])
@pytest.mark.parametrize("mtu", [576, 65535])
def test_metadata_of_all_ages_and_any_fragments(layout: str, mtu: int, tmp_path: Path) -> None:
    sensor = Ouster("LEGACY")
    sequence = open_sequence(recorded(tmp_path / "drive.pcap", sensor, 2, layout, mtu=mtu))
    check(sequence.scan(1), sensor, 1)


@pytest.mark.parametrize("profile", PIXELS)
def test_points_are_those_of_the_sdk(profile: str, tmp_path: Path) -> None:
    core = pytest.importorskip("ouster.sdk.core", reason="compares with ouster-sdk")
    sensor = Ouster(profile)
    info = core.SensorInfo(json.dumps(sensor.metadata()))
    frame, batcher = core.LidarFrame(info), core.FrameBatcher(info)
    layout = core.PacketFormat(info)
    for stamp, data in sensor.packets(2):
        packet = core.LidarPacket(layout)
        packet.buf[:] = np.frombuffer(data, np.uint8)
        packet.host_timestamp = round(stamp * 1e9)
        if batcher.batch(packet, frame):
            break
    theirs = core.XYZLut(info)(frame).transpose(1, 0, 2).reshape(-1, 3)
    theirs = theirs[frame.field("RANGE").T.reshape(-1) > 0]
    ours = open_sequence(recorded(tmp_path / "drive.pcap", sensor, 2)).scan(0)
    np.testing.assert_allclose(ours.points, theirs, atol=2e-5)


def test_gravity_of_the_sensors_own_imu(tmp_path: Path) -> None:
    """A tenth of the packets are its; it is turned in the sensor's housing."""
    sensor = Ouster()
    metadata = sensor.metadata()
    turned = [0, 1, 0, 6.2, -1, 0, 0, -11.7, 0, 0, 1, 7.6, 0, 0, 0, 1]
    metadata["imu_intrinsics"]["imu_to_sensor_transform"] = turned
    metadata["config_params"]["udp_port_imu"] = 7503
    (tmp_path / "drive.json").write_text(json.dumps(metadata))
    sent = sensor.packets(4)
    path = capture(tmp_path / "drive.pcap", sent, imu=imu_packet((0.3, 0.0, 0.95)))
    sequence = open_sequence(path)
    check(sequence.scan(1), sensor, 1)
    np.testing.assert_allclose(sequence.scan(1).gravity, [0, 0.301, -0.954], atol=1e-3)
    assert sequence.scan(1).gravity_error_deg > 0
    for wrong in ((0.3, 0.0, 0.5), (np.nan, 0.0, 1.0)):
        capture(path, sent, imu=imu_packet(wrong))
        assert open_sequence(path).scan(1).gravity is None
    metadata["config_params"]["udp_profile_imu"] = "ACCEL32_GYRO32_NMEA"  # another layout
    (tmp_path / "drive.json").write_text(json.dumps(metadata))
    capture(path, sent, imu=imu_packet((0.3, 0.0, 0.95)))
    assert open_sequence(path).scan(1).gravity is None


def test_packets_that_are_late_lost_or_repeated_numbers(tmp_path: Path) -> None:
    sensor = Ouster("RNG15_RFL8_NIR8")
    sent = sensor.packets(4)
    sent[31], sent[32] = sent[32], sent[31]  # the last of a turn comes after the next one's first
    del sent[70]
    sent = sent[28:]  # four packets of the first turn are no turn
    (tmp_path / "drive.json").write_text(json.dumps(sensor.metadata()))
    sequence = open_sequence(capture(tmp_path / "drive.pcap", sent))
    assert sequence.notes == ("1 of 3 turns miss packets",)
    check(sequence.scan(0), sensor, 1)
    check(sequence.scan(2), sensor, 3)
    assert len(sequence.scan(1)) == len(expected(sensor, 2)) - (16 * 8 - 1)
    again = gather(
        [(k, float(k), k, k + 1) for k in (5,) * 32 + (6,) * 32 + (5,) * 32],
        read_sensor(json.dumps(sensor.metadata()), ""),
    )
    assert again.numbers.tolist() == [5, 6]


def test_two_sensors_are_told_by_their_ports(tmp_path: Path) -> None:
    left, right = Ouster(), Ouster(altitudes=[20.0, 15, 10, 5, 0, -5, -10, -15])
    for name, sensor, port in (("left", left, 7502), ("right", right, 7504)):
        metadata = sensor.metadata()
        metadata["config_params"]["udp_port_lidar"] = port
        (tmp_path / f"drive_{name}.json").write_text(json.dumps(metadata))
    (tmp_path / "drive_notes.json").write_text("{}")
    both = capture(tmp_path / "a", left.packets(2)).read_bytes()
    both += capture(tmp_path / "b", right.packets(2), port=7504).read_bytes()[24:]
    path = tmp_path / "drive.pcap"
    path.write_bytes(both)
    with pytest.raises(DatasetError, match=r"choose one: --topic drive_left\|drive_right"):
        open_sequence(path)
    for name, sensor in (("drive_left", left), ("drive_right", right)):
        check(open_sequence(path, topic=name).scan(1), sensor, 1)


def test_several_sensors_that_metadata_do_not_tell_apart_are_refused(tmp_path: Path) -> None:
    sensor, path = Ouster(), tmp_path / "drive.pcap"
    both = recorded(path, sensor, 2, "old").read_bytes()
    both += capture(tmp_path / "b", sensor.packets(2), port=7504).read_bytes()[24:]
    path.write_bytes(both)
    with pytest.raises(DatasetError, match=r"several sensors, 10\.0\.0\.1:7502, 10\.0\.0\.1:7504"):
        open_sequence(path)


def test_metadata_and_captures_that_are_wrong(tmp_path: Path) -> None:
    sensor = Ouster()
    path = recorded(tmp_path / "drive.pcap", sensor, 2)
    file = tmp_path / "drive.json"
    whole = sensor.metadata("old")
    for changes, fault in (
        ({"beam_azimuth_angles": [1.0]}, "8 altitudes and 1 azimuths"),
        ({"beam_altitude_angles": "up"}, "could not convert"),
        ({"data_format": {"udp_profile_lidar": "RNG99"}}, "profile 'RNG99'"),
        ({"data_format": {"columns_per_frame": 0}}, "'columns_per_frame' is 0"),
        ({"lidar_to_sensor_transform": [1, 2]}, "not Ouster metadata"),
        ({"data_format": {"pixels_per_column": 64}}, "8 beams, but 64 pixels"),
        (
            {"udp_port_lidar": 9},
            "0 of 71 datagrams have 1792 bytes to port 9, as set in",
        ),
    ):
        file.write_text(json.dumps(whole | changes))
        with pytest.raises(DatasetError, match=fault) as caught:
            open_sequence(path)
        assert "drive.json" in str(caught.value)
        assert "\n" not in str(caught.value)
    file.unlink()
    with pytest.raises(DatasetError, match=r"no Ouster metadata beside it \(drive\.json\)"):
        open_sequence(path)


METADATA = json.dumps(Ouster().metadata()).encode()


@given(st.integers(0, len(METADATA)), st.integers(0, len(METADATA) - 1), st.integers(0, 255))
def test_damaged_metadata(end: int, place: int, byte: int) -> None:
    damaged = bytearray(METADATA)
    damaged[place] = byte
    for text in (METADATA[:end], bytes(damaged)):
        try:
            read_sensor(text, "drive.json")
        except DatasetError as error:
            assert str(error).startswith("drive.json: ")
            assert "\n" not in str(error)


def test_datagrams_that_are_broken(tmp_path: Path) -> None:
    """Fragments out of order, missing, repeated, too short: whole datagrams only."""
    from segloc.tools.datasets.packets.captures import datagrams, map_file

    content = bytes(range(256)) * 20
    frames = ip_packets(content, 1)
    others = ip_packets(content, 2)
    stream = [frames[2], others[0], frames[0], frames[0], others[1], frames[3], frames[1]]
    stream += [b"", bytes(14), frames[0][:30], ip_packets(b"", 3)[0][:-4]]
    path = write_pcap(tmp_path / "a.pcap", [(0.0, frame) for frame in stream])
    with map_file(path) as data:
        found = [(d.port, d.content(data)) for d in datagrams(data)]
    assert found == [(7502, content)]


@pytest.mark.parametrize("kind", ["ros1", "sqlite3", "mcap"])
def test_packets_in_a_bag(kind: str, tmp_path: Path) -> None:
    pytest.importorskip("rosbags")
    from rosbags.typesys import get_types_from_msg
    from samples.bags import BagWriter

    sensor, drive = Ouster(), Drive.make()
    packages = {"ros1": "ouster_ros", "sqlite3": "ouster_msgs", "mcap": "ouster_sensor_msgs"}
    message, text = f"{packages[kind]}/msg/PacketMsg", "std_msgs/msg/String"
    bag = BagWriter(kind, late_s=0.0)
    bag.store.register(get_types_from_msg("uint8[] buf\n", message))
    for stamp, data in sensor.packets(3):
        buffer = np.frombuffer(data + b"\0" * (kind == "ros1"), np.uint8)
        bag.add("/ouster/lidar_packets", message, stamp, bag.make(message, buf=buffer))
        imu = bag.make(message, buf=np.frombuffer(imu_packet((0.1, 0.0, 1.0)), np.uint8))
        bag.add("/ouster/imu_packets", message, stamp, imu)
        bag.odometry("/odom", stamp - 0.01, drive.pose(stamp - 0.01), "os_sensor")
    bare = bag.messages.copy()
    metadata = bag.make(text, data=json.dumps(sensor.metadata()))
    bag.add("/ouster/metadata", text, START, metadata)
    sequence = open_sequence(bag.write(tmp_path / "drive"))
    assert (len(sequence), sequence.frame) == (3, "os_sensor")
    np.testing.assert_allclose(sequence.stamps[0], START + TURN_S * 16 / COLUMNS, atol=2e-6)
    assert sequence.scan(1).gravity is None  # there are poses
    alone = open_sequence(bag.write(tmp_path / "alone"), "none")
    np.testing.assert_allclose(alone.scan(1).gravity, [-0.0995, 0, -0.995], atol=1e-4)
    for turn in (2, 0):
        check(sequence.raw(turn), sensor, turn)
    np.testing.assert_allclose(sequence.poses[1], drive.pose(sequence.stamps[1]), atol=1e-4)
    assert sequence.scan(1).times is None  # de-skewed
    bag.messages = bare
    with pytest.raises(DatasetError, match="no metadata on /ouster/metadata"):
        open_sequence(bag.write(tmp_path / "bare"))
