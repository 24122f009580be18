"""Velodyne's packets in captures and in bags, with geometry written out from the manual."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("velodyne_decoder")

from samples.datasets import START

from segloc.datasets import RecordedSequence, open_sequence
from segloc.errors import DatasetError

FIRING_US = 55.296  # of the VLP-16: a sequence of 16 lasers; two in a block, 12 blocks in a packet
LASERS_DEG = (-15, 1, -13, 3, -11, 5, -9, 7, -7, 9, -5, 11, -3, 13, -1, 15)
REACH_M = 10.0


def packets(turns: float) -> list[tuple[float, bytes]]:
    """What a VLP-16 in the middle of a sphere sends at 10 Hz; one wall is nearer."""
    sent = []
    for number in range(round(turns * 1800 / 24)):
        data = b""
        for block in range(12):
            azimuth = (number * 12 + block) * 40 % 36000
            reach = REACH_M / 2 if 9000 <= azimuth < 18000 else REACH_M  # behind to the right
            returns = struct.pack("<HB", round(reach / 0.002), 10) * 32
            data += b"\xff\xee" + struct.pack("<H", azimuth) + returns
        time = number * 24 * FIRING_US * 1e-6
        data += struct.pack("<IBB", round(time * 1e6), 0x37, 0x22)  # strongest return, VLP-16
        sent.append((START + time, data))
    return sent


def capture(
    path: Path, sent: list[tuple[float, bytes]], order: str = "<", unit: int = 10**6
) -> Path:
    magic = 0xA1B2C3D4 if unit == 10**6 else 0xA1B23C4D
    content = struct.pack(f"{order}IHHiIII", magic, 2, 4, 0, 0, 65535, 1)
    for stamp, data in sent:
        frame = bytes(42) + data  # headers of Ethernet, IP and UDP
        seconds, rest = divmod(round(stamp * unit), unit)
        content += struct.pack(f"{order}IIII", seconds, rest, len(frame), len(frame)) + frame
    path.write_bytes(content)
    return path


def check(points: np.ndarray, times: np.ndarray | None) -> None:
    """A sphere of 16 rings around the sensor, nearer in the quarter behind to the right."""
    points = points.astype(np.float64)
    reach = np.linalg.norm(points, axis=1)
    elevation = np.degrees(np.arcsin(points[:, 2] / reach))
    assert set(np.unique(elevation.round()).astype(int)) == set(LASERS_DEG)
    behind = (points[:, 0] < -0.3) & (points[:, 1] < -0.3)
    assert np.abs(reach[behind] - REACH_M / 2).max() < 0.05
    others = (points[:, 0] > 0.3) | (points[:, 1] > 0.3)
    assert np.abs(reach[others] - REACH_M).max() < 0.05
    assert times is not None
    assert 0 <= times.min() < 1e-4
    assert 0.098 < times.max() < 0.1
    clockwise = np.unwrap(-np.arctan2(points[:, 1], points[:, 0])[np.argsort(times, kind="stable")])
    assert clockwise[-1] - clockwise[0] == pytest.approx(2 * np.pi, abs=0.1)


@pytest.mark.parametrize(("order", "unit"), [("<", 10**6), (">", 10**9)])
def test_turns_of_a_capture(order: str, unit: int, tmp_path: Path) -> None:
    path = capture(tmp_path / "drive.pcap", packets(3.0), order, unit)
    sequence = open_sequence(path)
    assert isinstance(sequence, RecordedSequence)
    assert (sequence.format, len(sequence)) == ("Velodyne packets", 3)
    np.testing.assert_allclose(
        sequence.stamps, START + 75 * 24 * FIRING_US * 1e-6 * np.arange(3), atol=2e-6
    )
    for i in (2, 0):
        scan = sequence.scan(i)
        assert len(scan) == 1800 * 16
        check(scan.points, scan.times)


def test_a_capture_that_was_cut_off_or_is_none(tmp_path: Path) -> None:
    path = capture(tmp_path / "drive.pcap", packets(2.0))
    whole = path.read_bytes()
    for size in (0, 10, 30, 5000):
        path.write_bytes(whole[:size])
        with pytest.raises(DatasetError, match=r"drive\.pcap: (cut off|no turn)"):
            open_sequence(path)
    path.write_bytes(b"none" + whole)
    with pytest.raises(DatasetError, match="not a capture in the format of libpcap"):
        open_sequence(path)
    path.write_bytes(whole[:-700])
    assert [len(open_sequence(path).scan(i)) for i in range(2)] == [28_800, 28_800 - 24 * 16]


@pytest.mark.parametrize("last", [False, True])
def test_packets_in_a_bag(last: bool, tmp_path: Path) -> None:
    """Drivers stamp a scan by its first packet or by its last."""
    pytest.importorskip("rosbags")
    from rosbags.typesys import get_types_from_msg
    from samples.bags import BagWriter

    bag = BagWriter("ros1")
    packet, scan = "velodyne_msgs/msg/VelodynePacket", "velodyne_msgs/msg/VelodyneScan"
    bag.store.register(get_types_from_msg("time stamp\nuint8[1206] data\n", packet))
    text = "std_msgs/Header header\nvelodyne_msgs/VelodynePacket[] packets\n"
    bag.store.register(get_types_from_msg(text, scan))
    sent = packets(1.0)
    stamp = sent[-1 if last else 0][0]
    content = [
        bag.make(packet, stamp=bag.header(time, "").stamp, data=np.frombuffer(data, np.uint8))
        for time, data in sent
    ]
    message = bag.make(scan, header=bag.header(stamp, "velodyne"), packets=content)
    bag.add("/velodyne_packets", scan, stamp, message)
    sequence = open_sequence(bag.write(tmp_path / "drive"))
    assert isinstance(sequence, RecordedSequence)
    assert sequence.frame == "velodyne"
    cloud = sequence.scan(0)
    assert cloud.times is not None
    check(cloud.points, cloud.times + stamp - START)
