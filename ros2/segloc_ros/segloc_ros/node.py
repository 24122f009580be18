"""The node: topics and services of ROS around the core."""

from __future__ import annotations

import importlib
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import rclpy
from geometry_msgs.msg import PoseWithCovarianceStamped
from nav_msgs.msg import Odometry
from rcl_interfaces.msg import ParameterDescriptor
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.clock import Clock, ClockType
from rclpy.exceptions import NameValidationException, ParameterException
from rclpy.executors import SingleThreadedExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.logging import get_logger
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future
from sensor_msgs.msg import Imu, NavSatFix, PointCloud2
from std_srvs.srv import Empty, Trigger

from segloc import Prior, SeglocError

from .bond_port import BondPort
from .core.diagnosis import diagnose
from .core.frames import Transform
from .core.livox import is_livox
from .core.maps import grid_beside
from .core.pump import Pump
from .core.replies import Reply
from .core.robot import Robot
from .core.settings import Settings
from .grid_port import GridPort
from .messages import click_in, pose_in, seconds
from .outputs import Outputs
from .process import EndSignal
from .tf_port import TfPort

try:
    from segloc_msgs.srv import LoadMap
except ImportError:  # then the parameter map does it
    LoadMap = None
try:
    from nav2_msgs.srv import SetInitialPose
except ImportError:  # then the topic initialpose does it
    SetInitialPose = None

_TICK_S = 0.5
_POINT_CLOUD2 = "sensor_msgs/msg/PointCloud2"
# What wrong parameters, arguments and installations raise, here and in rclpy.
REFUSALS = (
    SeglocError, ImportError, NameValidationException, ParameterException,
    rclpy_implementation.RCLError, rclpy_implementation.UnknownROSArgsError,
)  # fmt: skip


def one_line(error: Exception) -> str:
    """The message of an error, without line breaks."""
    return " ".join(str(error).split())


def _message_type(name: str) -> Any:
    """Return the class of a message type, as ``sensor_msgs/msg/PointCloud2``.

    Raise ImportError if it is not installed.
    """
    package, _, message = name.split("/")
    module = importlib.import_module(f"{package}.msg")
    try:
        return getattr(module, message)
    except AttributeError as error:
        raise ImportError(f"{package} has no message {message}") from error


@dataclass
class _Call:
    fixes: int
    until: float
    future: Future


class Waiting:
    """Pending service calls."""

    def __init__(self) -> None:
        self._calls: list[_Call] = []
        self._lock = threading.Lock()

    def wait(self, fixes: int, seconds: float, future: Future) -> Future:
        """Return the future: True once there are more fixes than ``fixes``, else False."""
        with self._lock:
            self._calls.append(_Call(fixes, time.monotonic() + seconds, future))
        return future

    def settle(self, fixes: int, given_up: bool = False) -> None:
        """Answer the calls that are found, given up or timed out."""
        now = time.monotonic()
        with self._lock:
            done = [c for c in self._calls if fixes > c.fixes or given_up or now > c.until]
            self._calls = [c for c in self._calls if c not in done]
        for call in done:
            call.future.set_result(fixes > call.fixes)


