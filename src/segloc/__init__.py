"""segloc: where is the robot? A pose in a prior LiDAR map from one point cloud.

>>> from segloc import Localizer, Scan, SegmentMap
>>> prior_map = SegmentMap.from_scans(scans, poses)  # doctest: +SKIP
>>> result = Localizer(prior_map).localize(Scan(points))  # doctest: +SKIP
>>> print(result)  # doctest: +SKIP
localized at x 12.34, y 5.67, z 1.20 m, yaw 45.0 deg (confidence 0.99)

Clouds and recordings
    Scan                a cloud as a sensor saw it, with its stamp, pose or gravity if known
    MemoryRecording     scans in memory with their poses
    open_sequence       open a recording on disk: a folder, a bag, a capture, a known dataset
    Recording           protocol of recordings: write a class of your own for other sources
    RollingCloud        the cloud of the last metres, kept up to date scan by scan
    LocalCloud          what a query is: points around one pose, z up

Maps
    build_map           scans with poses -> a map; also SegmentMap.from_scans
    SegmentMap          a map: from_scans, load, save, merge, crop, info, plot
    update_map          add a later session to a map, and remove what is gone
    align_sessions      sessions with poses that drift -> poses in one frame
    align_to_map        sessions with poses that drift -> poses in the frame of a map

Localization
    Localizer           finds the pose of a scan in a map, with no first guess
    Prior               about where the sensor is known to be: Localizer.localize(near=...)
    Localized           an answer with a pose: T_map_sensor, confidence, covariance, plot
    NotLocalized        an answer without one: reason, message, plot
    Localization        either of the two; Reason lists why there is no pose
    ros_covariance      the covariance of an answer as ROS has it

On a robot
    Tracker             one pose over many scans, carried along by odometry
    LiveLocalizer       the same in threads of its own, for streams of scans and odometry
    LoopDetector        finds the places that a robot comes back to, for a SLAM back-end

Settings and errors
    Config              everything that can be set; `segloc config` explains it
    SeglocError         base of all errors: ConfigError, DatasetError, InvalidScan, LiveError,
                        MapFormatError, MapMismatch, MissingDependency, WeightsError

On the command line: ``segloc --help``. ``segloc.robot`` has parts for a robot's node, and
``segloc.tiles`` large maps; further rooms are described in docs/explanation/architecture.md.
"""

from __future__ import annotations

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
from .system import lazy
from .system.moved import alias

if TYPE_CHECKING:
    from .config import Config
    from .frontend.rolling_cloud import RollingCloud
    from .geometry import ros_covariance
    from .joining.update import update_map
    from .live import LiveLocalizer
    from .localization import Localization, Localized, NotLocalized, Reason
    from .localizer import Localizer
    from .loops import LoopDetector, align_sessions, align_to_map
    from .map.segment_map import SegmentMap
    from .mapping import build_map
    from .prior import Prior
    from .tools.datasets import open_sequence
    from .tracker import Tracker
    from .types import LocalCloud, MemoryRecording, Recording, Scan
else:  # NumPy, SciPy and Pydantic take a second to import on a slow machine
    __getattr__, __dir__ = lazy(
        __name__,
        {
            "config": "Config",
            "frontend.rolling_cloud": "RollingCloud",
            "geometry": "ros_covariance",
            "joining.update": "update_map",
            "live": "LiveLocalizer",
            "localization": "Localization Localized NotLocalized Reason",
            "localizer": "Localizer",
            "loops": "LoopDetector align_sessions align_to_map",
            "map.segment_map": "SegmentMap",
            "mapping": "build_map",
            "prior": "Prior",
            "tools.datasets": "open_sequence",
            "tracker": "Tracker",
            "types": "LocalCloud MemoryRecording Recording Scan",
        },
    )

_MOVED = ("batch", "cli", "datasets", "doctor", "export", "inspect", "io")
alias({f"{__name__}.{room}": f"{__name__}.tools.{room}" for room in _MOVED})

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
    "align_to_map",
    "build_map",
    "open_sequence",
    "ros_covariance",
    "update_map",
]
