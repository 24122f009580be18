"""Intermediate results of a query, and the answer that its verdict gives."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from . import geometry
from .frontend.reach import reach_fault
from .likelihood import RefinedScore, Score, Verdict
from .localization import Localization, Localized, NotLocalized, Reason, RunnerUp
from .map.segment_map import SegmentMap
from .prior import Prior
from .proposals.proposer import Query
from .types import Candidate, LocalCloud, Matches, Pose, Scan

NOT_FLAT = (
    "unknown attitude (too little that is flat is in view to tell how the sensor stands, and taken "
    "as level it is not found: give its gravity or a pose)"
)

_OF_THE_QUERY = (Reason.NO_POINTS, Reason.NO_SEGMENTS, Reason.AMBIGUOUS, Reason.UNKNOWN_ATTITUDE)
"""Reasons that say nothing against the prior."""

_ALIGNED_M, _ARM_M = 2.0, 10.0
"""How far alignment moves a candidate [m]; rotations are measured at the end of an arm [m]."""


@dataclass(frozen=True)
class Search:
    """What was found for one query, with all that was considered.

    Attributes
    ----------
    proposed : int
        Matches before pruning.
    matches : Matches
    candidates : list of Candidate
        T_map_local, best first, at different places, before verification.
    verdict : Verdict
    by_segments : bool
        Whether the candidates come from matches alone.
    near : Prior or None
        Where alone was searched; None where all over the map.
    """

    proposed: int
    matches: Matches
    candidates: list[Candidate]
    verdict: Verdict
    by_segments: bool = True
    near: Prior | None = None

    def or_better(self, other: Search, decisive: bool) -> Search:
        """This, or the next attempt, which had more neighbours: the one with the better verdict.

        Among more neighbours more agree by chance, and the confidence was fitted on fewer: where
        the verdict on the other was put off, it counts alone only if its segments are ``decisive``;
        else its poses are tried, too.
        """
        if other.verdict.is_judged:
            return other if other.verdict.rank > self.verdict.rank else self
        if decisive and not self.verdict.is_judged:
            return other
        return replace(self, candidates=[*self.candidates, *other.candidates])

    def or_surer(self, found: Search) -> Search:
        """The later search, unless this one is surer that there is nothing."""
        judged = self.verdict.reason is None or not self.verdict.is_judged
        return found if judged or found.verdict.rank > self.verdict.rank else self

    @property
    def proposer(self) -> str | None:
        """The proposer of the best pose: of candidates that are moved to it, segments come first.

        None if there is no best pose.
        """
        best = self.verdict.best
        if best is None or not self.candidates:
            return None

        def order(candidate: Candidate) -> tuple[float, bool]:
            T = geometry.inverse(best.T_map_local) @ candidate.T_map_local
            moved_m = float(np.linalg.norm(T[:3, 3])) + _ARM_M * geometry.rotation_angle(T)
            return max(0.0, moved_m - _ALIGNED_M), candidate.proposer != Candidate.proposer

        return min(self.candidates, key=order).proposer

    def counts(self, query: Query) -> dict[str, int]:
        """How many items each stage produced."""
        return {
            "scans": query.cloud.num_scans,
            "points": len(query.cloud.points),
            "segments": len(query.scene.segments),
            "proposed": self.proposed,
            "matches": len(self.matches),
            "candidates": len(self.candidates),
        }


def answer(
    cloud: LocalCloud,
    verdict: Verdict,
    counts: Mapping[str, int],
    times_ms: Mapping[str, float],
    near: Prior | None = None,
    proposer: str | None = None,
) -> Localization:
    """What is told of a query.

    Parameters
    ----------
    cloud : LocalCloud
        The query.
    verdict : Verdict
    counts : dict
        How many items each stage produced.
    times_ms : dict
        Milliseconds each stage took.
    near : Prior, optional
        Where it was looked for.
    proposer : str, optional
        What found the best pose.
    """
    best, T_local_sensor = verdict.best, cloud.T_local_sensor
    common: dict[str, Any] = {
        "counts": counts,
        "times_ms": times_ms,
        "stamp": cloud.stamp,
        "attitude": cloud.attitude,
        "confidence": verdict.confidence,
        "runner_up": _runner_up(verdict, T_local_sensor),
        "proposer": proposer,
        **_measured(verdict),
    }
    if verdict.reason is not None or best is None:
        return NotLocalized(**_why(verdict, cloud, counts, near), **common)
    covariance = best.covariance if isinstance(best, RefinedScore) else None
    return Localized(
        T_map_sensor=best.T_map_local @ T_local_sensor,
        covariance=geometry.rotated_covariance(covariance, T_local_sensor),
        **common,
    )


def explained(
    result: NotLocalized,
    scans: Sequence[Scan],
    prior_map: SegmentMap,
    radius_m: float,
    near: Prior | None,
) -> NotLocalized:
    """Add what is wrong with the scans, the map or the prior, where that is why nothing is found.

    Parameters
    ----------
    result : NotLocalized
    scans : list of Scan
        The query; empty where its points are not at hand as they were taken.
    prior_map : SegmentMap
    radius_m : float
        Points farther from the sensor are not in the query.
    near : Prior or None
        Where it was looked for.
    """
    why = ""
    if result.reason in (Reason.NO_POINTS, Reason.NO_SEGMENTS) and scans:
        why = reach_fault(scans, radius_m)
    elif not len(prior_map):
        why = f"the map has no segments, and {len(prior_map.cloud)} points"
    elif near is not None and result.reason is Reason.NOT_NEAR_PRIOR:
        why = _off_the_map(near, prior_map, radius_m)
    if not why:
        return result
    said = f"{near}: {why}" if result.reason is Reason.NOT_NEAR_PRIOR else why
    return replace(result, message=f"{result.reason} ({said})")


def _off_the_map(near: Prior, prior_map: SegmentMap, reach_m: float) -> str:
    """How far a prior lies outside of all that the map shows; "" if it does not."""
    if len(near.rows(prior_map.centroids, reach_m)):
        return ""
    x, y = np.asarray(near.position)[:2]
    away = float(np.hypot(*(prior_map.centroids[:, :2] - (x, y)).T).min())
    low, high = prior_map.centroids.min(axis=0), prior_map.centroids.max(axis=0)
    spans = f"x {low[0]:.0f} to {high[0]:.0f}, y {low[1]:.0f} to {high[1]:.0f}"
    return f"the map is {away:.0f} m from there, it spans {spans}: is the prior in its frame?"


def _measured(verdict: Verdict) -> dict[str, float | None]:
    """What was measured of the best candidate."""
    best = verdict.best
    if best is None:
        return {}
    evidence = verdict.evidence
    return {
        "inliers": best.inliers,
        "overlap": best.overlap,
        "seen": best.seen if isinstance(best, Score) else None,
        "inlier_ratio": None if evidence is None else evidence.inlier_ratio,
        "rmse": best.rmse,
    }


def _why(
    verdict: Verdict, cloud: LocalCloud, counts: Mapping[str, int], near: Prior | None
) -> dict[str, Any]:
    """The first stage that was left with nothing, or else what the verdict says."""
    why = _why_anywhere(verdict, cloud, counts)
    if near is None or why["reason"] in _OF_THE_QUERY:
        return why
    message = f"{Reason.NOT_NEAR_PRIOR} ({near}: {why['message']})"
    return {"reason": Reason.NOT_NEAR_PRIOR, "message": message}


def _why_anywhere(verdict: Verdict, cloud: LocalCloud, counts: Mapping[str, int]) -> dict[str, Any]:
    for what, reason in (
        ("points", Reason.NO_POINTS),
        ("segments", Reason.NO_SEGMENTS),
        ("matches", Reason.NO_MATCHES),
    ):
        if counts[what] == 0:
            return {"reason": reason, "message": reason.value}
    if verdict.undecided and cloud.attitude == "assumed":
        return {"reason": Reason.UNKNOWN_ATTITUDE, "message": NOT_FLAT}
    return {"reason": verdict.reason, "message": verdict.message}


def _runner_up(verdict: Verdict, T_local_sensor: Pose) -> RunnerUp | None:
    other = verdict.runner_up
    if other is None:
        return None
    return RunnerUp(other.T_map_local @ T_local_sensor, other.inliers, other.overlap)
