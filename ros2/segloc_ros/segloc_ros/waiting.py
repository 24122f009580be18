"""Service calls that are answered when the robot is found, or time out."""

from __future__ import annotations

import threading
import time
from dataclasses import dataclass

from rclpy.task import Future


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
