"""Bags of a posed recording, written by the package rosbags."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from scipy.spatial.transform import Rotation

from segloc.types import Float64

KINDS = ("ros1", "sqlite3", "mcap")
PACKING = {"ros1": "LZ4", "sqlite3": "FILE", "mcap": "FILE"}
LASER = "sensor_msgs/msg/LaserScan"
LIVOX_POINT = """
uint32 offset_time
float32 x
float32 y
float32 z
uint8 reflectivity
uint8 tag
uint8 line
"""
LIVOX_MESSAGE = """
std_msgs/Header header
uint64 timebase
uint32 point_num
uint8 lidar_id
uint8[3] rsvd
CustomPoint[] points
"""
CLOUD = "sensor_msgs/msg/PointCloud2"
TF = "tf2_msgs/msg/TFMessage"
ODOMETRY = "nav_msgs/msg/Odometry"
IMU = "sensor_msgs/msg/Imu"
FIX = "sensor_msgs/msg/NavSatFix"


@dataclass
class BagWriter:
    """Collects messages, then writes them in the order of time.

    Attributes
    ----------
    kind : str
        One of ``KINDS``.
    late_s : float
        How much later than its stamp a message is recorded.
    """

    kind: str
    late_s: float = 0.03

    def __post_init__(self) -> None:
        ros1 = self.kind == "ros1"
        self.store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)
        if ros1:  # the store of ROS 1 lacks it
            lines = "geometry_msgs/TransformStamped[] transforms\n"
            self.store.register(get_types_from_msg(lines, TF))
        self.messages: list[tuple[int, str, str, Any]] = []

    def make(self, kind: str, /, **values: Any) -> Any:
        return self.store.types[kind](**values)

    def header(self, stamp: float, frame: str) -> Any:
        seconds, rest = divmod(round(stamp * 1e9), 10**9)
        time = self.make("builtin_interfaces/msg/Time", sec=seconds, nanosec=rest)
        number = {"seq": 0} if self.kind == "ros1" else {}
        return self.make("std_msgs/msg/Header", stamp=time, frame_id=frame, **number)

    def add(self, topic: str, kind: str, stamp: float, message: Any) -> None:
        self.messages.append((round((stamp + self.late_s) * 1e9), topic, kind, message))

    def cloud(
        self,
        topic: str,
        stamp: float,
        points: Float64,
        frame: str = "lidar",
        *,
        times: tuple[str, str, Float64] | None = None,
        big: bool = False,
        height: int = 1,
        padding: int = 0,
    ) -> None:
        """A cloud of x, y, z, intensity and, in a field of this name and dtype, times."""
        order = ">" if big else "<"
        parts: list[tuple[str, str]] = [(axis, f"{order}f4") for axis in "xyz"]
        parts += [("intensity", f"{order}f4")]
        if times is not None:
            parts.append((times[0], order + times[1]))
        rows = np.zeros(len(points), dtype=parts)
        for k, axis in enumerate("xyz"):
            rows[axis] = points[:, k]
        if times is not None:
            rows[times[0]] = times[2]
        codes = {"f4": 7, "f8": 8, "u4": 6, "i4": 5}
        fields = [
            self.make(
                "sensor_msgs/msg/PointField",
                name=name, offset=rows.dtype.fields[name][1], datatype=codes[kind[1:]], count=1,
            )
            for name, kind in parts
        ]  # fmt: skip
        step, width = rows.dtype.itemsize, len(rows) // height
        lines = rows.reshape(height, width).view("u1").reshape(height, width * step)
        data = np.pad(lines, ((0, 0), (0, padding))).reshape(-1)
        message = self.make(
            CLOUD,
            header=self.header(stamp, frame), height=height, width=width, fields=fields,
            is_bigendian=big, point_step=step, row_step=width * step + padding, data=data,
            is_dense=True,
        )  # fmt: skip
        self.add(topic, CLOUD, stamp, message)

    def livox(
        self, topic: str, stamp: float, points: Float64, times: Float64, package: str
    ) -> None:
        """A CustomMsg of ``livox_ros_driver`` or ``livox_ros_driver2``."""
        point, kind = f"{package}/msg/CustomPoint", f"{package}/msg/CustomMsg"
        if kind not in self.store.types:
            self.store.register(get_types_from_msg(LIVOX_POINT, point))
            self.store.register(get_types_from_msg(LIVOX_MESSAGE, kind))
        rows = [
            self.make(
                point, offset_time=round(t * 1e9), x=x, y=y, z=z, reflectivity=9, tag=16, line=k % 6
            )
            for k, ((x, y, z), t) in enumerate(zip(points.tolist(), times.tolist(), strict=True))
        ]
        message = self.make(
            kind,
            header=self.header(stamp, "livox"), timebase=round(stamp * 1e9), point_num=len(rows),
            lidar_id=1, rsvd=np.zeros(3, np.uint8), points=rows,
        )  # fmt: skip
        self.add(topic, kind, stamp, message)

    def laser(
        self, topic: str, stamp: float, ranges: Float64, step_rad: float, step_s: float
    ) -> None:
        """A sweep from -135 degrees on by a scanner that sees from 0.1 to 30 m."""
        message = self.make(
            LASER,
            header=self.header(stamp, "laser"), angle_min=-0.75 * np.pi, angle_max=0.75 * np.pi,
            angle_increment=step_rad, time_increment=step_s, scan_time=0.025, range_min=0.1,
            range_max=30.0, ranges=ranges.astype(np.float32), intensities=np.empty(0, np.float32),
        )  # fmt: skip
        self.add(topic, LASER, stamp, message)

    def _transform(self, T: Float64) -> tuple[dict[str, float], Any]:
        x, y, z, w = Rotation.from_matrix(T[:3, :3]).as_quat()
        quaternion = self.make("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w)
        return dict(zip("xyz", T[:3, 3].tolist(), strict=True)), quaternion

    def odometry(
        self, topic: str, stamp: float, T: Float64, child: str, world: str = "odom"
    ) -> None:
        xyz, quaternion = self._transform(T)
        point = self.make("geometry_msgs/msg/Point", **xyz)
        pose = self.make("geometry_msgs/msg/Pose", position=point, orientation=quaternion)
        zero = self.make("geometry_msgs/msg/Vector3", x=0.0, y=0.0, z=0.0)
        twist = self.make("geometry_msgs/msg/Twist", linear=zero, angular=zero)
        spread = "geometry_msgs/msg/"
        message = self.make(
            ODOMETRY,
            header=self.header(stamp, world), child_frame_id=child,
            pose=self.make(f"{spread}PoseWithCovariance", pose=pose, covariance=np.zeros(36)),
            twist=self.make(f"{spread}TwistWithCovariance", twist=twist, covariance=np.zeros(36)),
        )  # fmt: skip
        self.add(topic, ODOMETRY, stamp, message)

    def imu(
        self,
        topic: str,
        stamp: float,
        acceleration: Float64,
        frame: str = "imu",
        *,
        orientation: Float64 | None = None,
    ) -> None:
        """What an accelerometer measures, and R_world_imu where it is known."""
        known = orientation is not None
        T = np.eye(4)
        if orientation is not None:
            T[:3, :3] = orientation
        vector = "geometry_msgs/msg/Vector3"
        felt = dict(zip("xyz", map(float, acceleration), strict=True))
        spread = np.full(9, 1e-4 if known else 0.0)
        message = self.make(
            IMU,
            header=self.header(stamp, frame), orientation=self._transform(T)[1],
            orientation_covariance=spread,
            angular_velocity=self.make(vector, x=0.0, y=0.0, z=0.0),
            angular_velocity_covariance=np.zeros(9),
            linear_acceleration=self.make(vector, **felt),
            linear_acceleration_covariance=np.zeros(9),
        )  # fmt: skip
        self.add(topic, IMU, stamp, message)

    def fix(
        self,
        topic: str,
        stamp: float,
        place: tuple[float, float, float],
        variance: tuple[float, float] | None,
        status: int = 0,
    ) -> None:
        """A GNSS fix at latitude, longitude and height, with its variance where that is known."""
        east, north = variance or (0.0, 0.0)
        message = self.make(
            FIX,
            header=self.header(stamp, "gnss"),
            status=self.make("sensor_msgs/msg/NavSatStatus", status=status, service=1),
            latitude=place[0], longitude=place[1], altitude=place[2],
            position_covariance=np.array([east, 0, 0, 0, north, 0, 0, 0, 9.0]),
            position_covariance_type=0 if variance is None else 2,
        )  # fmt: skip
        self.add(topic, FIX, stamp, message)

    def tf(self, topic: str, stamp: float, T: Float64, parent: str, child: str) -> None:
        xyz, quaternion = self._transform(T)
        vector = self.make("geometry_msgs/msg/Vector3", **xyz)
        transform = self.make(
            "geometry_msgs/msg/Transform", translation=vector, rotation=quaternion
        )
        entry = self.make(
            "geometry_msgs/msg/TransformStamped",
            header=self.header(stamp, parent), child_frame_id=child, transform=transform,
        )  # fmt: skip
        self.add(topic, TF, stamp, self.make(TF, transforms=[entry]))

    def write(self, path: Path, packing: str = "") -> Path:
        """Write ``path``.bag, or the folder ``path``, packed as rosbags calls it."""
        self.messages.sort(key=lambda item: item[0])
        writer: Any
        if self.kind == "ros1":
            path = path.with_suffix(".bag")
            writer, write = Writer1(path), self.store.serialize_ros1
            if packing:
                writer.set_compression(Writer1.CompressionFormat[packing])
        else:
            plugin = StoragePlugin.SQLITE3 if self.kind == "sqlite3" else StoragePlugin.MCAP
            writer = Writer2(path, version=9, storage_plugin=plugin)
            write = self.store.serialize_cdr
            if packing:
                writer.set_compression(CompressionMode[packing], CompressionFormat.ZSTD)
        topics: dict[str, Any] = {}
        with writer:
            for time, topic, kind, message in self.messages:
                if topic not in topics:
                    topics[topic] = writer.add_connection(topic, kind, typestore=self.store)
                data = message if isinstance(message, bytes) else write(message, kind)
                writer.write(topics[topic], time, data)
        return path
