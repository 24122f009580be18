"""Simulated worlds, LiDARs and drives: data with exact poses and the identity of every point."""

from __future__ import annotations

from .industrial import industrial
from .lidar import SpinningLidar, hdl32e, hdl64e, vlp16
from .odometry import OdometryNoise
from .ranging import Lidar
from .record import process_pool, record
from .scenes import SCENES
from .town import town
from .traversal import Route, SimulatedSequence, demo_sessions, simulate_session
from .worlds import Conditions, Scene, World

__all__ = [
    "SCENES",
    "Conditions",
    "Lidar",
    "OdometryNoise",
    "Route",
    "Scene",
    "SimulatedSequence",
    "SpinningLidar",
    "World",
    "demo_sessions",
    "hdl32e",
    "hdl64e",
    "industrial",
    "process_pool",
    "record",
    "simulate_session",
    "town",
    "vlp16",
]
