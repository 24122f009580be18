"""What is decided of a query."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ..localization import Reason
from ..types import Candidate
from .evidence import DECISIVE_INLIERS, REPEATED_EVIDENCE, Evidence, RankedCandidate, Score

SURE = 0.9991
"""What segments half decide is believed if so likely: no wrong pose was, in 36 simulated worlds
that the calibration does not have."""


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
