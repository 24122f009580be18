"""Simulated worlds, LiDARs and drives: data with exact poses and the identity of every point."""

from __future__ import annotations

from segloc.motion import Motion, deskew

from .drives import record, simulate_sessions
from .motion.platforms import (
    PLATFORMS,
    Flight,
    Gait,
    Platform,
    Route,
    car,
    carried,
    drone,
    handheld,
    legged,
    quadruped,
    wheeled,
)
from .motion.traversal import OdometryNoise, SimulatedSequence, simulate_session
from .objects.scene import Scene
from .sensors import SENSORS
from .sensors.lidar import (
    LineLidar,
    RosetteLidar,
    SpinningLidar,
    SwirlLidar,
    avia,
    hdl32e,
    hdl64e,
    lms151,
    mid360,
    os0_128,
    os1_64,
    os1_128,
    solid_state,
    vlp16,
)
from .sensors.ranging import Lidar, Rays, Returns
from .worlds import SCENES
from .worlds.forest import forest
from .worlds.industrial import industrial
from .worlds.meadow import meadow
from .worlds.mine import mine
from .worlds.offices import building, offices
from .worlds.park import park
from .worlds.town import town
from .worlds.warehouse import warehouse
from .worlds.world import Conditions, World

__all__ = [
    "PLATFORMS",
    "SCENES",
    "SENSORS",
    "Conditions",
    "Flight",
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
    "SwirlLidar",
    "World",
    "avia",
    "building",
    "car",
    "carried",
    "deskew",
    "drone",
    "forest",
    "handheld",
    "hdl32e",
    "hdl64e",
    "industrial",
    "legged",
    "lms151",
    "meadow",
    "mid360",
    "mine",
    "offices",
    "os0_128",
    "os1_64",
    "os1_128",
    "park",
    "quadruped",
    "record",
    "simulate_session",
    "simulate_sessions",
    "solid_state",
    "town",
    "vlp16",
    "warehouse",
    "wheeled",
]
