"""Intermediate results of a query, and its answer."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from . import geometry
from .frontend.surfaces import AGAINST_GRAVITY, GRAVITY_REMEDY, is_upside_down, slides
from .likelihood import Observation, Posterior, Trial
from .localization import Localization, Localized, NotLocalized, Place, Reason
from .map.segment_map import SegmentMap
from .prior import Prior
from .proposals.proposer import Query
from .types import Candidate, LocalCloud, Matches, Pose

NOT_FLAT = (
    "unknown attitude (too few flat surfaces to estimate roll and pitch, and not found as a level "
    "sensor: pass gravity or a pose)"
)

_OF_THE_QUERY = (
    Reason.NO_POINTS,
    Reason.NO_SEGMENTS,
    Reason.AMBIGUOUS,
    Reason.UNKNOWN_ATTITUDE,
    Reason.TOO_LITTLE_IN_VIEW,
)
"""Reasons that do not contradict the prior."""

_ALIGNED_M, _ARM_M = 2.0, 10.0
"""Largest motion of a candidate by alignment [m]; arm at which rotations are measured [m]."""


@dataclass(frozen=True)
class Agreed:
    """Matches of segments, and the poses on which they agree.

    Attributes
    ----------
    count : int
        Matches before pruning.
    matches : Matches
    candidates : list of Candidate
    inliers : callable
        Counts the segments that agree with a pose T_map_local.
    """

    count: int
    matches: Matches
    candidates: list[Candidate]
    inliers: Callable[[Pose], int]


@dataclass(frozen=True)
class Search:
    """Result of one search, with all intermediate results.

    Attributes
    ----------
    prior_map : SegmentMap
        Map that was searched; of tiles, those that were.
    proposed : int
        Matches before pruning.
    matches : Matches
    candidates : list of Candidate
        T_map_local, at different places, before verification.
    posterior : Posterior
    reason : Reason or None
        Why the most probable place is rejected; None if it is accepted.
    message : str
        The reason as a sentence with figures; "" if accepted.
    places : sequence of Trial
        Places under consideration, and what was measured of each.
    near : Prior or None
        Prior that restricted the search; None for the whole map.
    """

    prior_map: SegmentMap
    proposed: int
    matches: Matches
    candidates: list[Candidate]
    posterior: Posterior
    reason: Reason | None
    message: str
    places: Sequence[Trial] = ()
    near: Prior | None = None

    @classmethod
    def of(
        cls,
        prior_map: SegmentMap,
        agreed: Agreed,
        candidates: list[Candidate],
        posterior: Posterior,
        places: Sequence[Trial],
        min_confidence: float,
        near: Prior | None = None,
    ) -> Search:
        """Return the result of a posterior."""
        reason, message = posterior.reason(min_confidence), posterior.message(min_confidence)
        if reason is None and near and not near.holds(T := posterior.places[0].T_map_local):
            x, y, z = T[:3, 3]
            reason, message = Reason.NOT_NEAR_PRIOR, f"what fits is at {x:.1f}, {y:.1f}, {z:.1f}"
        where = prior_map, agreed.count, agreed.matches, candidates
        return cls(*where, posterior, reason, message, tuple(places), near)

    @property
    def fits(self) -> list[Observation]:
        """Fits at the places of the posterior."""
        return [place.fit for place in self.places if place.fit is not None]

    @property
    def proposer(self) -> str | None:
        """The proposer of the best pose; if several proposed it, segments come first.

        None without a best pose.
        """
        best = self.posterior.best
        if best is None or not self.candidates:
            return None

        def order(candidate: Candidate) -> tuple[float, bool]:
            T = geometry.inverse(best.T_map_local) @ candidate.T_map_local
            moved_m = float(np.linalg.norm(T[:3, 3])) + _ARM_M * geometry.rotation_angle(T)
            return max(0.0, moved_m - _ALIGNED_M), candidate.proposer != Candidate.proposer

        return min(self.candidates, key=order).proposer

    def counts(self, query: Query) -> dict[str, int]:
        """Return the number of items of each stage; a refusal is explained by them."""
        scene = query.scene
        return {
            "scans": query.cloud.num_scans,
            "points": len(query.cloud.points),
            "segments": scene.num_segments if self.reason is None else len(scene.segments),
            "proposed": self.proposed,
            "matches": len(self.matches),
            "candidates": len(self.candidates),
        }


def answer(
    query: Query, search: Search, times_ms: Mapping[str, float], radius_m: float
) -> Localization:
    """Return the answer of a query; a failure is explained by faults of scans, map or prior.

    Parameters
    ----------
    query : Query
    search : Search
    times_ms : dict
        Time of each stage [ms].
    radius_m : float
        Range of the query's points [m].
    """
    posterior, T_local_sensor = search.posterior, query.cloud.T_local_sensor
    best, counts = posterior.best, search.counts(query)
    common: dict[str, Any] = {
        "counts": counts,
        "times_ms": times_ms,
        "stamp": query.cloud.stamp,
        "attitude": query.cloud.attitude,
        "confidence": posterior.confidence,
        "places": tuple(
            Place(place.T_map_local @ T_local_sensor, p, place.inliers, place.overlap)
            for place, p in zip(posterior.places, posterior.probabilities, strict=True)
        ),
        "not_in_map": posterior.not_in_map,
        "proposer": search.proposer,
    }
    if best is not None:
        common |= {name: getattr(best, name) for name in ("inliers", "overlap", "seen", "rmse")}
    if search.reason is not None or best is None:
        reason, message = _why(search, query, counts, radius_m)
        return NotLocalized(reason=reason, message=message, **common)
    return Localized(
        T_map_sensor=best.T_map_local @ T_local_sensor,
        covariance=geometry.rotated_covariance(best.covariance, T_local_sensor),
        **common,
    )


def _fault(search: Search, cloud: LocalCloud, reason: Reason, radius_m: float) -> str:
    """Return the fault of the scans, the map or the prior behind a failure; "" if none is known."""
    prior_map, near = search.prior_map, search.near
    if reason in (Reason.NO_POINTS, Reason.NO_SEGMENTS) and cloud.fault:
        return cloud.fault
    if not len(prior_map) and not len(prior_map.cloud):
        return "the map has no segments, and 0 points"
    if near is not None and reason is Reason.NOT_NEAR_PRIOR:
        return _off_the_map(near, prior_map, radius_m)
    return ""


def _is_inverted(cloud: LocalCloud) -> bool:
    """Return whether the given vertical turns a scan over, and its ground contradicts that."""
    if cloud.num_scans > 1 or cloud.T_local_sensor[2, 2] > 0:
        return False
    return is_upside_down((cloud.points - cloud.T_local_sensor[:3, 3]).astype(np.float32))


def _off_the_map(near: Prior, prior_map: SegmentMap, reach_m: float) -> str:
    """Explain how far a prior lies outside of the map; "" if it is inside."""
    if near.height_m is not None and len(heights := prior_map.trajectory[:, 2, 3]):
        low, high = float(heights.min()), float(heights.max())
        if max(low - near.height_m, near.height_m - high) > near.height_tolerance_m:
            return f"the sensor of the map was at heights from {low:.1f} to {high:.1f} m"
    places = prior_map.centroids if len(prior_map) else prior_map.trajectory[:, :3, 3]
    if not len(places) or len(near.rows(places, reach_m)):
        return ""
    x, y = np.asarray(near.position)[:2]
    away = float(np.hypot(*(places[:, :2] - (x, y)).T).min())
    low, high = places.min(axis=0), places.max(axis=0)
    spans = f"x {low[0]:.0f} to {high[0]:.0f}, y {low[1]:.0f} to {high[1]:.0f}"
    return f"the map is {away:.0f} m from there and spans {spans}: is the prior in its frame?"


def _why(
    search: Search, query: Query, counts: Mapping[str, int], radius_m: float
) -> tuple[Reason, str]:
    """Return the reason of the first stage without results, or else the posterior's."""
    (reason, message), near = _why_anywhere(search, query, counts), search.near
    if near is not None and reason not in _OF_THE_QUERY:
        reason = Reason.NOT_NEAR_PRIOR
    fault = _fault(search, query.cloud, reason, radius_m)
    if reason is Reason.NOT_NEAR_PRIOR:
        return reason, f"{reason} ({near}: {fault or message})"
    return reason, f"{reason} ({fault})" if fault else message


def _why_anywhere(search: Search, query: Query, counts: Mapping[str, int]) -> tuple[Reason, str]:
    for what, reason in (
        ("points", Reason.NO_POINTS),
        ("segments", Reason.NO_SEGMENTS),
        ("matches", Reason.NO_MATCHES),
    ):
        if counts[what] == 0:
            return reason, reason.value
    if _is_inverted(query.cloud):
        reason = Reason.UNKNOWN_ATTITUDE
        return reason, f"{reason} ({AGAINST_GRAVITY}: {GRAVITY_REMEDY})"
    if slides(query.scene.structure):
        reason = Reason.TOO_LITTLE_IN_VIEW
        return reason, f"{reason} (all walls face one way: nothing across them)"
    if search.reason is not Reason.AMBIGUOUS and query.cloud.attitude == "assumed":
        return Reason.UNKNOWN_ATTITUDE, NOT_FLAT
    assert search.reason is not None  # of a query that is not localized
    return search.reason, search.message
