"""Trace of one query: the result of each stage."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from .. import geometry
from ..likelihood import FEATURES, Count, Model, Observation
from ..localization import Localization, Reason
from ..localizer import Localizer
from ..map.segment_map import SegmentMap
from ..pipeline import Search
from ..prior import Prior
from ..proposals.proposer import Query
from ..system.stage_times import StageTimes
from ..system.text import counted
from ..types import Bools, Float32, Int64, LocalCloud, Pose, Segments

_BEYOND_M = 2.0  # margin of map points around a query


@dataclass(frozen=True)
class Part:
    """One feature of the confidence.

    Attributes
    ----------
    name : str
        Name in the model.
    log_odds : float
        Contribution to the log-odds of the pose.
    words : str
        Measured value, and that of the best other place.
    """

    name: str
    log_odds: float
    words: str


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
    constant : float
        Prior log-odds, to which the parts are added.
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
    constant: float
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
        on_map=_on_map(localizer, found.prior_map, query.scene.structure, T),
        constant=-likelihood.model.none,
        parts=() if best is None else _parts(likelihood.model, found),
    )


def _pairs(
    localizer: Localizer, query: Query, found: Search, T_map_local: Pose | None
) -> tuple[Int64, Bools]:
    """Return one match per segment, and whether it fits the pose."""
    matches, config = found.matches, localizer.config.pose
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


def _on_map(
    localizer: Localizer, prior_map: SegmentMap, points: Float32, T_map_local: Pose | None
) -> Bools:
    """Return which points of a query lie on the map's cloud at a pose."""
    if T_map_local is None or not len(points) or not len(prior_map.cloud):
        return np.zeros(len(points), dtype=bool)
    placed = geometry.transform(T_map_local, points) - prior_map.origin
    low, high = placed.min(axis=0) - _BEYOND_M, placed.max(axis=0) + _BEYOND_M
    near = ((prior_map.cloud > low) & (prior_map.cloud < high)).all(axis=1)
    if not near.any():
        return np.zeros(len(points), dtype=bool)
    radius = localizer.config.verification.overlap_radius
    distances, _ = cKDTree(prior_map.cloud[near]).query(placed, distance_upper_bound=radius)
    return np.asarray(np.isfinite(distances))


def _parts(model: Model, found: Search) -> tuple[Part, ...]:
    """Return the contribution of each feature to the log-ratio of the most probable place."""
    best = found.posterior.best
    assert best is not None
    fit = next(fit for fit in found.fits if fit.T_map_local is best.T_map_local)
    words = _measured(fit, [other for other in found.fits if other is not fit])
    return tuple(
        Part(name, model.weights[name] * feature, words[name])
        for name, feature in zip(FEATURES, best.features, strict=True)
    )


def _measured(fit: Observation, others: Sequence[Observation]) -> dict[str, str]:
    """Describe the measurement behind each feature."""
    seen, flush, ground = "no map points in view", "no walls to compare", "no ground to compare"
    if (share := fit.seen.share) is not None:
        seen = f"{share:.0%} of the map points in view are seen"
    if (share := fit.flush.share) is not None:
        flush = f"{share:.0%} of the wall points are on the map's walls"
    if (share := fit.ground.share) is not None:
        ground = f"{share:.0%} of the ground lies on the map's ground"
    free = f"{fit.inside.hits} of {fit.inside.of} patches are in free space of the map"
    here = fit.walls.weight > 0
    told = [int((here & (other.walls.weight > 0)).sum()) for other in others]
    walls = f"{int(here.sum())} patches of walls compared"
    known = fit.known.on + fit.known.off
    lies = f"{fit.known.on} of {known} points in known space are on the map"
    return {
        "flush": flush,
        "ground": ground,
        "free_space": free,
        "inliers_over_rival": f"{fit.inliers} segments, elsewhere "
        f"{max([0, *(other.inliers for other in others)])}",
        "known_over_rival": f"{lies}, {_elsewhere([_on(other) for other in others])}",
        "seen_over_rival": f"{seen}, {_elsewhere([other.seen.share for other in others])}",
        "walls_over_rival": f"{walls}, {min(told)} with each other place" if told else walls,
    }


