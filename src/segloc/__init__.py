"""segloc: where is the robot? A pose in a prior LiDAR map from one point cloud.

>>> from segloc import Localizer, Scan, SegmentMap
>>> localizer = Localizer(SegmentMap.load("site.segmap"))  # doctest: +SKIP
>>> result = localizer.localize(Scan(points))  # doctest: +SKIP
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING

from ._native import __version__
from .errors import (
    ConfigError,
    DatasetError,
    InvalidScan,
    LiveError,
    MapFormatError,
    MapMismatch,
    MissingDependency,
    SeglocError,
    WeightsError,
)

if TYPE_CHECKING:
    from .config import Config
    from .datasets import open_sequence
    from .frontend.rolling_cloud import RollingCloud
    from .geometry import ros_covariance
    from .live import LiveLocalizer
    from .localization import Localization, Localized, NotLocalized, Reason
    from .localizer import Localizer
    from .loops import LoopDetector, align_sessions
    from .map.build import build_map
    from .map.segment_map import SegmentMap
    from .map.update import update_map
    from .prior import Prior
    from .tracker import Tracker
    from .types import LocalCloud, MemoryRecording, Recording, Scan

__all__ = [
    "Config",
    "ConfigError",
    "DatasetError",
    "InvalidScan",
    "LiveError",
    "LiveLocalizer",
    "LocalCloud",
    "Localization",
    "Localized",
    "Localizer",
    "LoopDetector",
    "MapFormatError",
    "MapMismatch",
    "MemoryRecording",
    "MissingDependency",
    "NotLocalized",
    "Prior",
    "Reason",
    "Recording",
    "RollingCloud",
    "Scan",
    "SeglocError",
    "SegmentMap",
    "Tracker",
    "WeightsError",
    "__version__",
    "align_sessions",
    "build_map",
    "open_sequence",
    "ros_covariance",
    "update_map",
]

_LATER = {
    "Config": "config",
    "LiveLocalizer": "live",
    "LocalCloud": "types",
    "Localization": "localization",
    "Localized": "localization",
    "Localizer": "localizer",
    "LoopDetector": "loops",
    "MemoryRecording": "types",
    "NotLocalized": "localization",
    "Prior": "prior",
    "Reason": "localization",
    "Recording": "types",
    "RollingCloud": "frontend.rolling_cloud",
    "Scan": "types",
    "SegmentMap": "map.segment_map",
    "Tracker": "tracker",
    "align_sessions": "loops",
    "build_map": "map.build",
    "open_sequence": "datasets",
    "ros_covariance": "geometry",
    "update_map": "map.update",
}
"""Imported when it is first used: NumPy, SciPy and Pydantic take a second on a slow machine."""


def __getattr__(name: str) -> object:
    if name not in _LATER:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f".{_LATER[name]}", __name__), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
