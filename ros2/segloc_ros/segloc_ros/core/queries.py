"""Queries: returned by the core, made in another thread, and applied."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from segloc import Localization, Scan, SeglocError, geometry
from segloc.doctor.finding import Fault
from segloc.doctor.scan_faults import scan_findings
from segloc.live import LiveCore
from segloc.pipeline import Search
from segloc.proposals.proposer import Query
from segloc.tracker import QueryRequest
from segloc.tracking.belief import View
from segloc.types import Float64, Pose

from .replies import MatchesReply

_AGREE_M = 2.0
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
    search : Search or None
        None if nothing was searched: only the track was checked.
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
    search: Search | None = None
    times_ms: Mapping[str, float] = field(default_factory=dict)
    position: Float64 | None = None
    centroids: Float64 = field(default_factory=lambda: np.empty((0, 3)))
    candidates: tuple[tuple[Pose, float], ...] = ()
    message: str = ""
    hint: str = ""

    def matches(self, frame: str) -> MatchesReply | None:
        """Return the matches to show; None if nothing was searched or found."""
        if self.position is None or self.search is None:
            return None
        accepted = self.search.reason is None
        return MatchesReply(self.job.asked.stamp, frame, self.position, self.centroids, accepted)


def make(job: Job) -> Answer:
    """Make a query."""
    found: list[tuple[Query, Search, Localization]] = []
    try:
        view = job.core.ask(job.asked, callback=lambda *all_of: found.append(all_of))
    except SeglocError as error:
        return Answer(job, None, message=str(error))
    if not found:
        return Answer(job, view)
    query, search, result = found[-1]
    position, centroids = None, np.empty((0, 3))
    if search.posterior.best is not None:
        T = search.posterior.best.T_map_local
        position = (T @ query.cloud.T_local_sensor)[:3, 3]
        centroids = _agreeing(query, search)
    message = "" if result.localized else result.message
    T_sensor_base = geometry.inverse(job.core.T_base_sensor)
    candidates = tuple(
        (place.T_map_sensor @ T_sensor_base, place.probability) for place in result.places
    )
    hint = _hint(job.scans) if message else ""
    times_ms = result.times_ms
    return Answer(job, view, search, times_ms, position, centroids, candidates, message, hint)


def _hint(scans: tuple[Scan, ...]) -> str:
    """Return the fault of scans in the axes of the odometry: their unit or its axes."""
    for finding in scan_findings(scans, posed=True):
        if finding.fault in _AXES and finding.wrong:
            return f"in the odometry's axes {finding.what}: {_Z_UP}"
        if finding.wrong:
            return str(finding)
    return ""


def _agreeing(query: Query, search: Search) -> Float64:
    """Return the centroids of the map's segments that matches put where they are, (K, 3)."""
    best, matches = search.posterior.best, search.matches
    if best is None or not len(matches):
        return np.empty((0, 3))
    ours = geometry.transform(best.T_map_local, query.scene.segments.centroids[matches.query])
    theirs = np.asarray(search.prior_map.centroids[matches.map], np.float64)
    return np.unique(theirs[np.linalg.norm(ours - theirs, axis=1) < _AGREE_M], axis=0)
