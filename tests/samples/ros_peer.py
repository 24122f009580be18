"""The rest of a robot, in a process of its own: sensors, odometry, tf, and whoever listens."""

from __future__ import annotations

import os
import signal
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseArray, PoseWithCovarianceStamped
from nav_msgs.msg import Odometry
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from segloc_ros.core.frames import Transform, position_and_quaternion
from segloc_ros.messages import (
    cloud_out,
    pose_in,
    seconds,
    set_pose,
    time_of,
    transform_in,
    transform_out,
)
from sensor_msgs.msg import NavSatFix, PointCloud2
from std_srvs.srv import Trigger
from tf2_msgs.msg import TFMessage
from visualization_msgs.msg import MarkerArray

from segloc import geometry
from segloc.types import Float32, Pose, Recording

from .plaza import Plaza
from .ros_drive import BASE, LIDAR, MOUNT, ODOM
from .streams import walked

REAR = geometry.yaw_transform(-2.0, (-1.0, -0.3, 0.1))
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
_HEARD = {
    "pose": (PoseWithCovarianceStamped, "/segloc/pose", 10),
    "initialpose": (PoseWithCovarianceStamped, "/initialpose", 10),
    "map_cloud": (PointCloud2, "/segloc/map_cloud", LATCHED),
    "matches": (MarkerArray, "/segloc/matches", 10),
    "diagnostics": (DiagnosticArray, "/diagnostics", 10),
    "tf": (TFMessage, "/tf", 100),
    "candidates": (PoseArray, "/segloc/candidates", 10),
    "odom": (Odometry, "/odom", 100),
}


