"""Parts for a robot's node: messages, tf and settings, without any ROS. Its names are promised.

Messages
    scan_of_pointcloud2  points of a sensor_msgs/PointCloud2
    scan_of_livox       points of a serialised livox_ros_driver2/CustomMsg
    StreamTimes         recognise the unit of a stream's point times
    unread_times        fields that look like point times and are not read as such
    times_fit           whether a scan has plausible point times
    frame_name          name of a frame, without a leading slash
    prior_of_fix        a sensor_msgs/NavSatFix as a prior in a georeferenced map
    gravity_of          gravity from accelerations; within GRAVITY_HALF_WINDOW_S of a moment
    checked_pose        a rigid (4, 4) pose, or InvalidScan
    interpolated        poses between stamped poses

Maps
    map_config          configuration of a map
    cloud_files         files of a finished cloud; is_cloud tells by the name
    cloud_sources       the same, and the files that place them
    read_cloud          points of a finished cloud, part by part

Queries
    matched_segments    segments of the map that a search agrees with
    scan_findings       faults of scans: unit, axes; a Finding with a Fault

Settings and types
    Section             base of settings: rejects unknown keys and NaN
    Float32, Float64, Int64, Pose
                        types of arrays; a Pose is a rigid (4, 4) float64
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from . import geometry
from .config import map_config
from .errors import ConfigError
from .map.georeference import Georeference
from .map.segment_map import SegmentMap
from .motion import interpolated, times_fit
from .pipeline import Search
from .prior import Prior
from .proposals.proposer import Query
from .system import lazy
from .system.checks import checked_pose
from .system.files import is_cloud
from .system.section import Section
from .types import Float32, Float64, Int64, Pose, Scan

if TYPE_CHECKING:
    from .tools.datasets.clocks import StreamTimes
    from .tools.datasets.gravity import GRAVITY_HALF_WINDOW_S, gravity_of
    from .tools.datasets.ros.bag_tf import frame_name
    from .tools.datasets.ros.pointcloud2 import scan_of_pointcloud2
    from .tools.doctor.finding import Fault, Finding
    from .tools.doctor.scan_faults import scan_findings
    from .tools.io.clouds import cloud_files, cloud_sources, read_cloud
    from .tools.io.point_times import unread_times
else:
    __getattr__, __dir__ = lazy(
        __name__,
        {
            "tools.datasets.clocks": "StreamTimes",
            "tools.datasets.gravity": "GRAVITY_HALF_WINDOW_S gravity_of",
            "tools.datasets.ros.bag_tf": "frame_name",
            "tools.datasets.ros.pointcloud2": "scan_of_pointcloud2",
            "tools.doctor.finding": "Fault Finding",
            "tools.doctor.scan_faults": "scan_findings",
            "tools.io.clouds": "cloud_files cloud_sources read_cloud",
            "tools.io.point_times": "unread_times",
        },
    )

__all__ = [
    "GRAVITY_HALF_WINDOW_S",
    "Fault",
    "Finding",
    "Float32",
    "Float64",
    "Int64",
    "Pose",
    "Section",
    "StreamTimes",
    "checked_pose",
    "cloud_files",
    "cloud_sources",
    "frame_name",
    "gravity_of",
    "interpolated",
    "is_cloud",
    "map_config",
    "matched_segments",
    "prior_of_fix",
    "read_cloud",
    "scan_findings",
    "scan_of_livox",
    "scan_of_pointcloud2",
    "times_fit",
    "unread_times",
]

_AGREE_M = 2.0


def scan_of_livox(data: bytes) -> Scan:
    """Convert a Livox CustomMsg of ROS 2 to points, with times after its stamp.

    Parameters
    ----------
    data : bytes
        The message in CDR.

    Raises
    ------
    DatasetError
        If it is shorter than its declared size.
    """
    from .tools.datasets.ros.bag_messages import livox_scan

    return livox_scan(data, cdr=True)


def prior_of_fix(prior_map: SegmentMap, fix: Any, stamp: float, least_m: float) -> Prior | None:
    """Return a prior around a GNSS fix; None if there is no fix, or it is older than a query's.

    Parameters
    ----------
    prior_map : SegmentMap
    fix : sensor_msgs/NavSatFix
    stamp : float
        Of the query [s].
    least_m : float
        Radius for an exact fix [m]; covers errors of antenna, scan and map.

    Raises
    ------
    ConfigError, MapFormatError
        If the map is not georeferenced.
    MissingDependency
        If pyproj is not installed.
    """
    from .tools.batch.run import gnss_priors
    from .tools.datasets.fixes import Fixes

    georeference = Georeference.of(prior_map.metadata)
    if georeference is None:
        raise ConfigError("the map is not georeferenced: build it with --epsg and --origin")
    fixes = Fixes.of("GNSS", [(fix, stamp)])
    if not len(fixes):
        return None
    return gnss_priors(fixes, georeference, np.array([stamp]), least_m)[0]


def matched_segments(query: Query, search: Search) -> tuple[Float64 | None, Float64]:
    """Return what a search found, as a callback of a query receives it.

    Returns
    -------
    position : (3,) float64 or None
        Position of the sensor at the best candidate, in the map; None without any.
    centroids : (K, 3) float64
        Centroids of the map's segments that agree with it.
    """
    best, matches = search.posterior.best, search.matches
    if best is None:
        return None, np.empty((0, 3))
    position = (best.T_map_local @ query.cloud.T_local_sensor)[:3, 3]
    if not len(matches):
        return position, np.empty((0, 3))
    ours = geometry.transform(best.T_map_local, query.scene.segments.centroids[matches.query])
    theirs = np.asarray(search.prior_map.centroids[matches.map], np.float64)
    agree = np.linalg.norm(ours - theirs, axis=1) < _AGREE_M
    return position, np.unique(theirs[agree], axis=0)
