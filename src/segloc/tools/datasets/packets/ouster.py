"""Captures of Ouster packets (``.pcap``) with the sensor's metadata (``.json``) beside them."""

from __future__ import annotations

import glob
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

import numpy as np

from ....errors import DatasetError
from ....types import Scan
from ...io.fields import faults_of
from ...io.scans import read_file
from ..gravity import Accelerometer, GravitySource
from ..layout import choose
from ..recorded import Found
from .captures import datagrams, map_file
from .ouster_packets import FIELDS, FRAME, Sensor, Turns, gather, read_sensor

NAME = "Ouster packets"
INNER: tuple[str, ...] = ()


def recognises(path: Path) -> bool:
    """Return whether the path is a capture with Ouster metadata beside it."""
    return path.suffix == ".pcap" and path.is_file() and bool(_metadata(path))


def _metadata(path: Path) -> dict[str, Path]:
    """Return metadata files by sensor name: CAPTURE.json, or CAPTURE*.json of several."""
    own = path.with_suffix(".json")
    several = sorted(path.parent.glob(f"{glob.escape(path.stem)}*.json"))
    others = [file for file in several if not file.with_suffix(".pcap").exists()]
    found = [own] if own.is_file() else others
    return {file.stem: file for file in found if b"beam_altitude_angles" in read_file(file)}


def find(path: Path, topic: str | None) -> Found:
    present = _metadata(path)
    name = choose(path, list(present), topic)
    sensor = read_sensor(read_file(present[name]), str(present[name]))
    count = 0
    with map_file(path) as data:
        packets, accelerations, notes, senders = [], [], list[str](), dict[str, None]()
        for datagram in datagrams(data, notes=notes):
            count += 1
            if sensor.is_imu(datagram.size, datagram.port):
                row = (datagram.stamp, *sensor.acceleration(datagram.content(data)))
                accelerations.append(row)
            if sensor.is_lidar(datagram.size, datagram.port):
                number = sensor.frame_id(datagram.content(data))
                packets.append((number, datagram.stamp, datagram.first, datagram.stop))
                senders[datagram.sender] = None
        turns = gather(packets, sensor)
    if len(senders) > 1:
        raise DatasetError(
            f"{path}: packets of several sensors, {', '.join(senders)}: keep those of one, as by "
            "`tcpdump -r CAPTURE -w ONE src host ADDRESS`"
        )
    if not len(turns):
        to = f" to port {sensor.port}" if sensor.port else ""
        raise DatasetError(
            f"{path}: no turn of an Ouster: {len(packets)} of {count} datagrams have "
            f"{sensor.packet.itemsize} bytes{to}, as set in {present[name].name}"
        )
    return Found(
        name=path.stem,
        format=NAME,
        source=TurnSource(path, sensor, turns),
        indices=np.arange(len(turns)),
        stamps=turns.stamps,
        topic=name if len(present) > 1 else None,
        frame=FRAME,
        fields=FIELDS,
        notes=(*turns.notes, *notes),
        gravity=_gravity(accelerations, turns),
    )


def _gravity(accelerations: list[tuple[float, ...]], turns: Turns) -> GravitySource | None:
    if not accelerations:
        return None
    rows = np.array(accelerations)
    return Accelerometer("the sensor's own IMU", turns.stamps, rows[:, 0], rows[:, 1:])


@dataclass(frozen=True)
class TurnSource:
    """The turns of a capture."""

    path: Path
    sensor: Sensor
    turns: Turns  # offsets in the file

    def where(self, k: int) -> str:
        return f"{self.path}: turn {k}"

    def read(self, k: int) -> Scan:
        with faults_of(self.path):
            first, stop = int(self.turns.firsts[k]), int(self.turns.stops[k])
            with map_file(self.path) as data:
                found = (
                    datagram.content(data)
                    for datagram in datagrams(data, first, stop)
                    if self.sensor.is_lidar(datagram.size, datagram.port)
                )
                packets = list(islice(found, self.sensor.most_packets + 1))
            return self.sensor.decode(packets, int(self.turns.numbers[k]), self.where(k))