class Peer(Node):
    """Publishes what a robot would, and keeps what the node says.

    Attributes
    ----------
    heard : dict of str to list
        Messages by what they are.
    now : float
        The stamp up to which it has driven.
    """

    def __init__(self, plaza: Plaza) -> None:
        super().__init__("peer")
        self.plaza, self.now = plaza, 1000.0
        self.heard: dict[str, list[Any]] = {name: [] for name in _HEARD}
        self._ears: dict[str, Any] = {}
        for name in _HEARD:
            self.listen(name)
        self._points = self.create_publisher(PointCloud2, "/points", 5)
        self._rear = self.create_publisher(PointCloud2, "/rear", 5)
        self.fix = self.create_publisher(NavSatFix, "/fix", 5)
        self._odom = self.create_publisher(Odometry, "/odom", 50)
        self._tf_static = self.create_publisher(TFMessage, "/tf_static", LATCHED)
        self.click = self.create_publisher(PoseWithCovarianceStamped, "/segloc/click", 1)
        self._relocalize = self.create_client(Trigger, "/segloc/relocalize")

    def listen(self, name: str) -> None:
        kind, topic, qos = _HEARD[name]
        heard = self.heard[name]
        self._ears[name] = self.create_subscription(kind, topic, heard.append, qos)

    def turn_away(self, name: str) -> None:
        self.destroy_subscription(self._ears.pop(name))

    def spin(self, seconds: float) -> None:
        """Listen for a while."""
        self.until(lambda: False, seconds, True)

    def until(self, true: Callable[[], Any], seconds: float, quiet: bool = False) -> None:
        """Listen until something holds; fail where it does not in time."""
        end = time.monotonic() + seconds
        while not true():
            if time.monotonic() > end:
                assert quiet, f"not within {seconds} s; the node says: {self.said}"
                return
            rclpy.spin_once(self, timeout_sec=0.02)

    def clear(self) -> None:
        for messages in self.heard.values():
            messages.clear()

    @property
    def said(self) -> str:
        """The newest line of the diagnostics."""
        newest = self.heard["diagnostics"][-1:]
        return newest[0].status[0].message if newest else ""

    @property
    def values(self) -> dict[str, str]:
        """Its figures."""
        newest = self.heard["diagnostics"][-1:]
        return {v.key: v.value for v in newest[0].status[0].values} if newest else {}

    def tell_mount(self) -> None:
        mounts = {LIDAR: MOUNT, "rear_lidar": REAR}
        told = [transform_out(Transform(0.0, BASE, name, T)) for name, T in mounts.items()]
        self._tf_static.publish(TFMessage(transforms=told))

    def ready(self, odometry: bool = True) -> None:
        """Wait until the node's ends of the topics are there."""
        ends = [self._points, self._tf_static]
        if odometry:
            self.until(lambda: self._odom.get_subscription_count() > 1, 60.0)  # ours, too
        self.until(lambda: all(end.get_subscription_count() for end in ends), 60.0)

    def send_cloud(self, stamp: float, points: Float32) -> None:
        self._points.publish(cloud_out(points, LIDAR, time_of(stamp)))

    def send_odometry(self, stamp: float, T: Pose) -> None:
        message = Odometry(child_frame_id=BASE)
        message.header.frame_id, message.header.stamp = ODOM, time_of(stamp)
        xyz, xyzw = position_and_quaternion(T)
        p, q = message.pose.pose.position, message.pose.pose.orientation
        p.x, p.y, p.z = xyz
        q.x, q.y, q.z, q.w = xyzw
        self._odom.publish(message)

    def walk(
        self, count: int, *, odometry: bool = True, rear: bool = False, **options: Any
    ) -> Pose:
        """Walk on in time, as :func:`samples.streams.walked`; the true pose of the base.

        With ``rear`` the cloud is that of two LiDARs, half of it each.
        """
        lidar_base, truth = geometry.inverse(MOUNT), np.eye(4)
        self.now += 1.0
        for events, T_map_lidar in walked(self.plaza, count, start_s=self.now, **options):
            truth = T_map_lidar @ lidar_base
            for event in events:
                if event.scan is None:
                    if odometry:
                        # Twice: the node takes odometry by best effort, and a cloud waits for it.
                        for late_s in (0.0, 0.01):
                            stamp = event.stamp + late_s
                            self.send_odometry(stamp, event.T_odom_base @ lidar_base)
                            self.spin(0.05)
                else:
                    points = event.scan.points
                    if rear:
                        behind = geometry.transform(geometry.inverse(REAR) @ MOUNT, points[1::2])
                        message = cloud_out(behind, "rear_lidar", time_of(event.stamp))
                        self._rear.publish(message)
                        points = points[::2]
                    self.send_cloud(event.stamp, points)
                    self.spin(0.05)
            self.now = events[1].stamp
            self.spin(0.25)
        return truth

    def drive(self, recording: Recording, every_s: float = 0.1) -> dict[float, Pose]:
        """Drive a recording as fast as the node computes odometry; true poses of the base by stamp.

        Nothing but clouds is sent. The next one waits for the odometry of the last.
        """
        assert recording.poses is not None
        truths, lidar_base = {}, geometry.inverse(MOUNT)
        self.now += 1.0
        for i, T in enumerate(recording.poses):
            self.now = round(self.now + every_s, 6)
            truths[self.now] = T @ lidar_base
            self.send_cloud(self.now, recording.scan(i).points)
            self.until(
                lambda: self.heard["odom"] and self.newest("odom")[0] >= self.now - 1e-6, 60.0
            )
        return truths

    def newest(self, name: str) -> tuple[float, Pose]:
        """Stamp and pose of the newest message of that name."""
        message = self.heard[name][-1]
        return seconds(message.header.stamp), pose_in(message.pose.pose)

    def map_to_odom(self) -> Pose:
        """The newest on tf."""
        sent = [t for m in self.heard["tf"] for t in m.transforms if t.child_frame_id == ODOM]
        assert sent and sent[-1].header.frame_id == "map"
        return transform_in(sent[-1]).T_parent_child

    def ask(self, client: Any, request: Any, again_s: float = 60.0) -> Any:
        """A service's response.

        It is asked again after ``again_s``: ROS 2 drops the response to a client that the service
        has not discovered yet, though the client sees the service.
        """
        calls = [client.call_async(request)]
        asked = time.monotonic()

        def answered() -> bool:
            nonlocal asked
            if asked + again_s < time.monotonic():
                asked = time.monotonic()
                calls.append(client.call_async(request))
            return any(call.done() for call in calls)

        self.until(answered, 60.0)
        return next(call.result() for call in calls if call.done())

    def load_map(self, path: Path, T_new_old: Pose | None = None) -> Any:
        """Call the service; its response. With a pose, search near the last one first."""
        from segloc_msgs.srv import LoadMap

        client = self.create_client(LoadMap, "/segloc/load_map")
        self.until(client.service_is_ready, 60.0)
        request = LoadMap.Request(map_url=str(path), near=T_new_old is not None)
        if T_new_old is not None:
            set_pose(request.old_in_new, T_new_old)
        return self.ask(client, request, again_s=10.0)

    def relocalize(self) -> Any:
        """Call the service; a future."""
        return self._relocalize.call_async(Trigger.Request())


@contextmanager
def running(
    executable: Path, log: Path, *arguments: str, **parameters: Any
) -> Iterator[subprocess.Popen[bytes]]:
    """A node in a process of its own; terminated at the end, unless it has ended before."""
    settings = [item for key, value in parameters.items() for item in ("-p", f"{key}:={value}")]
    command = [executable, "--ros-args", *settings, *arguments]
    with log.open("ab") as out:
        process = subprocess.Popen(command, stdout=out, stderr=out, env=os.environ.copy())
    try:
        yield process
        if process.poll() is None:
            process.send_signal(signal.SIGTERM)
            assert process.wait(60) == 0 and "Traceback" not in log.read_text(), log.read_text()
    finally:
        process.kill()
        process.wait(60)
