"""The bond with Nav2's lifecycle manager, by bond/msg/Status and without bondpy."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

from .core.bond import PERIOD_S, TIMEOUT_S, Bond

if TYPE_CHECKING:
    from rclpy.clock import Clock
    from rclpy.node import Node


class BondPort:
    """Sends heartbeats to a lifecycle manager from construction to :meth:`close`.

    Its topic is ``bond``, in newer versions of Nav2 ``bond/NAME``; both are served.

    Parameters
    ----------
    node : rclpy.node.Node
    clock : rclpy.clock.Clock
        A steady clock.

    Raises
    ------
    ImportError
        If the package bond is not installed.
    """

    def __init__(self, node: Node, clock: Clock) -> None:
        from bond.msg import Status

        self._type, self._node, self._bond = Status, node, Bond()
        topics = ("bond", f"bond/{node.get_name()}")
        self._publishers = [node.create_publisher(Status, topic, 10) for topic in topics]
        self._subscriptions = [
            node.create_subscription(Status, topic, self._receive, 100) for topic in topics
        ]
        self._timer = node.create_timer(PERIOD_S, self._beat, clock=clock)

    def close(self) -> None:
        """End the bond, with a last message to the manager."""
        self._node.destroy_timer(self._timer)
        if not self._bond.is_broken:
            self._send(False)
        for subscription in self._subscriptions:
            self._node.destroy_subscription(subscription)
        for publisher in self._publishers:
            self._node.destroy_publisher(publisher)

    def _beat(self) -> None:
        self._bond.check(time.monotonic())
        if not self._bond.is_broken:
            self._send(True)

    def _receive(self, message: Any) -> None:
        if message.id != self._node.get_name():
            return
        was_broken = self._bond.is_broken
        self._bond.receive(message.instance_id, message.active, time.monotonic())
        if self._bond.is_broken and not was_broken:
            self._node.get_logger().warning("the lifecycle manager has ended its bond")
            self._send(False)

    def _send(self, active: bool) -> None:
        message = self._type(id=self._node.get_name(), instance_id=self._bond.instance)
        message.header.stamp = self._node.get_clock().now().to_msg()
        message.active = active
        message.heartbeat_timeout, message.heartbeat_period = TIMEOUT_S, PERIOD_S
        for publisher in self._publishers:
            publisher.publish(message)
