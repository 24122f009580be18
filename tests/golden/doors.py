"""All that the golden corpus imports of segloc: where the source moves, only this file follows."""

# ruff: noqa: F401
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
