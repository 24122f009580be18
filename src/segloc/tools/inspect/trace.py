"""Trace of one query: the result of each stage."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from scipy.spatial import cKDTree

from ... import geometry
from ...likelihood.observation import OVERLAP_M
from ...localization import Localization, Reason
from ...localizer import Localizer
from ...map.segment_map import SegmentMap
from ...pipeline import Search
from ...prior import Prior
from ...proposals.first_sight import FirstSight
from ...proposals.proposer import Query
from ...system.stage_times import StageTimes
from ...system.text import quantity
from ...types import Bools, Float32, Int64, LocalCloud, Pose, Segments
from .evidence import Part, evidence_rows, parts_of, prior_log_odds, runner_up_rows

Tables: TypeAlias = tuple[tuple[str, tuple[tuple[str, str, str], ...]], ...]
"""Titles, each with rows of log-odds, label and words."""

_BEYOND_M = 2.0  # margin of map points around a query


@dataclass(frozen=True)
class Trace:
    """One query, stage by stage. Points are in the local frame, float32 [m].

    Attributes
    ----------
    name : str
    result : Localization
    T_local_sensor : (4, 4) float64
    ground, structure : (G, 3), (S, 3) float32
        Thinned cloud: ground, and points above it.
    segments : Segments
    pairs : (K, 2) int64
        One match per matched segment, an inlier if there is one: its row, and that of the map's
        segment.
    inliers : (K,) bool
        Which of them fit the best pose.
    prior_map : SegmentMap
        Map that was searched; of tiles, those that were.
    T_map_local : (4, 4) float64 or None
        The best pose, accepted or not.
    on_map : (S,) bool
        Which points of the structure have a map point nearby at the best pose.
    prior : float
        Log-odds before anything is measured, to which those of the parts are added.
    parts : tuple of Part
        Empty if no pose was scored.
    """

    name: str
    result: Localization
    T_local_sensor: Pose
    ground: Float32
    structure: Float32
    segments: Segments
    pairs: Int64
    inliers: Bools
    prior_map: SegmentMap
    T_map_local: Pose | None
    on_map: Bools
    prior: float
    parts: tuple[Part, ...]


def trace(
    localizer: Localizer,
    cloud: LocalCloud,
    name: str = "query",
    times: StageTimes | None = None,
    near: Prior | None = None,
) -> Trace:
    """Localize a local cloud like :meth:`Localizer.localize`, and return the stages."""
    times = times or StageTimes(localizer.clock)
    query = localizer.describe(cloud, times)
    found, result = localizer.answer(query, times, near=near)
    best = found.posterior.best
    T = None if best is None else best.T_map_local
    pairs, inliers = _pairs(localizer, query, found, T)
    likelihood = localizer.likelihood
    return Trace(
        name=name,
        result=result,
        T_local_sensor=cloud.T_local_sensor,
        ground=query.scene.ground,
        structure=query.scene.structure,
        segments=query.scene.segments,
        pairs=pairs,
        inliers=inliers,
        prior_map=found.prior_map,
        T_map_local=T,
        on_map=_on_map(found.prior_map, query.scene.structure, T),
        prior=prior_log_odds(likelihood.model, found.posterior.best),
        parts=() if best is None else parts_of(likelihood.model, found),
    )


def _pairs(
    localizer: Localizer, query: Query, found: Search, T_map_local: Pose | None
) -> tuple[Int64, Bools]:
    """Return one match per segment, and whether it fits the pose."""
    matches, config = found.matches, localizer.config.pose
    if found.proposer == FirstSight.name:  # decided without them
        nearest = localizer.matcher.match(query.descriptors)
        matches = localizer.matcher.prune(query.descriptors, nearest)
    if not len(matches):
        return np.empty((0, 2), np.int64), np.empty(0, bool)
    fits = np.zeros(len(matches), dtype=bool)
    if T_map_local is not None:
        centroids = geometry.transform(T_map_local, query.scene.segments.centroids)
        x, y, z = (found.prior_map.centroids[matches.map] - centroids[matches.query]).T
        fits = x**2 + y**2 < config.inlier_tolerance**2
        fits &= np.abs(z) < config.height_tolerance
    order = np.lexsort((np.arange(len(matches)), ~fits))  # inliers first, then by quality
    _, first = np.unique(matches.query[order], return_index=True)
    chosen = order[first]
    return np.stack([matches.query[chosen], matches.map[chosen]], axis=1), fits[chosen]


def _on_map(prior_map: SegmentMap, points: Float32, T_map_local: Pose | None) -> Bools:
    """Return which points of a query lie on the map's cloud at a pose."""
    if T_map_local is None or not len(points) or not len(prior_map.cloud):
        return np.zeros(len(points), dtype=bool)
    placed = geometry.transform(T_map_local, points) - prior_map.origin
    low, high = placed.min(axis=0) - _BEYOND_M, placed.max(axis=0) + _BEYOND_M
    near = ((prior_map.cloud > low) & (prior_map.cloud < high)).all(axis=1)
    if not near.any():
        return np.zeros(len(points), dtype=bool)
    distances, _ = cKDTree(prior_map.cloud[near]).query(placed, distance_upper_bound=OVERLAP_M)
    return np.asarray(np.isfinite(distances))