class SeglocNode(LifecycleNode):
    """Localizes a robot in a prior map. Parameters: :class:`segloc_ros.core.Settings`."""

    def __init__(self, name: str = "segloc", **options: Any) -> None:
        super().__init__(name, **options)
        for parameter, default, description in Settings.declared():
            # Any type: the settings check it, and take 20 for 20.0 and [0, 1] for [0.0, 1.0].
            descriptor = ParameterDescriptor(description=description, dynamic_typing=True)
            self.declare_parameter(parameter, None if default == [] else default, descriptor)
        self.waiting = Waiting()
        self.robot: Robot | None = None
        self.pump: Pump | None = None
        self._outputs: Outputs | None = None
        self._tf: TfPort | None = None
        self._grid: GridPort | None = None
        self._inputs: list[Any] = []
        self._cloud_types: dict[str, str] = {}  # by topic, as subscribed
        self._bond: BondPort | None = None
        self._steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._timer = self.create_timer(_TICK_S, self._tick, clock=self._steady)
        # Calls wait, and must not keep what they wait for from coming in.
        self.calls = ReentrantCallbackGroup()
        for kind, service, on_call in (
            (Trigger, "relocalize", self._on_relocalize),
            (Empty, "reinitialize_global_localization", self._on_reinitialize),
            (Empty, "request_nomotion_update", self._on_update),
            (SetInitialPose, "set_initial_pose", self._on_set_pose),
            (LoadMap, "load_map", self._on_load),
        ):
            if kind is not None:
                self.create_service(kind, f"~/{service}", on_call, callback_group=self.calls)
        self.add_post_set_parameters_callback(self._on_parameters)

    def settings(self) -> Settings:
        """Return the settings that the parameters hold; raise ConfigError if they are wrong."""
        values = {}
        for name, default, _ in Settings.declared():
            value = self.get_parameter_or(name).value
            values[name] = default if value is None else value
        return Settings.of(values)

    # --- lifecycle -----------------------------------------------------------------------------

    def start(self) -> bool:
        """Configure and activate; False if either is refused."""
        success = TransitionCallbackReturn.SUCCESS
        return self.trigger_configure() is success and self.trigger_activate() is success

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        try:
            settings = self.settings()
            self._outputs = Outputs(self, settings)
            try:
                self._tf = TfPort(self, self._on_tf)
            except ImportError:
                self._without_tf(settings)
            self._grid = self._grid_port(settings.grid_service)
            self.robot = Robot(settings)
        except REFUSALS as error:
            self.get_logger().error(one_line(error))
            self._tear_down()
            return TransitionCallbackReturn.FAILURE
        self.robot.maps.note = self.get_logger().info
        self.pump = Pump(
            self.robot, self._publish, self._outputs.show_map, self._warn,
            scans=settings.points_depth * (1 + len(settings.more_points_topics)),
        )  # fmt: skip
        return super().on_configure(state)

    def _without_tf(self, settings: Settings) -> None:
        if settings.broadcasts_tf or settings.odometry == "tf":
            raise ImportError("mode tf and odometry by tf need tf2_msgs: install it")
        self.get_logger().warning("no tf2_msgs: the mount is known by base_to_lidar alone")

    def _end_bond(self) -> None:
        if self._bond is not None:
            self._bond.close()
            self._bond = None

    def _grid_port(self, service: str) -> GridPort | None:
        try:
            return GridPort(self, service) if service else None
        except ImportError:  # then there is no Nav2
            return None

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        try:
            self._subscribe(self.settings())
        except REFUSALS as error:
            self.get_logger().error(one_line(error))
            self.on_deactivate(state)
            return TransitionCallbackReturn.FAILURE
        if not self.get_parameter("autostart").value:
            self._start_bond()
        return super().on_activate(state)

    def _start_bond(self) -> None:
        """Send heartbeats to the lifecycle manager that has activated the node."""
        try:
            self._bond = BondPort(self, self._steady)
        except ImportError:
            self.get_logger().warning(
                "no package bond: install it, or set bond_timeout: 0.0 in Nav2's lifecycle manager"
            )

    def _subscribe(self, settings: Settings) -> None:
        for topic in (settings.points_topic, *settings.more_points_topics):
            self._inputs.append(self._subscribe_clouds(settings, topic, _POINT_CLOUD2))
        fast = QoSProfile(depth=200, reliability=ReliabilityPolicy.BEST_EFFORT)
        wanted = [
            (Imu, settings.imu_topic, self._on_imu, fast),
            (NavSatFix, settings.fix_topic, self._on_fix, fast),
            (PoseWithCovarianceStamped, settings.height_topic, self._on_height, fast),
            (PoseWithCovarianceStamped, settings.click_topic, self._on_click, 1),
        ]
        if settings.odometry == "topic":
            wanted.append((Odometry, settings.odom_topic, self._on_odometry, fast))
        for kind, topic, heard, qos in wanted:
            if topic:
                self._inputs.append(self.create_subscription(kind, topic, heard, qos))

    def _subscribe_clouds(self, settings: Settings, topic: str, type_name: str) -> Any:
        """Subscribe to a LiDAR's topic of a type that is installed."""
        reliability = ReliabilityPolicy.BEST_EFFORT
        if settings.points_reliable:
            reliability = ReliabilityPolicy.RELIABLE
        qos = QoSProfile(depth=settings.points_depth, reliability=reliability)
        self._cloud_types[topic] = type_name
        # Serialised: clouds that are skipped are not unpacked.
        on_data = self._on_cloud if type_name == _POINT_CLOUD2 else self._on_livox
        heard = partial(on_data, topic)
        return self.create_subscription(_message_type(type_name), topic, heard, qos, raw=True)

    def _follow_cloud_types(self, robot: Robot) -> None:
        """Subscribe with Livox's type to topics that have no publisher of another type."""
        for k, (topic, subscribed) in enumerate(list(self._cloud_types.items())):
            ends = self.get_publishers_info_by_topic(self._inputs[k].topic_name)
            types = sorted({end.topic_type for end in ends})
            if not types or subscribed in types:
                continue
            if types[0] != _POINT_CLOUD2 and not is_livox(types[0]):
                robot.report_topic(f"{topic} is {types[0]}, not {_POINT_CLOUD2}: remap points")
                continue
            try:
                _message_type(types[0])
            except ImportError:
                robot.report_topic(
                    f"{topic} is {types[0]}, which is not installed: source the driver's "
                    "workspace, or set its xfer_format to 0"
                )
                continue
            # First, since Fast DDS refuses a second type of one topic in one process.
            self.destroy_subscription(self._inputs[k])
            self._inputs[k] = self._subscribe_clouds(robot.settings, topic, types[0])

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        for subscription in self._inputs:
            self.destroy_subscription(subscription)
        self._inputs, self._cloud_types = [], {}
        self._end_bond()
        return super().on_deactivate(state)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        self._tear_down()
        return super().on_cleanup(state)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        self.on_deactivate(state)
        self._tear_down()
        return super().on_shutdown(state)

    def _tear_down(self) -> None:
        self._close_pump()
        for port in (self._outputs, self._tf, self._grid):
            if port is not None:
                port.close()
        self.robot, self._outputs, self._tf, self._grid = None, None, None, None

    def _close_pump(self) -> None:
        if self.pump is not None:
            self.pump.end()
            self.pump = None
        self.waiting.settle(-1, given_up=True)

    def destroy_node(self) -> None:
        self._end_bond()
        self._close_pump()
        super().destroy_node()

    # --- inputs --------------------------------------------------------------------------------

    def _warn(self, fault: str) -> None:
        self.get_logger().warning(fault, throttle_duration_sec=5.0)

    def _feed(self, call: Callable[[Robot], Any], *, is_scan: bool = False) -> None:
        if self.pump is not None:
            self.pump.feed(call, is_scan=is_scan)

    def _on_cloud(self, topic: str, data: bytes) -> None:
        def take(robot: Robot) -> list[Reply]:
            message = deserialize_message(data, PointCloud2)
            stamp, frame = seconds(message.header.stamp), message.header.frame_id
            return robot.on_cloud(message, stamp, frame, topic)

        self._feed(take, is_scan=True)

    def _on_livox(self, topic: str, data: bytes) -> None:
        self._feed(lambda robot: robot.on_livox(data, topic), is_scan=True)

    def _on_odometry(self, message: Odometry) -> None:
        stamp, frame, child = (
            seconds(message.header.stamp), message.header.frame_id, message.child_frame_id
        )  # fmt: skip
        pose = message.pose.pose
        self._feed(lambda robot: robot.on_odometry(stamp, frame, child, pose_in(pose)))

    def _on_tf(self, transforms: list[Transform], static: bool) -> None:
        self._feed(lambda robot: robot.on_transforms(transforms, static))

    def _on_imu(self, message: Imu) -> None:
        if message.linear_acceleration_covariance[0] >= 0:
            a, stamp = message.linear_acceleration, seconds(message.header.stamp)
            frame, felt = message.header.frame_id, np.array([a.x, a.y, a.z])
            self._feed(lambda robot: robot.on_acceleration(stamp, frame, felt))

    def _on_fix(self, message: NavSatFix) -> None:
        self._feed(lambda robot: robot.on_fix(message))

    def _on_height(self, message: PoseWithCovarianceStamped) -> None:
        stamp, frame = seconds(message.header.stamp), message.header.frame_id
        metres, variance = message.pose.pose.position.z, float(message.pose.covariance[14])
        self._feed(lambda robot: robot.on_height(stamp, frame, metres, variance))

    def _on_click(self, message: PoseWithCovarianceStamped) -> None:
        if self.pump is None:
            return
        try:
            click = click_in(message)
            why = self.pump.read(lambda robot: robot.on_click(click))
        except SeglocError as error:
            why = str(error)
        if why and why != "an echo":
            self.get_logger().warning(f"pose ignored: {why}")

    # --- outputs -------------------------------------------------------------------------------

    def _publish(self, replies: list[Reply]) -> None:
        if self._outputs is None or self.robot is None or not self._inputs:
            return
        for reply in replies:
            self._outputs.publish(reply, self._tf)
        self._outputs.publish_state(self.robot, True)
        self.waiting.settle(self.robot.fixes)

    def _tick(self) -> None:
        if self.pump is None or self._outputs is None:
            return
        self.pump.check()
        self.pump.read(self._look_after)

    def _look_after(self, robot: Robot) -> None:
        if self._inputs:
            self._publish(robot.report_silence())
            robot.publishers = self.count_publishers(self._inputs[0].topic_name)
            self._follow_cloud_types(robot)
        if self._outputs is not None:
            self._outputs.look_after(robot, bool(self._inputs))
        if robot.keeper is not None:
            for note in robot.keeper.notes:
                self.get_logger().info(note)
            robot.keeper.notes.clear()
        given_up = robot.trigger.resting and robot.trigger.held is None
        self.waiting.settle(robot.fixes, given_up)

    # --- services ------------------------------------------------------------------------------

    async def _on_relocalize(
        self, request: Trigger.Request, response: Trigger.Response
    ) -> Trigger.Response:
        response.success = await self.find()
        response.message = self.why()
        return response

    def _on_reinitialize(self, request: Empty.Request, response: Empty.Response) -> Empty.Response:
        self.find()
        return response

    def _on_update(self, request: Empty.Request, response: Empty.Response) -> Empty.Response:
        if self.pump is not None:
            self.pump.read(lambda robot: robot.request_update())
        return response

    def _on_set_pose(self, request: Any, response: Any) -> Any:
        self._on_click(request.pose)
        return response

    async def _on_load(self, request: Any, response: Any) -> Any:
        try:
            T_new_old = pose_in(request.old_in_new) if request.near else None
            fault = await self._load(request.map_url, T_new_old)
        except SeglocError as error:
            fault = str(error)
        response.success, response.message = not fault, fault or f"loaded {request.map_url}"
        return response

    def _on_parameters(self, parameters: list[Parameter]) -> None:
        for each in parameters:
            if each.name == "map" and each.value and self.pump is not None:
                self._load(str(each.value))

    def _load(self, path: str, T_new_old: Any = None) -> Future:
        """Replace the map; return a future of the fault, "" if there is none."""
        future = Future(executor=self.executor)
        if self.pump is None:
            future.set_result("the node is not configured")
            return future

        def done(fault: str) -> None:
            if fault:
                self.get_logger().error(f"the map stays as it was: {fault}")
            elif self._grid is not None and (grid := grid_beside(path)):
                self._grid.load(grid)
            future.set_result(fault)

        self.pump.load(path, T_new_old, done)
        return future

    def find(self, near: Prior | None = None, anywhere: bool = True) -> Future:
        """Search for the robot; return a future that is True if it is found."""
        future = Future(executor=self.executor)
        if self.pump is None or self.robot is None or not self._inputs:
            future.set_result(False)
            return future
        fixes = self.pump.read(lambda robot: robot.relocalize(near, anywhere))
        return self.waiting.wait(fixes, self.robot.settings.service_timeout_s, future)

    def why(self) -> str:
        """Return the state in one line."""
        if self.pump is None or self._outputs is None or not self._inputs:
            return "the node is not active"
        return self.pump.read(diagnose).message


def run(kind: type[SeglocNode], end: EndSignal) -> bool:
    """Spin a node, configured and activated if ``autostart`` is set, until a signal ends it.

    Returns
    -------
    bool
        False if parameters or missing packages prevent the start; the log has the reason.
    """
    stop: Future = Future()
    try:
        rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
        node = kind()
    except REFUSALS as error:
        get_logger("segloc").fatal(one_line(error))
        rclpy.try_shutdown()
        return False
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    end.call(lambda: stop.set_result(None))
    try:
        started = not node.get_parameter("autostart").value or node.start()
        if started:
            executor.spin_until_future_complete(stop)
    finally:
        node.destroy_node()
        executor.shutdown()
        rclpy.try_shutdown()
    return started
