"""Localize a moving robot online from scans and odometry."""

from __future__ import annotations

from ..tracking.belief import Status as Status
from .config import LiveConfig as LiveConfig
from .core import LiveCore as LiveCore
from .core import State as State
from .kept_pose import PoseKeeper as PoseKeeper
from .lidar_odometry import LidarOdometry as LidarOdometry
from .localizer import LiveLocalizer as LiveLocalizer
from .replay import Replay as Replay
from .replay import play as play
from .replay import pose_errors as pose_errors
