"""The bond with Nav2's lifecycle manager, by bond/msg/Status and without bondpy."""

from __future__ import annotations

import time
import uuid
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rclpy.clock import Clock
    from rclpy.node import Node

PERIOD_S = 0.25
"""Time between heartbeats [s]; Nav2's nodes send four to ten per second."""
TIMEOUT_S = 4.0
"""Time without heartbeats of the other end after which a bond is broken [s]."""
LAST_S = 0.5
"""Time in which the last message reaches the manager before its publisher ends [s]."""


class BondPort:
    """Sends heartbeats to a lifecycle manager from construction to :meth:`close`, as bondcpp.

    Its topic is ``bond``, in newer versions of Nav2 ``bond/NAME``; both are served. A bond that the
    other end has ended, or that fell silent, stays broken. Raise ImportError if the package bond is
    not installed.
    """

    def __init__(self, node: Node, clock: Clock) -> None:
        from bond.msg import Status
        from rclpy.duration import Duration

        self._type, self._node, self._last = Status, node, Duration(seconds=LAST_S)
        self._instance, self._other = str(uuid.uuid4()), ""
        self._received_s, self._is_broken = 0.0, False
        topics = ("bond", f"bond/{node.get_name()}")
        self._publishers = [node.create_publisher(Status, topic, 10) for topic in topics]
        self._subscriptions = [
            node.create_subscription(Status, topic, self._receive, 100) for topic in topics
        ]
        self._timer = node.create_timer(PERIOD_S, self._beat, clock=clock)

    def close(self) -> None:
        """End the bond, with a last message to the manager."""
        self._node.destroy_timer(self._timer)
        if not self._is_broken:
            self._send(False)
        for subscription in self._subscriptions:
            self._node.destroy_subscription(subscription)
        for publisher in self._publishers:
            publisher.wait_for_all_acked(self._last)
            self._node.destroy_publisher(publisher)

    def _beat(self) -> None:
        if self._other and time.monotonic() - self._received_s > TIMEOUT_S:
            self._is_broken = True
        if not self._is_broken:
            self._send(True)

    def _receive(self, message: Any) -> None:
        """Take a heartbeat or the message of an end; not its own, which come back, or a third's."""
        if message.id != self._node.get_name() or message.instance_id == self._instance:
            return
        if self._other not in ("", message.instance_id):
            return
        self._other, self._received_s = message.instance_id, time.monotonic()
        if not (message.active or self._is_broken):
            self._is_broken = True
            self._node.get_logger().warning("the lifecycle manager has ended its bond")
            self._send(False)

    def _send(self, active: bool) -> None:
        message = self._type(id=self._node.get_name(), instance_id=self._instance)
        message.header.stamp = self._node.get_clock().now().to_msg()
        message.active = active
        message.heartbeat_timeout, message.heartbeat_period = TIMEOUT_S, PERIOD_S
        for publisher in self._publishers:
            publisher.publish(message)
