"""Localize a moving robot online from scans and odometry."""

from __future__ import annotations

from ..tracker import QueryRequest, TrackerConfig
from ..tracking.belief import Status, View
from .config import LiveConfig
from .core import LiveCore, State, StateReason
from .kept_pose import PoseKeeper
from .lidar_odometry import LidarOdometry
from .localizer import LiveLocalizer
from .replay import Replay, play, pose_errors
from .shell import Shell

__all__ = [
    "LidarOdometry",
    "LiveConfig",
    "LiveCore",
    "LiveLocalizer",
    "PoseKeeper",
    "QueryRequest",
    "Replay",
    "Shell",
    "State",
    "StateReason",
    "Status",
    "TrackerConfig",
    "View",
    "play",
    "pose_errors",
]
