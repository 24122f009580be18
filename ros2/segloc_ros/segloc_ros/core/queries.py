"""Queries: returned by the core, made in another thread, and applied."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from segloc import Localization, Scan, SeglocError, geometry
from segloc.live import LiveCore, QueryRequest, View
from segloc.robot import Fault, Float64, Pose, matched_segments, scan_findings

from .replies import MatchesReply

_CHECKED = 3
_AXES = (Fault.Z_DOWN, Fault.CAMERA_AXES, Fault.TILT)
_Z_UP = "publish odometry with z up (REP 103), or check the mount of the LiDAR"


@dataclass(frozen=True)
class Job:
    """A query that is due, and scans to check if it fails."""

    core: LiveCore
    asked: QueryRequest
    scans: tuple[Scan, ...] = ()


class ScansInOdom:
    """The first scans of a lost robot, in the axes of its odometry; checked once."""

    def __init__(self) -> None:
        self._scans: list[Scan] = []
        self._is_taken = False

    def add(self, scan: Scan, T_odom_lidar: Pose) -> None:
        """Keep a scan, turned but not moved."""
        if not self._is_taken and len(self._scans) < _CHECKED:
            points = scan.points @ T_odom_lidar[:3, :3].T.astype(np.float32)
            self._scans.append(Scan(points))

    def take(self) -> tuple[Scan, ...]:
        """Return the scans once they are complete; nothing afterwards."""
        if self._is_taken or len(self._scans) < _CHECKED:
            return ()
        taken, self._scans, self._is_taken = tuple(self._scans), [], True
        return taken


@dataclass(frozen=True)
class Answer:
    """The result of a query.

    Attributes
    ----------
    job : Job
    view : View or None
        None if it could not be made.
    accepted : bool or None
        Whether the best candidate is; None if nothing was searched: only the track was checked.
    times_ms : dict
        Milliseconds of each stage.
    position : (3,) float64 or None
        Of the sensor at the best candidate, in the map.
    centroids : (K, 3) float64
        Of the map's segments that agree with it.
    candidates : tuple of (T_map_base, probability)
        Places that were found, the most probable first.
    message : str
        Why no pose is accepted; "" if one is.
    hint : str
        Fault of the job's scans; "" if none is known.
    """

    job: Job
    view: View | None
    accepted: bool | None = None
    times_ms: Mapping[str, float] = field(default_factory=dict)
    position: Float64 | None = None
    centroids: Float64 = field(default_factory=lambda: np.empty((0, 3)))
    candidates: tuple[tuple[Pose, float], ...] = ()
    message: str = ""
    hint: str = ""

    def matches(self, frame: str) -> MatchesReply | None:
        """Return the matches to show; None if nothing was searched or found."""
        if self.position is None or self.accepted is None:
            return None
        stamp = self.job.asked.stamp
        return MatchesReply(stamp, frame, self.position, self.centroids, self.accepted)


def make(job: Job) -> Answer:
    """Make a query."""
    found: list[tuple[Any, Any, Localization]] = []
    try:
        view = job.core.ask(job.asked, callback=lambda *all_of: found.append(all_of))
    except SeglocError as error:
        return Answer(job, None, message=str(error))
    if not found:
        return Answer(job, view)
    query, search, result = found[-1]
    position, centroids = matched_segments(query, search)
    message = "" if result.localized else result.message
    T_sensor_base = geometry.inverse(job.core.T_base_sensor)
    candidates = tuple(
        (place.T_map_sensor @ T_sensor_base, place.probability) for place in result.places
    )
    hint = _hint(job.scans) if message else ""
    accepted, times_ms = search.reason is None, result.times_ms
    return Answer(job, view, accepted, times_ms, position, centroids, candidates, message, hint)


def _hint(scans: tuple[Scan, ...]) -> str:
    """Return the fault of scans in the axes of the odometry: their unit or its axes."""
    for finding in scan_findings(scans, posed=True):
        if finding.fault in _AXES and finding.wrong:
            return f"in the odometry's axes {finding.what}: {_Z_UP}"
        if finding.wrong:
            return str(finding)
    return ""
