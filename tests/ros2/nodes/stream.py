"""A simulated robot drives for a while beside the node, each a process of its own, over DDS.

    tests/ros2/run.sh .venv/bin/python tests/ros2/nodes/stream.py --minutes 60 --report FOLDER

The robot drives along a circle of 250 m at 2 m/s, with a LiDAR of 30 000 points a scan at 5 Hz and
odometry at 20 Hz that drifts by half a percent. Every fifth minute the LiDAR floods the node with
40 scans/s; every tenth minute begins with a call of reinitialize_global_localization. Each minute
is noted: latencies from a message to what the node makes of it, the memory of the node and its
share of a core, messages whose stamp is no newer than that of the one before, poses more than 1 m
off. It fails if there are such poses or messages, or if memory grows by 5 % or more after the first
tenth.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseWithCovarianceStamped
from nav_msgs.msg import Odometry
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from samples.plaza import Plaza, RingSequence
from samples.ros_drive import BASE, LIDAR, MOUNT, ODOM
from samples.ros_peer import running
from samples.streams import T_MAP_ODOM
from samples.usage import processor_s, resident_mb
from segloc_lab.report import Cell, Table, entries, keep, publish, resumed
from segloc_msgs.msg import State
from segloc_ros.core.frames import Transform
from segloc_ros.messages import cloud_out, pose_in, seconds, set_pose, time_of, transform_out
from sensor_msgs.msg import PointCloud2
from std_srvs.srv import Empty
from tf2_msgs.msg import TFMessage

from segloc import Config, build_map, geometry
from segloc.types import Float32, Float64

INSTALLED = Path(os.environ.get("SEGLOC_ROS_INSTALL", "build/ros/ws/install")).resolve()
NODE = INSTALLED / "segloc_ros/lib/segloc_ros/segloc_node"
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
SENSOR = QoSProfile(depth=5, reliability=ReliabilityPolicy.BEST_EFFORT)
SPEED_MPS, AROUND_M, RADIUS_M = 2.0, 250.0, 40.0
TICKS_HZ, ODOMETRY_EVERY, CLOUD_EVERY = 40, 2, 8  # ticks
POINTS, OFF_M, MAX_GROWTH, AHEAD_S = 30_000, 1.0, 0.05, 0.2
FLOOD, RELOCALIZE, MINUTE_S = 5, 10, 60.0
TIMED = ("pose", "tf", "state", "diagnostics")

Minute = dict[str, Any]


class Drive:
    """True poses of the base at each tick, odometry, and scans of one lap."""

    def __init__(self) -> None:
        plaza = Plaza(3, objects=110, size=140.0)
        step = SPEED_MPS / TICKS_HZ
        self.mapped = RingSequence(plaza, RADIUS_M, AROUND_M, 2.0)
        lap = RingSequence(plaza, RADIUS_M, AROUND_M, step, aside=0.7)
        self._T_map_lidar, self._lidar_base = lap.poses, geometry.inverse(MOUNT)
        self._increments = [
            geometry.inverse(a @ self._lidar_base) @ b @ self._lidar_base
            for a, b in zip(lap.poses, np.roll(lap.poses, -1, axis=0), strict=True)
        ]
        for T in self._increments:
            T[:2, 3] *= 1.005
        rng, self._scans = np.random.default_rng(0), dict[int, Float32]()
        for i in range(0, len(lap), CLOUD_EVERY):
            points = lap.scan(i).points
            some = rng.choice(len(points), min(POINTS, len(points)), replace=False)
            self._scans[i] = points[some].astype(np.float32)
        self.T_odom_base: Float64 = geometry.inverse(T_MAP_ODOM) @ self.truth(0)

    def truth(self, tick: int) -> Float64:
        """T_map_base at a tick."""
        T: Float64 = self._T_map_lidar[tick % len(self._T_map_lidar)] @ self._lidar_base
        return T

    def advance(self, tick: int) -> None:
        """Move the odometry from a tick to the next."""
        self.T_odom_base = self.T_odom_base @ self._increments[tick % len(self._increments)]

    def scan(self, tick: int) -> Float32:
        """Points at a tick, in the frame of the LiDAR there."""
        i = tick % len(self._T_map_lidar)
        k = i - i % CLOUD_EVERY
        if k == i:
            return self._scans[k]
        T = geometry.inverse(self._T_map_lidar[i]) @ self._T_map_lidar[k]
        return geometry.transform(T, self._scans[k]).astype(np.float32)


class Robot(Node):
    """Publishes what a robot would, and times what the node publishes."""

    def __init__(self, drive: Drive) -> None:
        super().__init__("robot")
        self.drive, self.truths = drive, dict[int, Float64]()
        self.sent_at: dict[int, float] = {}
        self.latency: dict[str, list[float]] = {name: [] for name in TIMED}
        self.newest = dict.fromkeys(TIMED, -1)
        self.counts, self.off, self.values = dict.fromkeys(TIMED, 0), [0.0], dict[str, str]()
        self.stale: list[str] = []
        self.status, self.reason, self.localized = State.LOST, "", 0
        self.points = self.create_publisher(PointCloud2, "points", SENSOR)
        self.odom = self.create_publisher(Odometry, "odom", SENSOR)
        self.static = self.create_publisher(TFMessage, "/tf_static", LATCHED)
        self.forget = self.create_client(Empty, "segloc/reinitialize_global_localization")
        for kind, topic, heard, depth in (
            (PoseWithCovarianceStamped, "segloc/pose", self._on_pose, 100),
            (TFMessage, "/tf", self._on_tf, 200),
            (State, "segloc/state", self._on_state, 100),
            (DiagnosticArray, "/diagnostics", self._on_diagnostics, 100),
        ):
            self.create_subscription(kind, topic, heard, depth)

    def publish(self, tick: int, stamp: float, is_flood: bool) -> bool:
        """Publish what is due at a tick; return whether a cloud was."""
        key, is_cloud = key_of(stamp), is_flood or not tick % CLOUD_EVERY
        self.truths[key], self.sent_at[key] = self.drive.truth(tick), time.monotonic()
        if is_cloud:
            self.points.publish(cloud_out(self.drive.scan(tick), LIDAR, time_of(stamp)))
        if not tick % ODOMETRY_EVERY:
            message = Odometry(child_frame_id=BASE)
            message.header.frame_id, message.header.stamp = ODOM, time_of(stamp)
            set_pose(message.pose.pose, self.drive.T_odom_base)
            self.odom.publish(message)
        self.drive.advance(tick)
        if not tick % TICKS_HZ:
            old = key - 120_000
            for known in (self.truths, self.sent_at):
                for each in [each for each in known if each < old]:
                    del known[each]
        return is_cloud

    def tell_mount(self) -> None:
        mount = transform_out(Transform(0.0, BASE, LIDAR, MOUNT))
        self.static.publish(TFMessage(transforms=[mount]))

    def _note(self, name: str, stamp: float, ahead_s: float = 0.0, is_news: bool = False) -> int:
        """Count a message by its stamp; one that is not newer than the last is stale.

        With ``is_news`` it may have the same stamp.
        """
        key, exact = key_of(stamp - ahead_s), round(1e6 * stamp)
        self.counts[name] += 1
        if exact < self.newest[name] or (exact == self.newest[name] and not is_news):
            self.stale.append(name)
        self.newest[name] = max(exact, self.newest[name])
        if key in self.sent_at:
            self.latency[name].append(1e3 * (time.monotonic() - self.sent_at[key]))
        return key

    def _on_pose(self, message: PoseWithCovarianceStamped) -> None:
        key = self._note("pose", seconds(message.header.stamp))
        if key in self.truths:
            T = geometry.inverse(self.truths[key]) @ pose_in(message.pose.pose)
            self.off.append(float(np.linalg.norm(T[:3, 3])))

    def _on_tf(self, message: TFMessage) -> None:
        for each in message.transforms:
            if each.child_frame_id == ODOM:
                self._note("tf", seconds(each.header.stamp), AHEAD_S)

    def _on_state(self, message: State) -> None:
        is_news = (message.status, message.reason) != (self.status, self.reason)
        self._note("state", seconds(message.header.stamp), is_news=is_news)
        self.status, self.reason = message.status, message.reason

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        self._note("diagnostics", seconds(message.header.stamp))
        self.localized += self.status == State.LOCALIZED
        self.values = {value.key: value.value for value in message.status[0].values}

    def take(self) -> dict[str, Any]:
        """Return and clear what was noted."""
        taken = {
            **self.counts,
            "stale": sorted(self.stale),
            "off": round(max(self.off), 3),
            "false": sum(each > OFF_M for each in self.off),
            "localized": self.localized,
            **{f"{name}_ms": np.round(self.latency[name], 1).tolist() for name in ("pose", "tf")},
            **{key: int(self.values.get(key, 0)) for key in ("scans", "skipped", "fixes")},
        }
        self.stale, self.off, self.localized = [], [0.0], 0
        self.counts = dict.fromkeys(TIMED, 0)
        self.latency = {name: [] for name in TIMED}
        return taken


def key_of(stamp: float) -> int:
    """Milliseconds, which tell messages apart."""
    return round(1e3 * stamp)


def stream(minutes: int, minute_s: float, out: Path, work: Path) -> None:
    """Drive beside the node, and keep a record of each minute."""
    drive = Drive()
    build_map(drive.mapped, Config.preset("geo")).save(work / "ring.segmap")
    rclpy.init()
    robot, executor = Robot(drive), SingleThreadedExecutor()
    executor.add_node(robot)

    def listen(until: float) -> None:
        while (left := until - time.monotonic()) > 0:
            executor.spin_once(left)

    options = {"map": str(work / "ring.segmap"), "mode": "tf", "trigger": "periodic"}
    with running(NODE, work / "log", **options) as node:
        while not (robot.points.get_subscription_count() and robot.static.get_subscription_count()):
            listen(time.monotonic() + 0.2)
        robot.tell_mount()
        while "map" not in robot.values or "missing map" in robot.values:
            listen(time.monotonic() + 0.2)
        tick, begun, origin = 0, time.monotonic(), round(time.time(), 3)
        for minute in range(minutes):
            _drive_minute(robot, node, minute, minute_s, (tick, begun, origin), listen, out)
            tick += round(minute_s * TICKS_HZ)
    rclpy.shutdown()


def _drive_minute(
    robot: Robot,
    node: subprocess.Popen[bytes],
    minute: int,
    minute_s: float,
    start: tuple[int, float, float],
    listen: Any,
    out: Path,
) -> None:
    """Drive for a minute, and keep a record of it."""
    first, begun, origin = start
    is_flood, clouds, late = minute % FLOOD == FLOOD - 1, 0, 0.0
    used = processor_s(node.pid)
    if minute % RELOCALIZE == RELOCALIZE - 1:
        robot.forget.call_async(Empty.Request())
    for tick in range(first, first + round(minute_s * TICKS_HZ)):
        listen(begun + tick / TICKS_HZ)
        late = max(late, time.monotonic() - begun - tick / TICKS_HZ)
        clouds += robot.publish(tick, origin + tick / TICKS_HZ, is_flood)
    assert node.poll() is None, "the node has ended"
    record = {
        "minute": minute + 1,
        "load": f"{TICKS_HZ if is_flood else TICKS_HZ // CLOUD_EVERY} clouds/s",
        "clouds": clouds,
        "late_s": round(late, 2),
        "mb": round(resident_mb(node.pid), 1),
        "share": round((processor_s(node.pid) - used) / minute_s, 3),
        **robot.take(),
    }
    keep(out, record)


LOAD_COLUMNS = (
    "load", "minutes", "clouds", "poses", "stamped twice or late",
    "false poses", "largest error (m)", "cloud to pose, median / 99 % / longest (ms)",
    "odometry to map -> odom, median / 99 % / longest (ms)", "share of a core",
)  # fmt: skip
MEMORY_COLUMNS = ("after minute", "memory (MB)", "queries that moved the pose")


def tables(minutes: list[Minute]) -> list[Table]:
    """Return a table by load, and one of the memory after each tenth."""
    rows: list[tuple[Cell, ...]] = []
    for load in sorted({m["load"] for m in minutes}, key=lambda load: int(load.split()[0])):
        here = [m for m in minutes if m["load"] == load]
        rows.append(
            (
                load,
                len(here),
                sum(m["clouds"] for m in here),
                sum(m["pose"] for m in here),
                sum(len(m["stale"]) for m in here),
                sum(m["false"] for m in here),
                max(m["off"] for m in here),
                _spread([ms for m in here for ms in m["pose_ms"]]),
                _spread([ms for m in here for ms in m["tf_ms"]]),
                f"{np.mean([m['share'] for m in here]):.2f}",
            )
        )
    tenth = max(1, len(minutes) // 10)
    memory = [(m["minute"], m["mb"], m["fixes"]) for m in minutes[tenth - 1 :: tenth]]
    totals = ", ".join(f"{sum(m[name] for m in minutes)} of {name}" for name in TIMED)
    note = (
        f"Messages: {totals}; {minutes[-1]['skipped']} clouds skipped. After the first tenth "
        f"memory grows by {100 * growth(minutes):.1f} % (limit {100 * MAX_GROWTH:g} %)."
    )
    return [
        Table(LOAD_COLUMNS, rows, title="By load"),
        Table(MEMORY_COLUMNS, memory, note, title="Memory"),
    ]


def _spread(values: list[float]) -> str:
    if not values:
        return "-"
    return " / ".join(f"{each:.0f}" for each in np.percentile(values, (50, 99, 100)))


def growth(minutes: list[Minute]) -> float:
    """Return by which share memory grows, at most, after the first tenth."""
    first, *later = (float(m["mb"]) for m in minutes[max(1, len(minutes) // 10) - 1 :])
    return max(later, default=first) / first - 1.0


def parsed() -> argparse.Namespace:
    options = resumed(__doc__, "stream.jsonl")
    options.add_argument("--minutes", type=int, default=60)
    options.add_argument("--minute", type=float, default=MINUTE_S, help="seconds of a minute")
    return options.parse_args()


def main() -> None:
    args = parsed()
    if not args.add:
        with tempfile.TemporaryDirectory() as work:
            stream(args.minutes, args.minute, args.out, Path(work))
    minutes = entries(*(args.add or [args.out]))
    publish(args.report, "The node in a stream, over DDS", *tables(minutes))
    faults = sum(m["false"] + len(m["stale"]) for m in minutes)
    if faults or growth(minutes) >= MAX_GROWTH:
        raise SystemExit(f"{faults} false or repeated; memory grows by {growth(minutes):.1%}")


if __name__ == "__main__":
    main()