def _on(fit: Observation) -> float | None:
    """Return the share of the points in known space that are on the map."""
    return Count(fit.known.on, fit.known.on + fit.known.off).share


def _elsewhere(shares: Sequence[float | None]) -> str:
    known = [share for share in shares if share is not None]
    return f"{max(known):.0%} elsewhere" if known else "nothing to compare elsewhere"


def steps(trace: Trace) -> list[tuple[str, str]]:
    """Return name and outcome of each stage."""
    result, sizes = trace.result, trace.segments.sizes
    counts = result.counts
    tilt = math.degrees(math.acos(float(np.clip(trace.T_local_sensor[2, 2], -1.0, 1.0))))
    smallest = f", of {sizes.min()} to {sizes.max()} points" if len(sizes) else ""
    scans = counted(counts["scans"], "scans")
    found = [
        ("cloud", f"{counts['points']} points of {scans}; tilt {tilt:.1f} deg, {result.attitude}"),
        ("ground", f"{len(trace.structure)} voxels above the ground"),
        ("segments", f"{counts['segments']}{smallest}"),
        ("matches", f"{counts['matches']} candidate matches with segments of the map"),
        ("poses", _poses(trace)),
    ]
    if trace.T_map_local is not None:
        found.append(("overlap", f"{result.overlap:.0%} of the cloud lies on the map there"))
    other = result.places[1] if len(result.places) > 1 else None
    if other is not None and trace.T_map_local is not None:
        T = trace.T_map_local @ trace.T_local_sensor
        away = float(np.linalg.norm(other.T_map_sensor[:3, 3] - T[:3, 3]))
        turn = math.degrees(geometry.rotation_angle(geometry.inverse(T) @ other.T_map_sensor))
        agree = counted(other.inliers, "segments", "agree")
        found.append(
            (
                "runner-up",
                f"{away:.1f} m away, turned by {turn:.0f} deg: {agree}, "
                f"overlap {other.overlap:.0%}",
            )
        )
    return found


def _poses(trace: Trace) -> str:
    count = trace.result.counts["candidates"]
    if not count or trace.T_map_local is None:
        return "no pose with agreeing matches"
    x, y, z = trace.T_map_local[:3, 3]
    agree = counted(trace.result.inliers, "segments", "agree")
    best = f"best at {x:.1f}, {y:.1f}, {z:.1f} m, proposed by {trace.result.proposer}: {agree}"
    return f"{counted(count, 'candidates')}; {best}"


def pose_text(T: Pose) -> str:
    """Format position and heading with units."""
    x, y, z = (float(v) for v in T[:3, 3])
    yaw = math.degrees(geometry.heading(T))
    return f"x {x:.2f}, y {y:.2f}, z {z:.2f} m, yaw {yaw:.1f} deg"


def summarize(trace: Trace) -> str:
    """Return one sentence on the result, with advice if there is no pose."""
    result = trace.result
    if result.localized:
        return f"localized at {pose_text(result.T_map_sensor)} (confidence {result.confidence:.2f})"
    assert result.reason is not None
    if result.reason is Reason.TOO_UNCERTAIN:
        return f"not localized, {result.message}: {_uncertain(trace)}"
    return f"not localized, {result.message}: {result.reason.likely_cause}; {result.reason.remedy}"


def _uncertain(trace: Trace) -> str:
    """Return advice on a best pose that was not accepted."""
    if not trace.parts:
        return "the evidence for any pose is too weak"
    least = min(trace.parts, key=lambda part: part.log_odds)
    return f"a place may fit; accumulate more scans. The weakest part is: {least.words}"
