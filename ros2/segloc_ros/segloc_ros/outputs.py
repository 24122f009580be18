"""Everything that the node publishes."""

from __future__ import annotations

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseArray, PoseWithCovarianceStamped
from nav_msgs.msg import Odometry
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Bool
from visualization_msgs.msg import MarkerArray

from segloc import Localizer

from .core.diagnosis import Diagnosis, Level, RobotState, diagnose, robot_state
from .core.maps import map_points
from .core.replies import (
    CandidatesReply,
    InitialPose,
    MapToOdom,
    MatchesReply,
    OdometryReply,
    PoseReply,
    Reply,
)
from .core.robot import Robot
from .core.settings import Settings
from .messages import (
    candidates_out,
    cloud_out,
    diagnostics_out,
    matches_out,
    odometry_out,
    pose_out,
    state_out,
)
from .tf_port import TfPort
from .tracker_port import TrackerPort

try:
    from segloc_msgs.msg import State
except ImportError:  # then ~/localized and /diagnostics have the state
    State = None


class Outputs:
    """The publishers of a node."""

    def __init__(self, node: Node, settings: Settings) -> None:
        self._node, self._settings = node, settings
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self._pose = node.create_publisher(PoseWithCovarianceStamped, "~/pose", latched)
        self._localized = node.create_publisher(Bool, "~/localized", latched)
        self._state = None if State is None else node.create_publisher(State, "~/state", latched)
        self._published: RobotState | None = None
        self._diagnostics = node.create_publisher(DiagnosticArray, "/diagnostics", 10)
        self._map = node.create_publisher(PointCloud2, "~/map_cloud", latched)
        self._matches = node.create_publisher(MarkerArray, "~/matches", 1)
        self._candidates = node.create_publisher(PoseArray, "~/candidates", 1)
        self._odometry = None
        if settings.odometry == "kiss-icp" and settings.odom_topic:
            self._odometry = node.create_publisher(Odometry, settings.odom_topic, 10)
        self._tracker = TrackerPort(node, settings) if settings.sends_initialpose else None
        self._said = ""

    def publish(self, reply: Reply, tf: TfPort | None) -> None:
        """Publish an output of the core."""
        if isinstance(reply, PoseReply):
            self._pose.publish(pose_out(reply))
        elif isinstance(reply, InitialPose) and self._tracker is not None:
            self._tracker.send(reply)
        elif isinstance(reply, CandidatesReply):
            self._candidates.publish(candidates_out(reply))
        elif isinstance(reply, MatchesReply):
            self._matches.publish(matches_out(reply))
        elif isinstance(reply, OdometryReply) and self._odometry is not None:
            self._odometry.publish(odometry_out(reply))
        is_odometry = isinstance(reply, OdometryReply) and self._settings.odom_tf
        if tf is not None and (is_odometry or isinstance(reply, MapToOdom)):
            tf.send(reply.transform)

    def publish_state(self, robot: Robot, active: bool) -> None:
        """Publish the state of a robot if anything but its stamp has changed."""
        state, last = robot_state(robot, active), self._published
        if last is not None and not state.is_news_after(last):
            return
        self._published = state
        if self._state is not None:
            self._state.publish(state_out(state, self._settings.map_frame, State()))
        if last is None or last.localized != state.localized:
            self._localized.publish(Bool(data=state.localized))

    def show_map(self, localizer: Localizer) -> None:
        """Publish the cloud of a map, latched, and log notes on the map."""
        most = self._settings.map_cloud_points
        stamp = self._node.get_clock().now().to_msg()
        if most:
            points = map_points(localizer.prior_map, most)
            self._map.publish(cloud_out(points, self._settings.map_frame, stamp))
        for note in localizer.notes:
            self._node.get_logger().warning(note)

    def look_after(self, robot: Robot, active: bool) -> None:
        """Publish state and diagnosis, log a diagnosis that is new, and serve late trackers."""
        told = diagnose(robot)
        if not active:
            told = Diagnosis(Level.STALE, "inactive", told.values)
        self.publish_state(robot, active)
        if self._tracker is not None:
            if robot.T_map_odom is None:
                self._tracker.forget()
            elif active:
                self._tracker.send_again(robot.initial_pose)
        stamp = self._node.get_clock().now().to_msg()
        name = f"{self._node.get_name()}: localization"
        self._diagnostics.publish(diagnostics_out(told, name, stamp))
        if told.message == self._said:
            return
        self._said, logger = told.message, self._node.get_logger()
        if told.level is Level.OK:  # a line each: rclpy knows calls by their lines
            logger.info(told.message)
        elif told.level is Level.ERROR:
            logger.error(told.message)
        else:
            logger.warning(told.message)

    def close(self) -> None:
        """Destroy the publishers."""
        ours = [self._pose, self._diagnostics, self._map, self._matches, self._candidates]
        ours += [self._odometry, self._localized, self._state]
        for publisher in ours:
            if publisher is not None:
                self._node.destroy_publisher(publisher)
        if self._tracker is not None:
            self._tracker.close()
