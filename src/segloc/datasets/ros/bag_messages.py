"""The messages of a bag that are scans: which types, and from one of them to a scan."""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from ...errors import DatasetError
from ...system.budget import check_points
from ...types import Scan
from ..packets.velodyne import decode
from . import bag_ouster, pointcloud2
from .bag_file import seconds

if TYPE_CHECKING:
    from rosbags.highlevel import AnyReader


class Sweep(Protocol):
    """sensor_msgs/LaserScan."""

    angle_min: float
    angle_increment: float
    time_increment: float
    range_min: float
    range_max: float
    ranges: NDArray[np.float32]


def sweep_scan(sweep: Sweep) -> Scan:
    """The points of a sweep, and their times after its stamp where it has them.

    Ranges outside the sensor's limits are no returns, as the message's definition has it.

    Raise DatasetError if its angles are not finite.
    """
    ranges = np.asarray(sweep.ranges, dtype=np.float64)
    steps = np.arange(len(ranges))
    angles = sweep.angle_min + steps * sweep.angle_increment
    if not np.isfinite(angles).all():
        raise DatasetError("the sweep's angles are not finite")
    with np.errstate(invalid="ignore"):
        hit = (ranges >= sweep.range_min) & (ranges <= sweep.range_max) & (ranges > 0)
    reach, angles = ranges[hit], angles[hit]
    points = np.column_stack([reach * np.cos(angles), reach * np.sin(angles), 0.0 * reach])
    step_s = float(sweep.time_increment)
    timed = np.isfinite(step_s) and step_s != 0
    return Scan(points, times=steps[hit] * step_s if timed else None)


_POINT = 19  # bytes


def livox_scan(data: bytes, *, cdr: bool) -> Scan:
    """The points of a message and their times after its stamp; firings without return left out.

    data: the message as a bag holds it
    cdr: whether that is ROS 2's CDR, behind four bytes that name the byte order; else ROS 1's

    Raise DatasetError if the message has fewer bytes than its sizes promise.
    """
    order = "<" if not cdr or data[1:2] == b"\1" else ">"
    body, header, step = (data[4:], 8, _POINT + 1) if cdr else (data, 12, _POINT)
    try:
        (length,) = struct.unpack_from(f"{order}I", body, header)
        place = header + 4 + length
        if cdr:
            place += -place % 8  # timebase is aligned
        (count,) = struct.unpack_from(f"{order}I", body, place + 16)
    except struct.error as error:
        raise DatasetError(f"cut off: {len(data)} bytes are no message of Livox") from error
    check_points(count)
    first = place + 20
    rows = body[first:] + b"\0" * (step - _POINT)  # the last point is not padded
    if count * step > len(rows):
        raise DatasetError(f"cut off: {count} points in {max(0, len(body) - first)} bytes")
    kinds = [f"{order}{kind}" for kind in ("u4", "f4", "f4", "f4")]
    point = np.dtype(
        {
            "names": ["offset_time", "x", "y", "z"],
            "formats": kinds,
            "offsets": [0, 4, 8, 12],
            "itemsize": step,
        }
    )
    points = np.frombuffer(rows, point, count)
    xyz = np.column_stack([points[axis].astype(np.float32) for axis in "xyz"])
    hit = (xyz != 0).any(axis=1)
    return Scan(xyz[hit], times=points["offset_time"][hit] * 1e-9)


_CLOUD = "sensor_msgs/msg/PointCloud2"
_LIVOX = ("livox_ros_driver2/msg/CustomMsg", "livox_ros_driver/msg/CustomMsg")
_PACKETS = "velodyne_msgs/msg/VelodyneScan"
_SWEEP = "sensor_msgs/msg/LaserScan"
KINDS: tuple[tuple[str, ...], ...] = (
    (_CLOUD,), _LIVOX, (_PACKETS,), bag_ouster.KINDS, (_SWEEP,),
)  # fmt: skip
"""Types of messages; those of an earlier group are taken where nothing is chosen."""
_FIELDS = {
    _PACKETS: "x y z intensity ring time",
    _SWEEP: "x y intensity time",
    **dict.fromkeys(_LIVOX, "x y z reflectivity tag line offset_time"),
}


def scan_of(reader: AnyReader, data: bytes, kind: str, stamp: float, where: str) -> Scan:
    """A message as a scan, its times in seconds after ``stamp``; a PointCloud2's as they are.

    Raise DatasetError if what is in it makes no scan; other errors come from bytes that are no such
    message.
    """
    if kind in _LIVOX:
        return livox_scan(data, cdr=reader.is2)
    message: Any = reader.deserialize(data, kind)
    if kind == _PACKETS:
        return _unpacked(message, stamp, where)
    return sweep_scan(message) if kind == _SWEEP else pointcloud2.to_scan(message, 0.0)


def defines_times(reader: AnyReader, topic: str, fields: str) -> bool:
    """Whether the type of a topic's messages defines the unit of points' times, if they have any.

    fields: as :func:`fields_of` lists them
    """
    kinds = {item.msgtype for item in reader.connections if item.topic == topic}
    return _CLOUD not in kinds or not set(pointcloud2.TIMES) & set(fields.split())


def fields_of(reader: AnyReader, data: bytes, kind: str) -> str:
    """What a message has of each point."""
    if kind in _FIELDS:
        return _FIELDS[kind]
    message: Any = reader.deserialize(data, kind)
    return " ".join(field.name for field in message.fields)


def _unpacked(message: Any, stamp: float, where: str) -> Scan:
    """The points of a velodyne_msgs/VelodyneScan, whose stamp is its first packet's or its last."""
    packets = [(seconds(packet.stamp), bytes(packet.data)) for packet in message.packets]
    scan = decode(packets, where)
    if scan.times is not None and packets:
        scan.times = scan.times + (packets[0][0] - stamp)
    return scan
