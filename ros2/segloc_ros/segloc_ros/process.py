"""The process of a node: how it starts, and how it ends on a signal.

Nothing but the standard library is imported before signals are taken care of.
"""

from __future__ import annotations

import importlib
import os
import signal
import sys
import threading
from collections.abc import Callable

EXIT_CONFIG = 78  # EX_CONFIG of sysexits.h: started again, it would fail again
LAUNCHED = "SEGLOC_LAUNCHED"  # environment variable: the process ends with its parent
_SIGNALS = (signal.SIGINT, signal.SIGTERM)
_GRACE_S = 4.0  # ros2 launch loses patience after 5 s
_PR_SET_PDEATHSIG = 1  # prctl(2)


class EndSignal:
    """Waits for SIGINT and SIGTERM in a thread of its own, from its construction on.

    No signal handler runs, so that none interrupts an import or a callback half way. Without a
    callback, the first signal ends the process at once; with one, it is called, and the process
    has 4 s to end, or until the next signal. The exit status is 0 in each case.
    """

    def __init__(self) -> None:
        self._callback: Callable[[], None] | None = None
        signal.pthread_sigmask(signal.SIG_BLOCK, _SIGNALS)
        if os.environ.get(LAUNCHED) and sys.platform == "linux":
            _end_with_parent()
        threading.Thread(target=self._wait, name="signals", daemon=True).start()

    def call(self, callback: Callable[[], None]) -> None:
        """Call this, in the thread of the signals, instead of ending at once."""
        self._callback = callback

    def _wait(self) -> None:
        signal.sigwait(_SIGNALS)
        if self._callback is not None:
            self._callback()
            signal.sigtimedwait(_SIGNALS, _GRACE_S)
        os._exit(0)


def _end_with_parent() -> None:
    """Receive SIGTERM when the parent ends: ros2 launch leaves its processes if it is killed."""
    import ctypes

    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)


def main(module: str = "segloc_ros.node", name: str = "SeglocNode") -> None:
    """Run the node of a class until it ends."""
    end = EndSignal()
    from rclpy.logging import get_logger
    from rclpy.node import Node

    fault = ""
    if not hasattr(Node, "add_post_set_parameters_callback"):
        fault = (
            "ROS 2 Humble cannot run this node: its rclpy lacks add_post_set_parameters_callback. "
            "Use Jazzy or later, or the image of docker/ros2.Dockerfile beside your own nodes"
        )
    else:
        try:
            kind = getattr(importlib.import_module(module), name)
        except ImportError as error:
            fault = f"{error}: install it into {sys.executable}, the Python of this node"
    if fault:
        get_logger("segloc").fatal(fault)
        sys.exit(EXIT_CONFIG)
    from .node import run

    sys.exit(0 if run(kind, end) else EXIT_CONFIG)
