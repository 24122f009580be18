"""Ouster packets in bags: one message each, with the sensor's metadata on another topic.

Messages: ``PacketMsg`` of the packages ouster_ros, ouster_sensor_msgs and ouster_msgs, one array
of bytes without a header, so stamps are log times; metadata as ``std_msgs/String``. The bytes are
parsed here, as older bags lack the definitions.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ....errors import DatasetError
from ....types import Scan
from ..gravity import Accelerometer, GravitySource
from ..packets.ouster_packets import FIELDS, FRAME, IMU_BYTES, Sensor, Turns, gather, read_sensor
from ..recorded import Found
from .bag_file import BagFile, connections_of, faults_of
from .bag_place import place_scans

if TYPE_CHECKING:
    from .rosbags_reader import BagReader

KINDS = tuple(
    f"{package}/msg/PacketMsg" for package in ("ouster_sensor_msgs", "ouster_ros", "ouster_msgs")
)
_STRING = "std_msgs/msg/String"


def on(reader: BagReader, topic: str) -> bool:
    """Return whether a topic has Ouster packets."""
    return any(item.topic == topic and item.msgtype in KINDS for item in reader.connections)


def is_imu(item: Any) -> bool:
    """Return whether a connection has Ouster IMU packets."""
    return item.msgtype in KINDS and "imu" in item.topic.rpartition("/")[2]


def find(reader: BagReader, paths: tuple[Path, ...], topic: str, name: str, storage: str) -> Found:
    """List the turns; reads the bag through once.

    Raise DatasetError if there is no metadata or no complete turn.
    """
    sensor = _metadata(reader, topic)
    turns = gather(
        ((sensor.frame_id(packet), time * 1e-9, time, time + 1)
         for time, packet in _packets(reader, topic, sensor)),
        sensor,
    )  # fmt: skip
    if not len(turns):
        raise DatasetError(
            f"{topic}: no Ouster turn: too few packets of {sensor.packet.itemsize} bytes"
        )
    found = Found(
        name=name,
        format=storage,
        source=BagTurns(paths, topic, sensor, turns),
        indices=np.arange(len(turns)),
        stamps=turns.stamps,
        topic=topic,
        frame=FRAME,
        fields=FIELDS,
        notes=turns.notes,
    )
    found = place_scans(found, reader, paths, turns.stamps, turns.firsts)
    if found.gravity is not None:
        return found
    return replace(found, gravity=_gravity(reader, topic, sensor, turns))


def _gravity(reader: BagReader, topic: str, sensor: Sensor, turns: Turns) -> GravitySource | None:
    """Return gravity from the sensor's own IMU packets, if any."""
    beside = topic.rpartition("/")[0]
    imus = [item for item in reader.connections if is_imu(item)]
    wanted = [item for item in imus if item.topic.rpartition("/")[0] == beside]
    stamps, rows = [], []
    for _, time, data in reader.messages(wanted) if wanted else ():
        packet = _array(data, cdr=reader.cdr)[:IMU_BYTES]
        if sensor.legacy_imu and len(packet) == IMU_BYTES:
            stamps.append(time * 1e-9)
            rows.append(sensor.acceleration(packet))
    if not rows:
        return None
    name = f"the sensor's own IMU, {wanted[0].topic}"
    return Accelerometer(name, turns.stamps, np.array(stamps), np.array(rows))


def _metadata(reader: BagReader, topic: str) -> Sensor:
    """Read the sensor from the topic ``metadata`` beside that of the packets."""
    name = f"{topic.rpartition('/')[0]}/metadata"
    wanted = [c for c in reader.connections if c.topic == name and c.msgtype == _STRING]
    for _, _, data in reader.messages(wanted) if wanted else ():
        return read_sensor(_array(data, cdr=reader.cdr).rstrip(b"\0"), name)
    raise DatasetError(f"{topic}: no metadata on {name} ({_STRING}): record it with the packets")


def _packets(
    reader: BagReader, topic: str, sensor: Sensor, first: int | None = None, stop: int | None = None
) -> Iterator[tuple[int, bytes]]:
    """Yield packets of the sensor's size with their log times."""
    for _, time, data in reader.messages(connections_of(reader, topic), first, stop):
        packet = _array(data, cdr=reader.cdr)
        if len(packet) >= sensor.packet.itemsize:  # drivers send the whole buffer
            yield time, packet[: sensor.packet.itemsize]


def _array(data: bytes, *, cdr: bool) -> bytes:
    """Return the only field of a message: an array with its size before it."""
    order = "<" if not cdr or data[1:2] == b"\1" else ">"
    start = 8 if cdr else 4
    if len(data) < start:
        raise DatasetError(f"cut off: a message of {len(data)} bytes")
    (size,) = struct.unpack_from(f"{order}I", data, start - 4)
    if start + size > len(data):
        raise DatasetError(f"cut off: {len(data) - start} of {size} bytes")
    return bytes(data[start : start + size])


class BagTurns:
    """Turns of one topic.

    turns: positions are log times [ns]
    """

    def __init__(self, paths: tuple[Path, ...], topic: str, sensor: Sensor, turns: Turns) -> None:
        self._file, self._topic, self._sensor, self._turns = BagFile(paths), topic, sensor, turns

    def where(self, k: int) -> str:
        return f"{self._file.path}: turn {k} of {self._topic}"

    def read(self, k: int) -> Scan:
        first, stop = int(self._turns.firsts[k]), int(self._turns.stops[k])
        with faults_of(self._file.path):
            found = _packets(self._file.reader(), self._topic, self._sensor, first, stop)
            packets = [packet for _, packet in islice(found, self._sensor.most_packets + 1)]
            return self._sensor.decode(packets, int(self._turns.numbers[k]), self.where(k))
