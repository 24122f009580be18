"""What is known of a candidate pose, stage by stage: each type holds what its stage has measured.

``Candidate`` (from the pose estimator) -> ``RankedCandidate`` (rough overlap, all candidates) ->
``CoarseScore`` (and what is seen, the few that are judged) -> ``RefinedScore`` (after ICP) ->
``Evidence`` (compared with its rivals) -> ``Verdict``.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

from ..localization import Reason
from ..types import Candidate, Float64, Pose

SETTLED_INLIERS, SETTLED_EVIDENCE = 15, 15.0
"""So many inliers, which say so much against those of the best different place, are no chance, and
no part of a place that repeats itself: there, its other parts would have as many. Set by hand,
beyond all wrong poses of the calibration."""
DECISIVE_INLIERS = 3.0
"""Inliers that say less than this against those of the best different place may be chance: six
against four are about as much. Set by hand."""
REPEATED_EVIDENCE = 10.0
"""Inliers that say less than this may agree on another part of a place that repeats itself. Chosen
on 52 simulated worlds that the calibration does not have."""

SQUARE_M = 4.0
"""How much is in view is counted in squares of this, seen from above."""
SURE = 0.9991
"""What segments half decide is believed if so likely: no wrong pose was, in 36 simulated worlds
that the calibration does not have."""


@dataclass(frozen=True)
class RankedCandidate:
    """A candidate with the overlap of the clouds where it stands.

    Attributes
    ----------
    candidate : Candidate
    overlap : float
        Share of the query cloud's points, up to the height that the map reaches there, that have a
        map point within the coarse radius, in [0, 1].
    rmse : float
        Root mean square distance of those pairs, metres.
    seen : float
        Of a candidate of the clouds alone: the share of the map in view that the query sees, too;
        1 where it cannot be among the first, and was not measured.
    """

    candidate: Candidate
    overlap: float
    rmse: float
    seen: float = 1.0

    @property
    def T_map_local(self) -> Pose:
        """(4, 4) float64."""
        return self.candidate.T_map_local

    @property
    def inliers(self) -> int:
        """Distinct query segments that agree with the pose."""
        return self.candidate.inliers

    @property
    def support(self) -> float:
        """What candidates are ranked by."""
        by_matches = self.candidate.fit is None
        return self.overlap * (self.inliers if by_matches else self.seen)


@dataclass(frozen=True)
class Score:
    """How well the clouds agree at a pose.

    Attributes
    ----------
    T_map_local : (4, 4) float64
    inliers : int
        Distinct query segments that agree with the candidate (one map segment each).
    overlap : float
        Share of the query cloud's points, up to the height that the map reaches there, that have a
        map point near them, in [0, 1].
    confirmed, judged : int
        The other way round: map points that have a query point near them, of those that could be
        judged; the others are free-space violations.
    rmse : float
        Root mean square distance of the pairs that overlap counts, metres.
    """

    T_map_local: Pose
    inliers: int
    overlap: float
    confirmed: int
    judged: int
    rmse: float

    @property
    def ground(self) -> float | None:
        """Share of the query's ground that lies on the map's, in [0, 1]; None where unknown."""
        return None

    @property
    def flush(self) -> float | None:
        """Share of the query's wall points, of those near the map's points, that are flush with its
        surfaces, in [0, 1]; None where unknown."""
        return None

    @property
    def intruding(self) -> float:
        """Share of what the query shows standing that stands in free space of the map, in [0, 1]; 0
        where unknown."""
        return 0.0

    @property
    def support(self) -> float:
        """What candidates are ranked by."""
        return self.inliers * self.overlap

    @property
    def seen(self) -> float | None:
        """Share of the judged map points that are confirmed, in [0, 1]; None where there are none.

        The others are free-space violations.
        """
        return self.confirmed / self.judged if self.judged else None

    def expected_seen(self, prior: float) -> float:
        """What is seen, as if ``prior`` more map points had been judged and the overlap confirmed.

        So few judged points say little, and no step lies between few and enough.
        """
        return (self.confirmed + prior * self.overlap) / (self.judged + prior)


@dataclass(frozen=True)
class CoarseScore(Score):
    """A candidate where it stands, measured within the coarse radius."""


class Details(Protocol):
    """What is measured at a pose only if the verdict asks for it."""

    @property
    def ground(self) -> float | None:
        """The share of the ground that lies on the map's."""

    @property
    def flush(self) -> float | None:
        """The share of wall points that are flush with the map's walls."""

    @property
    def intruding(self) -> float:
        """The share of what stands that stands in free space of the map."""


