"""Simulated worlds, LiDARs and drives: data with exact poses and the identity of every point."""

from __future__ import annotations

from .forest import forest
from .lidar import SpinningLidar, hdl32e, hdl64e, vlp16
from .meadow import meadow
from .odometry import OdometryNoise
from .park import park
from .ranging import Lidar
from .record import process_pool, record
from .town import town
from .traversal import Route, SimulatedSequence, demo_sessions, simulate_session
from .worlds import Conditions, Scene, World

__all__ = [
    "Conditions",
    "Lidar",
    "OdometryNoise",
    "Route",
    "Scene",
    "SimulatedSequence",
    "SpinningLidar",
    "World",
    "demo_sessions",
    "forest",
    "hdl32e",
    "hdl64e",
    "meadow",
    "park",
    "process_pool",
    "record",
    "simulate_session",
    "town",
    "vlp16",
]
