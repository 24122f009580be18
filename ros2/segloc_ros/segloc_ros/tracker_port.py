"""Poses for a tracker such as AMCL, by topic and, if configured, by its service."""

from __future__ import annotations

from collections.abc import Callable

from geometry_msgs.msg import PoseWithCovarianceStamped
from rclpy.node import Node

from .core.replies import InitialPose
from .core.settings import Settings
from .messages import pose_out


class TrackerPort:
    """Sends the robot's pose to a tracker, again when the tracker appears.

    Raise ImportError if a service is configured and nav2_msgs is not installed.
    """

    def __init__(self, node: Node, settings: Settings) -> None:
        self._node = node
        self._publisher = node.create_publisher(
            PoseWithCovarianceStamped, settings.initialpose_topic, 1
        )
        ours = node.resolve_topic_name(settings.initialpose_topic)
        clicks = settings.click_topic and node.resolve_topic_name(settings.click_topic)
        self._ears = 1 if clicks == ours else 0  # the node's own
        self._client = None
        if settings.set_initial_pose_service:
            from nav2_msgs.srv import SetInitialPose

            self._request = SetInitialPose.Request
            self._client = node.create_client(SetInitialPose, settings.set_initial_pose_service)
        self._unheard = self._uncalled = False

    def send(self, reply: InitialPose) -> None:
        """Publish a pose, and call the service if it is ready."""
        message = pose_out(reply.pose)
        self._publisher.publish(message)
        self._unheard = not self._is_heard()
        self._call(message)

    def send_again(self, now: Callable[[], InitialPose | None]) -> None:
        """Send the pose to a subscriber or service that was not ready before."""
        heard = self._unheard and self._is_heard()
        called = self._uncalled and self._client is not None and self._client.service_is_ready()
        if (heard or called) and (reply := now()) is not None:
            self.send(reply)

    def forget(self) -> None:
        """Do not send again: the pose is no longer valid."""
        self._unheard = self._uncalled = False

    def close(self) -> None:
        """Destroy the publisher and the client."""
        self._node.destroy_publisher(self._publisher)
        if self._client is not None:
            self._node.destroy_client(self._client)

    def _is_heard(self) -> bool:
        return self._publisher.get_subscription_count() > self._ears

    def _call(self, message: PoseWithCovarianceStamped) -> None:
        if self._client is None:
            return
        self._uncalled = not self._client.service_is_ready()
        if not self._uncalled:
            self._client.call_async(self._request(pose=message))