def steps(trace: Trace) -> list[tuple[str, str]]:
    """Return name and outcome of each stage."""
    result, sizes = trace.result, trace.segments.sizes
    counts = result.counts
    tilt = math.degrees(math.acos(float(np.clip(trace.T_local_sensor[2, 2], -1.0, 1.0))))
    smallest = f", of {sizes.min()} to {sizes.max()} points" if len(sizes) else ""
    scans = quantity(counts["scans"], "scans")
    found = [
        ("cloud", f"{counts['points']} points of {scans}; tilt {tilt:.1f} deg, {result.attitude}"),
        ("ground", f"{len(trace.structure)} voxels above the ground"),
        ("segments", f"{len(trace.segments)}{smallest}"),
        ("matches", _matches(result)),
        ("poses", _poses(trace)),
    ]
    if trace.T_map_local is not None:
        found.append(("runner-up", _runner_up(trace, trace.T_map_local @ trace.T_local_sensor)))
    return found


def _matches(result: Localization) -> str:
    if result.proposer == FirstSight.name:
        return "not needed: no other place of the map looks like this view"
    return f"{result.counts['matches']} candidate matches with segments of the map"


def _runner_up(trace: Trace, T_map_sensor: Pose) -> str:
    if len(trace.result.places) < 2:
        return "none: no other place was likely enough to be measured in full"
    other = trace.result.places[1]
    away = float(np.linalg.norm(other.T_map_sensor[:3, 3] - T_map_sensor[:3, 3]))
    turn = geometry.rotation_angle(geometry.inverse(T_map_sensor) @ other.T_map_sensor)
    p = f"probability {other.probability:.2f}"
    return f"{away:.1f} m away, turned by {math.degrees(turn):.0f} deg, {p}"


def _poses(trace: Trace) -> str:
    count = trace.result.counts["candidates"]
    if not count or trace.T_map_local is None:
        return "no pose with agreeing matches"
    x, y, z = trace.T_map_local[:3, 3]
    best = f"best at {x:.1f}, {y:.1f}, {z:.1f} m, proposed by {trace.result.proposer}"
    return f"{quantity(count, 'candidates')}; {best}"


def confidence_tables(trace: Trace) -> Tables:
    """Return the evidence for and against the best pose, and over the runner-up, in log-odds."""
    if not trace.parts:
        return ()
    groups = list(evidence_rows(trace.prior, trace.parts))
    if rows := runner_up_rows(trace.parts):
        groups.append(("over the runner-up", rows))
    return tuple(
        (title, tuple((f"{log_odds:+.1f}", label, words) for log_odds, label, words in rows))
        for title, rows in groups
    )


def summarize(trace: Trace) -> str:
    """Return one line on the result, with advice if there is no pose."""
    result = trace.result
    if result.localized:
        return str(result)
    assert result.reason is not None
    message, cause = result.message, result.reason.likely_cause
    if result.reason in (Reason.NOT_IN_MAP, Reason.TOO_UNCERTAIN) and trace.parts:
        message = message.split(": ")[0]  # the evidence has the rest
    if result.reason is Reason.TOO_UNCERTAIN and trace.parts:
        least = min(trace.parts, key=lambda part: part.log_odds)
        cause = f"the best pose may be right; most against it: {least.words}"
    advice = result.reason.remedy
    return f"not localized: {message}. {cause[:1].upper()}{cause[1:]}. What helps: {advice}."
