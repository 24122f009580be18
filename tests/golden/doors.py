"""All that the golden corpus imports of segloc: where the source moves, only this file follows."""

from __future__ import annotations

from segloc_lab.simulation import (
    SCENES,
    SENSORS,
    Conditions,
    OdometryNoise,
    SimulatedSequence,
    World,
    building,
    simulate_sessions,
    warehouse,
)
from segloc_lab.swathes import swathes
from segloc_stems import LandmarkLocalizer, find_stems

from segloc import (
    Config,
    LiveLocalizer,
    Localizer,
    LoopDetector,
    Prior,
    Scan,
    SegmentMap,
    Tracker,
    align_sessions,
    build_map,
    geometry,
    open_sequence,
    update_map,
)
from segloc._native import instruction_set
from segloc.live import LiveConfig, LiveCore
from segloc.loops import LoopConfig
from segloc.map.compact import CompactConfig, compacted
from segloc.map.config import MappingConfig
from segloc.tiles import TiledLocalizer, TiledMap, cut_tiles
from segloc.tools.datasets import NO_POSES
from segloc.tools.doctor import examine
from segloc.tools.io import read_scan
from segloc.tracker import TrackerConfig

__all__ = [
    "NO_POSES",
    "SCENES",
    "SENSORS",
    "CompactConfig",
    "Conditions",
    "Config",
    "LandmarkLocalizer",
    "LiveConfig",
    "LiveCore",
    "LiveLocalizer",
    "Localizer",
    "LoopConfig",
    "LoopDetector",
    "MappingConfig",
    "OdometryNoise",
    "Prior",
    "Scan",
    "SegmentMap",
    "SimulatedSequence",
    "TiledLocalizer",
    "TiledMap",
    "Tracker",
    "TrackerConfig",
    "World",
    "align_sessions",
    "build_map",
    "building",
    "compacted",
    "cut_tiles",
    "examine",
    "find_stems",
    "geometry",
    "instruction_set",
    "open_sequence",
    "read_scan",
    "simulate_sessions",
    "swathes",
    "update_map",
    "warehouse",
]
