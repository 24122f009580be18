"""The messages of a bag that are scans: which types, and from one of them to a scan."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from ...types import Scan
from ..packets.velodyne import decode
from . import bag_ouster, laserscan, livox, pointcloud2
from .bag_headers import seconds

if TYPE_CHECKING:
    from rosbags.highlevel import AnyReader

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

    Raises
    ------
    DatasetError
        If what is in it makes no scan; other errors come from bytes that are no such message.
    """
    if kind in _LIVOX:
        return livox.to_scan(data, cdr=reader.is2)
    message: Any = reader.deserialize(data, kind)
    if kind == _PACKETS:
        return _unpacked(message, stamp, where)
    return laserscan.to_scan(message) if kind == _SWEEP else pointcloud2.to_scan(message, 0.0)


def defines_times(reader: AnyReader, topic: str, fields: str) -> bool:
    """Whether the type of a topic's messages defines the unit of points' times, if they have any.

    Parameters
    ----------
    reader : AnyReader
    topic : str
    fields : str
        As :func:`fields_of` lists them.
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
