"""Messages of bags and packets of sensors, without the bag around them."""

from __future__ import annotations

import json

from common import Bench, fuzz, instrumented

with instrumented:
    from segloc.tools.datasets.packets import ouster_packets, velodyne
    from segloc.tools.datasets.ros import bag_messages, bag_ouster, bags, pointcloud2
import struct

import numpy as np
from samples.bags import CLOUD, LASER, BagWriter
from samples.ouster import Ouster
from samples.velodyne import packets as velodyne_packets

from segloc.errors import DatasetError

bench = Bench("message")
WRITERS = {"ros1": BagWriter("ros1"), "sqlite3": BagWriter("sqlite3")}
SENSOR = ouster_packets.read_sensor(json.dumps(Ouster().metadata("new")), "sensor")
SIZE = SENSOR.packet.itemsize


def message(data: bytes, kind: str, ros1: bool) -> object:
    """As rosbags reads it; what it does not read is an error of the bag."""
    store = WRITERS["ros1" if ros1 else "sqlite3"].store
    try:
        return store.deserialize_ros1(data, kind) if ros1 else store.deserialize_cdr(data, kind)
    except Exception as error:
        raise DatasetError("no message") from error


def headers(data: bytes, parse: object) -> None:
    try:
        parse(data)  # type: ignore[operator]
    except (struct.error, IndexError) as error:  # as read_headers turns them
        raise DatasetError("no header") from error


READERS = (
    lambda data: pointcloud2.scan_of_pointcloud2(message(data, CLOUD, True)),
    lambda data: pointcloud2.scan_of_pointcloud2(message(data, CLOUD, False)),
    lambda data: bag_messages.sweep_scan(message(data, LASER, False)),
    lambda data: bag_messages.livox_scan(data, cdr=True),
    lambda data: bag_messages.livox_scan(data, cdr=False),
    lambda data: ouster_packets.read_sensor(data, "sensor"),
    lambda data: SENSOR.decode([data.ljust(SIZE, b"\0")[:SIZE]],
                               SENSOR.frame_id(data.ljust(32, b"\0")), "turn"),
    lambda data: velodyne.decode([(1.0 + k, data[k : k + 1206].ljust(1206, b"\0"))
                                  for k in range(0, len(data), 1206)], "turn"),
    lambda data: bag_ouster._array(data, cdr=True),
    lambda data: headers(data, bags._parse_cdr),
    lambda data: headers(data, bags._parse_ros1),
)  # fmt: skip


def read(data: bytes) -> None:
    which = data[0] % len(READERS) if data else 0
    path = bench.file(f"last.{which}", data[1:])
    bench.run(path, lambda: READERS[which](data[1:]))


def seeds() -> list[bytes]:
    found = []
    rng = np.random.default_rng(0)
    points = rng.normal(size=(4, 3))
    for kind, writer in WRITERS.items():
        writer.cloud("/p", 1.6e9, points, times=("t", "u4", np.arange(4.0)))
        writer.laser("/l", 1.6e9, np.ones(5), 0.1, 0.01)
        writer.livox("/x", 1.6e9, points, np.arange(4.0), "livox_ros_driver")
        write = writer.store.serialize_ros1 if kind == "ros1" else writer.store.serialize_cdr
        for _, _, name, value in writer.messages:
            data = bytes(write(value, name))
            found += [bytes([which]) + data for which in (0, 1, 2, 3, 4, 8, 9, 10)]
    sensor = Ouster()
    found += [b"\5" + json.dumps(sensor.metadata(layout)).encode() for layout in ("new", "old")]
    found += [b"\6" + data for _, data in sensor.packets(1)[:2]]
    found += [b"\7" + data for _, data in velodyne_packets(1.0)[:2]]
    return found


if __name__ == "__main__":
    fuzz(read, seeds(), ("beam_altitude_angles", "lidar_mode", "1024x10", "NaN"))
