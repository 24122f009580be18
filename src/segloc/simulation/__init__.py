"""Simulated worlds, LiDARs and drives: data with exact poses and the identity of every point."""

from __future__ import annotations

from ..motion import Motion, deskew
from .drives import demo_sessions, simulate_sessions
from .forest import forest
from .industrial import industrial
from .lidar import SpinningLidar, hdl32e, hdl64e, os1_64, os1_128, vlp16
from .linescan import LineLidar, lms151
from .meadow import meadow
from .odometry import OdometryNoise
from .park import park
from .platforms import PLATFORMS, Gait, Platform, car, handheld, legged, wheeled
from .ranging import Lidar, Rays, Returns
from .record import process_pool, record
from .rosette import RosetteLidar, solid_state
from .route import Route
from .scene import Scene
from .scenes import SCENES
from .sensors import SENSORS
from .town import town
from .traversal import SimulatedSequence, simulate_session
from .worlds import Conditions, World

__all__ = [
    "PLATFORMS",
    "SCENES",
    "SENSORS",
    "Conditions",
    "Gait",
    "Lidar",
    "LineLidar",
    "Motion",
    "OdometryNoise",
    "Platform",
    "Rays",
    "Returns",
    "RosetteLidar",
    "Route",
    "Scene",
    "SimulatedSequence",
    "SpinningLidar",
    "World",
    "car",
    "demo_sessions",
    "deskew",
    "forest",
    "handheld",
    "hdl32e",
    "hdl64e",
    "industrial",
    "legged",
    "lms151",
    "meadow",
    "os1_64",
    "os1_128",
    "park",
    "process_pool",
    "record",
    "simulate_session",
    "simulate_sessions",
    "solid_state",
    "town",
    "vlp16",
    "wheeled",
]
