"""What a robot's topics say while it walks across a plaza, and the core that listens."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

import numpy as np
from segloc_ros.core import Reply, Robot, Settings
from segloc_ros.core.frames import Transform
from segloc_ros.core.replies import PoseReply

from segloc import Localizer, geometry
from segloc.types import Float64, Pose

from .plaza import Plaza
from .streams import Event, off_m, walked

MOUNT = geometry.yaw_transform(0.7, (1.5, 0.2, 0.3))
BASE, LIDAR, ODOM = "base_link", "os_sensor", "odom"


_CODES = {"u4": 6, "f4": 7, "f8": 8}


def cloud_of(points: Float64, *more: tuple[str, str, Float64]) -> Any:
    """sensor_msgs/PointCloud2 of (N, 3) points, and more fields: name, type and values."""
    columns = [*zip("xyz", ["f4"] * 3, np.asarray(points).T, strict=True), *more]
    rows = np.zeros(len(points), [(name, "<" + kind) for name, kind, _ in columns])
    for name, _, values in columns:
        rows[name] = values
    fields = [
        SimpleNamespace(name=name, offset=rows.dtype.fields[name][1], datatype=_CODES[k], count=1)
        for name, k, _ in columns
    ]
    step = rows.dtype.itemsize
    return SimpleNamespace(
        height=1, width=len(rows), fields=fields, is_bigendian=False, point_step=step,
        row_step=step * len(rows), data=np.frombuffer(rows.tobytes(), np.uint8),
    )  # fmt: skip


def livox_of(points: Float64, stamp: float, frame: str = LIDAR) -> bytes:
    """A livox_ros_driver2/CustomMsg of (N, 3) points in CDR, measured within 0.1 s."""
    body = struct.pack("<iII", math.floor(stamp), int(1e9 * (stamp % 1.0)), len(frame) + 1)
    body += frame.encode() + b"\0"
    body += b"\0" * (-len(body) % 8)
    body += struct.pack("<QIB3xI", max(0, int(1e9 * stamp)), len(points), 1, len(points))
    kind = [("offset_time", "<u4"), ("xyz", "<f4", 3), ("rest", "V4")]
    rows = np.zeros(len(points), kind)
    rows["xyz"], rows["offset_time"] = points, np.linspace(0, 1e8, len(points))
    return b"\0\1\0\0" + body + rows.tobytes()[:-1]


def on_tf_static(robot: Robot, T: Pose = MOUNT, child: str = LIDAR) -> list[Reply]:
    return robot.on_transforms([Transform(0.0, "/base_link", child, T)], True)


@dataclass
class Listener:
    """Feeds a core, makes its queries at once, and keeps all that it says."""

    robot: Robot
    said: list[Reply] = field(default_factory=list)

    @classmethod
    def of(cls, localizer: Localizer | None = None, **parameters: Any) -> Listener:
        values = {"trigger": "periodic", "mode": "both", "query_every_m": 4.0, **parameters}
        robot = Robot(Settings.of(values))
        if localizer is not None:
            robot.use(localizer)
        return cls(robot)

    @classmethod
    def mounted(cls, localizer: Localizer | None = None, **parameters: Any) -> Listener:
        """One that knows where its LiDAR is."""
        listener = cls.of(localizer, **parameters)
        on_tf_static(listener.robot)
        return listener

    def odometry(self, stamp: float, T_odom_base: Pose, frame: str = ODOM) -> None:
        self.hear(self.robot.on_odometry(stamp, frame, BASE, T_odom_base))

    def transforms(self, transforms: list[Transform]) -> None:
        self.hear(self.robot.on_transforms(transforms, False))

    def cloud(
        self, stamp: float, points: Float64, frame: str = LIDAR, topic: str = "points"
    ) -> None:
        self.hear(self.robot.on_cloud(cloud_of(points), stamp, frame, topic))

    def walk(
        self,
        plaza: Plaza,
        count: int,
        *,
        odometry: Callable[[float, Pose], object] | None = None,
        cloud: Callable[[Event, Pose], object] | None = None,
        **options: Any,
    ) -> Pose:
        """Walk as :func:`samples.streams.walked`; the true pose of the base at the end.

        ``odometry`` takes a stamp and T_odom_base, ``cloud`` a scan and T_map_lidar: by default
        they are told as they are.
        """
        lidar_base, truth = geometry.inverse(MOUNT), np.eye(4)
        for events, T_map_lidar in walked(plaza, count, **options):
            truth = T_map_lidar @ lidar_base
            for event in events:
                if event.scan is None:
                    (odometry or self.odometry)(event.stamp, event.T_odom_base @ lidar_base)
                elif cloud is not None:
                    cloud(event, T_map_lidar)
                else:
                    self.cloud(event.stamp, event.scan.points)
        return truth

    def off(self, truth: Pose) -> float:
        """How far the newest pose of the base is off [m]."""
        return off_m(self.of_kind(PoseReply)[-1].T_map_base, truth)

    def of_kind(self, kind: type[Any]) -> list[Any]:
        return [reply for reply in self.said if isinstance(reply, kind)]

    def clear(self) -> None:
        self.said.clear()

    def hear(self, replies: list[Reply]) -> None:
        """Keep replies, and make the queries that are due."""
        self.said += replies
        while (request := self.robot.due()) is not None:
            self.said += self.robot.answer(request, self.robot.ask(request))
