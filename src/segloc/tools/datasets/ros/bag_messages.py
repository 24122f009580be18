"""Convert messages of bags to scans."""

from __future__ import annotations

import re
import struct
from typing import TYPE_CHECKING, Any

import numpy as np

from ....errors import DatasetError
from ....system.budget import check_points
from ....types import Scan
from ..layout import drop_missing_returns
from ..packets.velodyne import decode
from . import bag_ouster, pointcloud2
from .bag_file import seconds

if TYPE_CHECKING:
    from .rosbags_reader import BagReader


def sweep_scan(sweep: Any) -> Scan:
    """Convert a sensor_msgs/LaserScan to points, with times after its stamp if it has them.

    Ranges outside the sensor's limits are no returns, by the message's definition.

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
    """Parse a Livox CustomMsg into points, with times after its stamp; drops missing returns.

    data: serialised message
    cdr: True for ROS 2's CDR, after four bytes that name the byte order; False for ROS 1

    Raise DatasetError if the message is shorter than its declared size.
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
        raise DatasetError(f"cut off: {len(data)} bytes are not a Livox message") from error
    check_points(count)
    first = place + 20
    rows = body[first:] + b"\0" * (step - _POINT)  # the last point is not padded
    if count * step > len(rows):
        raise DatasetError(f"cut off: {count} points in {max(0, len(body) - first)} bytes")
    point = np.dtype(
        [("offset_time", f"{order}u4"), ("xyz", f"{order}f4", 3), ("rest", f"V{step - 16}")]
    )
    points = np.frombuffer(rows, point, count)
    return drop_missing_returns(points["xyz"].astype(np.float32), points["offset_time"] * 1e-9)


_CLOUD = "sensor_msgs/msg/PointCloud2"
_LIVOX = tuple(
    f"{package}/msg/CustomMsg"
    for package in ("livox_ros_driver2", "livox_ros_driver", "livox_interfaces")
)
_PACKETS = "velodyne_msgs/msg/VelodyneScan"
_SWEEP = "sensor_msgs/msg/LaserScan"
KINDS: tuple[tuple[str, ...], ...] = (
    (_CLOUD,), _LIVOX, (_PACKETS,), bag_ouster.KINDS, (_SWEEP,),
)  # fmt: skip
"""Message types; earlier groups take precedence if no topic is chosen."""
_REPUBLISH = "republish it as sensor_msgs/msg/PointCloud2 and record that"
_DRIVER = "play the bag to the sensor's driver and record its sensor_msgs/msg/PointCloud2"
_UNPACK = (
    "play the bag to `ros2 run point_cloud_transport republish --ros-args -p in_transport:=draco "
    "-p out_transport:=raw -r in/draco:=TOPIC -r out:=/points` and record /points"
)
_UNREAD: tuple[tuple[re.Pattern[str], str], ...] = (
    (re.compile(r"(?i)compressedpointcloud2$|draco"), _UNPACK),
    (re.compile(r"(?i)pointcloud2?$|laserscan$"), _REPUBLISH),
    (
        re.compile(
            "(?i)(nebula|pandar|hesai|rslidar|robosense|velodyne|seyond|innovusion|lslidar|livox)"
            ".*(packet|scan|frame)[^/]*$"
        ),
        _DRIVER,
    ),
)
"""Types of clouds that are not read, and what to do instead."""


def instead_of(msgtype: str) -> str:
    """Return what to do with clouds of a type that cannot be read; "" for other types."""
    return next((remedy for pattern, remedy in _UNREAD if pattern.search(msgtype)), "")


_FIELDS = {
    _PACKETS: "x y z intensity ring time",
    _SWEEP: "x y intensity time",
    **dict.fromkeys(_LIVOX, "x y z reflectivity tag line offset_time"),
}


def scan_of(reader: BagReader, data: bytes, kind: str, stamp: float, where: str) -> Scan:
    """Convert a message to a scan, times in seconds after ``stamp``; a PointCloud2's as stored.

    Raise DatasetError for invalid content; bytes of another type may raise other errors.
    """
    if kind in _LIVOX:
        return livox_scan(data, cdr=reader.cdr)
    message: Any = reader.deserialize(data, kind)
    if kind == _PACKETS:
        return _decode_velodyne(message, stamp, where)
    return sweep_scan(message) if kind == _SWEEP else pointcloud2.scan_of_pointcloud2(message)


def defines_times(reader: BagReader, topic: str) -> bool:
    """Return whether a topic's message type defines the unit of its point times."""
    return all(item.msgtype != _CLOUD for item in reader.connections if item.topic == topic)


def fields_of(reader: BagReader, data: bytes, kind: str) -> str:
    """Return the fields of a message's points."""
    if kind in _FIELDS:
        return _FIELDS[kind]
    message: Any = reader.deserialize(data, kind)
    return " ".join(field.name for field in message.fields)


def _decode_velodyne(message: Any, stamp: float, where: str) -> Scan:
    """Decode a velodyne_msgs/VelodyneScan; its stamp is its first packet's or its last."""
    packets = [(seconds(packet.stamp), bytes(packet.data)) for packet in message.packets]
    scan = decode(packets, where)
    if scan.times is not None and packets:
        scan.times = scan.times + (packets[0][0] - stamp)
    return scan
