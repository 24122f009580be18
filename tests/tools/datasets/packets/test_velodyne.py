"""Velodyne's packets in captures and in bags, with geometry written out from the manual."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("velodyne_decoder")

from samples.datasets import START
from samples.real import real
from samples.velodyne import FIRING_US, LASERS_DEG, REACH_M, capture, packets

from segloc.errors import DatasetError
from segloc.tools.datasets import open_sequence


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
    assert 0 <= times.min() < 1e-4
    assert 0.098 < times.max() < 0.1
    clockwise = np.unwrap(-np.arctan2(points[:, 1], points[:, 0])[np.argsort(times, kind="stable")])
    assert clockwise[-1] - clockwise[0] == pytest.approx(2 * np.pi, abs=0.1)


@pytest.mark.parametrize(("order", "unit"), [("<", 10**6), (">", 10**9)])
def test_turns_of_a_capture(order: str, unit: int, tmp_path: Path) -> None:
    path = capture(tmp_path / "drive.pcap", packets(3.0), order, unit)
    sequence = open_sequence(path)
    assert (sequence.format, len(sequence)) == ("Velodyne packets", 3)
    np.testing.assert_allclose(
        sequence.stamps, START + 75 * 24 * FIRING_US * 1e-6 * np.arange(3), atol=2e-6
    )
    for i in (2, 0):
        scan = sequence.scan(i)
        assert len(scan) == 1800 * 16
        check(scan.points, scan.times)


def test_a_vlp16_that_names_itself_another_sensor(tmp_path: Path) -> None:
    early = capture(tmp_path / "early.pcap", packets(2.0, product=0x21))
    for name in (None, "VLP16"):
        scan = open_sequence(early, topic=name).scan(0)
        assert len(scan) == 1800 * 16
        check(scan.points, scan.times)
    told = open_sequence(early, topic="HDL32E").scan(0)
    low = np.degrees(np.arcsin(told.points[:, 2] / np.linalg.norm(told.points, axis=1))).min()
    assert low < -30.0
    with pytest.raises(DatasetError, match="no model or sensor 'VLP17'; supported: HDL32E, VLP16"):
        open_sequence(early, topic="VLP17")


def test_one_of_several_sensors_is_chosen(tmp_path: Path) -> None:
    both = capture(tmp_path / "both.pcap", packets(2.0), ports=(2368, 2369))
    with pytest.raises(DatasetError, match=r"--topic 10\.0\.0\.1:2368\|10\.0\.0\.1:2369"):
        open_sequence(both)
    for port in (2368, 2369):
        scan = open_sequence(both, topic=f"10.0.0.1:{port}").scan(0)
        assert len(scan) == 1800 * 16
        check(scan.points, scan.times)


def test_packets_that_change_places_stay_in_their_turn(tmp_path: Path) -> None:
    sent = packets(3.0)
    for k in (30, 74, 100):  # 74 and 75 belong to two turns
        sent[k], sent[k + 1] = sent[k + 1], sent[k]
    sequence = open_sequence(capture(tmp_path / "drive.pcap", sent))
    assert [len(sequence.scan(i)) for i in range(len(sequence))] == [1800 * 16] * 3


def test_a_pause_ends_a_turn(tmp_path: Path) -> None:
    sent = packets(4.0)
    late = [(stamp + 5.0, data) for stamp, data in sent[97:]]  # it goes on 15 degrees before
    sequence = open_sequence(capture(tmp_path / "drive.pcap", sent[:100] + late))
    assert (np.diff(sequence.stamps) > 0).all()
    spans = [sequence.scan(i).times.max() for i in range(len(sequence))]
    assert len(spans) == 5 and max(spans) < 0.11


def test_what_follows_damage_is_missed(tmp_path: Path) -> None:
    path = capture(tmp_path / "drive.pcap", packets(9.0))
    whole = bytearray(path.read_bytes())
    middle = len(whole) // 2
    whole[middle : middle + 4096] = bytes([255]) * 4096
    path.write_bytes(whole)
    sequence = open_sequence(path)
    assert len(sequence) == 5
    assert any("damaged at byte" in note and "0.4 MB" in note for note in sequence.notes)


def test_a_real_capture_of_early_firmware() -> None:
    path = real("formats_found/lidarview_vlp-16-test-90deg-1-50-frames.pcap")
    points = open_sequence(path).scan(5).points.astype(np.float64)
    reach = np.linalg.norm(points, axis=1)
    far = points[reach > 5.0, 2] / reach[reach > 5.0]  # near ones show where lasers are mounted
    off = np.abs(np.degrees(np.arcsin(far))[:, None] - np.array(LASERS_DEG)).min(axis=1)
    assert len(far) > 100
    assert off.max() < 0.3


def test_a_capture_that_was_cut_off_or_is_none(tmp_path: Path) -> None:
    path = capture(tmp_path / "drive.pcap", packets(2.0))
    whole = path.read_bytes()
    for size in (0, 10, 30, 5000):
        path.write_bytes(whole[:size])
        with pytest.raises(DatasetError, match=r"drive\.pcap: (cut off|no Velodyne turn)"):
            open_sequence(path)
    path.write_bytes(b"none" + whole)
    with pytest.raises(DatasetError, match="not a capture in libpcap format"):
        open_sequence(path)
    path.write_bytes(whole[:-700])
    assert [len(open_sequence(path).scan(i)) for i in range(2)] == [28_800, 28_800 - 24 * 16]


@pytest.mark.parametrize("kind", ["ros1", "sqlite3"])
@pytest.mark.parametrize("last", [False, True])
def test_packets_in_a_bag(kind: str, last: bool, tmp_path: Path) -> None:
    """Drivers stamp a scan by its first packet or by its last."""
    pytest.importorskip("rosbags")
    from rosbags.typesys import get_types_from_msg
    from samples.bags import BagWriter

    bag = BagWriter(kind)
    packet, scan = "velodyne_msgs/msg/VelodynePacket", "velodyne_msgs/msg/VelodyneScan"
    time_type = "time" if kind == "ros1" else "builtin_interfaces/Time"
    text = f"{time_type} stamp\nuint8[1206] data\n"
    bag.store.register(get_types_from_msg(text, packet))
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
    assert sequence.frame == "velodyne"
    cloud = sequence.scan(0)
    check(cloud.points, cloud.times + stamp - START)