@dataclass(frozen=True)
class RefinedScore(Score):
    """A candidate after ICP.

    Attributes
    ----------
    covariance : (6, 6) float64 or None
        Of rotation (rad) then translation (m), in the local frame. None where ICP did not hold.
    details : Details
    """

    covariance: Float64 | None
    details: Details

    @property
    def coarse(self) -> CoarseScore:
        """The same as if nothing had been measured but what is measured of coarse ones."""
        counts = self.inliers, self.overlap, self.confirmed, self.judged
        return CoarseScore(self.T_map_local, *counts, self.rmse)

    @property
    def ground(self) -> float | None:
        return self.details.ground

    @property
    def flush(self) -> float | None:
        return self.details.flush

    @property
    def intruding(self) -> float:
        return self.details.intruding


def inlier_evidence(inliers: int, ratio: float) -> float:
    """The logarithm of how much likelier so many inliers are, where the best different place has
    fewer by that ratio (Poisson, without the constant)."""
    return inliers * math.log(max(ratio, 0.1))


@dataclass(frozen=True)
class Evidence:
    """All that speaks for a candidate, and for the best candidates at different places.

    Attributes
    ----------
    score : CoarseScore or RefinedScore
        Coarse where refining could not change the verdict.
    inlier_ratio : float
        How many times as many inliers as the best candidate at a different place, or as chance.
    rivals : tuple of Score
        The best candidates at different places.
    extent : int or None
        On how many squares of :data:`SQUARE_M` something stands, as far as the query sees; None
        where segments settle it.
    off_path : float or None
        How far the pose is from the path of the map, seen from above, metres; None where segments
        settle it, or the map has no path.
    other_storeys : tuple of Score
        The rivals above and below, in a map of several storeys.
    """

    score: Score
    inlier_ratio: float
    rivals: tuple[Score, ...]
    extent: int | None = None
    off_path: float | None = None
    other_storeys: tuple[Score, ...] = ()

    @property
    def inlier_evidence(self) -> float:
        """See :func:`inlier_evidence`."""
        return inlier_evidence(self.score.inliers, self.inlier_ratio)

    @property
    def is_settled(self) -> bool:
        """Whether the segments leave no doubt, so that the clouds only have to agree."""
        many = self.score.inliers >= SETTLED_INLIERS
        return many and self.inlier_evidence >= SETTLED_EVIDENCE


@dataclass(frozen=True)
class Verdict:
    """What is decided of a query.

    Attributes
    ----------
    reason : Reason or None
        Why no pose is believed; None where ``best`` is.
    message : str
        The same as a sentence with its figures; "" where a pose is believed.
    confidence : float
        Calibrated probability that ``best`` is right, in [0, 1].
    best : RankedCandidate, Score or None
        With as much as was measured before the verdict was clear.
    evidence : Evidence or None
        What ``best`` was judged by; None where it had too few inliers.
    runner_up : RankedCandidate or None
        The best supported candidate at a different place.
    """

    reason: Reason | None
    message: str = ""
    confidence: float = 0.0
    best: RankedCandidate | Score | None = None
    evidence: Evidence | None = None
    runner_up: RankedCandidate | None = None

    @classmethod
    def put_off(cls, candidates: Sequence[Candidate]) -> Verdict:
        """No verdict yet on candidates (one at least) that are to be judged among others."""
        most = max(candidates, key=lambda candidate: candidate.inliers)
        message = f"of the segments {most.inliers} agree on a place"
        return cls(Reason.TOO_UNCERTAIN, message, best=RankedCandidate(most, 0.0, 0.0))

    @property
    def is_judged(self) -> bool:
        """Whether it is more than put off."""
        return self.evidence is not None or self.reason is not Reason.TOO_UNCERTAIN

    @property
    def undecided(self) -> bool:
        """Whether too little spoke for any pose, so that more candidates may help."""
        return self.reason is not None and self.reason is not Reason.AMBIGUOUS

    @property
    def is_decided(self) -> bool:
        """Whether segments decide for a pose that is believed, if only against what they found."""
        evidence = None if self.reason else self.evidence
        return evidence is not None and evidence.inlier_evidence >= DECISIVE_INLIERS

    @property
    def is_thin(self) -> bool:
        """Whether the segments say too little for or against any pose, so that the clouds must.

        Where they speak for two, they do: neither need be the right one. So they do where one may
        be another part of a place that repeats itself, unless it is very likely.
        """
        if not self.is_decided or self.evidence is None:
            return True
        return self.evidence.inlier_evidence < REPEATED_EVIDENCE and self.confidence < SURE

    @property
    def rank(self) -> tuple[bool, float, int]:
        """The better of two verdicts on one query has the higher one."""
        return self.reason is None, self.confidence, self.best.inliers if self.best else 0
