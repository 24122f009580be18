"""tf without tf2_ros: its Python listener and broadcaster are these two topics, and no more."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile

from segloc import SeglocError

from .core.frames import Transform
from .messages import transform_in, transform_out

Heard = Callable[[list[Transform], bool], None]
_DEPTH = 100


class TfPort:
    """Listens to /tf and /tf_static, and sends on /tf.

    ``heard`` is called with transforms, and whether they are static. Raise ImportError if tf2_msgs
    is not installed.
    """

    def __init__(self, node: Node, heard: Heard) -> None:
        from tf2_msgs.msg import TFMessage

        self._type, self._node, self._heard = TFMessage, node, heard
        latched = QoSProfile(depth=_DEPTH, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self._sender = node.create_publisher(TFMessage, "/tf", QoSProfile(depth=_DEPTH))
        self._subscriptions = [
            node.create_subscription(TFMessage, "/tf", lambda m: self._take(m, False), _DEPTH),
            node.create_subscription(
                TFMessage, "/tf_static", lambda m: self._take(m, True), latched
            ),
        ]

    def send(self, transform: Transform) -> None:
        """Broadcast a transform."""
        self._sender.publish(self._type(transforms=[transform_out(transform)]))

    def close(self) -> None:
        """End both."""
        for subscription in self._subscriptions:
            self._node.destroy_subscription(subscription)
        self._node.destroy_publisher(self._sender)

    def _take(self, message: Any, static: bool) -> None:
        transforms = []
        for each in message.transforms:
            try:
                transforms.append(transform_in(each))
            except SeglocError as error:
                self._node.get_logger().warning(
                    f"tf {each.child_frame_id}: {error}", throttle_duration_sec=10.0
                )
        self._heard(transforms, static)
