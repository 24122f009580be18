"""Places with log-ratios -> their probabilities, and the decision."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..geometry import Separation
from ..localization import Reason, ambiguous_with
from ..types import Float64, Pose


@dataclass(frozen=True)
class ScoredPose:
    """A possible pose of a query.

    Attributes
    ----------
    T_map_local : (4, 4) float64
    log_ratio : float
        Log-likelihood ratio of the query from here against none of the places.
    inliers : int
        Number of distinct query segments that agree with the pose.
    overlap : float
        Share of the query that lies on the map, in [0, 1].
    seen : float or None
        Share of the map in view that the query sees; None if nothing is in view.
    rmse : float or None
        Residual of the alignment [m].
    covariance : (6, 6) float64 or None
        Covariance of rotation [rad], then translation [m], in the local frame.
    features : tuple of float
        Features of the log-ratio.
    evidence : float
        Log-ratio of the query from here, if the pose was known already, against one from elsewhere.
    unknown : float
        Share of the query in space of which the map knows nothing, in [0, 1].
    """

    T_map_local: Pose
    log_ratio: float
    inliers: int
    overlap: float
    seen: float | None = None
    rmse: float | None = None
    covariance: Float64 | None = None
    features: tuple[float, ...] = ()
    evidence: float = 0.0
    unknown: float = 0.0

    def __str__(self) -> str:
        plural = "" if self.inliers == 1 else "s"
        return f"overlap {self.overlap:.2f} and {self.inliers} inlier{plural}"


@dataclass(frozen=True)
class Posterior:
    """The distinct possible places of a query, and their probabilities.

    Attributes
    ----------
    places : tuple of ScoredPose
        Places, the most probable first.
    probabilities : tuple of float
        Probability of each; with ``not_in_map`` they sum to 1.
    not_in_map : float
        Probability of none of them, in [0, 1].
    """

    places: tuple[ScoredPose, ...] = ()
    probabilities: tuple[float, ...] = ()
    not_in_map: float = 1.0

    @classmethod
    def of(
        cls, places: Sequence[ScoredPose], lapse: float = 0.0, unmeasured: Sequence[float] = ()
    ) -> Posterior:
        """Compute the softmax over places and "none of them", whose log-ratio is 0.

        ``lapse`` is the probability of misleading log-ratios; it is added to "none", and so are
        places that were not measured, by the log-ratios that are expected of them.
        """
        ordered = sorted(places, key=lambda place: -place.log_ratio)
        log_ratios = np.array([*(place.log_ratio for place in ordered), 0.0, *unmeasured])
        shares = np.exp(log_ratios - log_ratios.max())
        shares *= (1.0 - lapse) / shares.sum()
        probabilities = shares[: len(ordered)].tolist()
        not_in_map = float(shares[len(ordered) :].sum()) + lapse
        return cls(tuple(ordered), tuple(probabilities), not_in_map)

    @property
    def best(self) -> ScoredPose | None:
        """The most probable place."""
        return self.places[0] if self.places else None

    @property
    def confidence(self) -> float:
        """The probability of the most probable place, in [0, 1]."""
        return self.probabilities[0] if self.places else 0.0

    def at(self, T_map_local: Pose, separation: Separation) -> ScoredPose | None:
        """Return the place of a pose T_map_local; None if it was not measured."""
        here = (p for p in self.places if not separation.apart(p.T_map_local, T_map_local))
        return next(here, None)

    def repeats(self, min_confidence: float) -> bool:
        """Return whether the second place alone could prevent acceptance."""
        return len(self.places) > 1 and self.probabilities[1] > 1.0 - min_confidence

    def reason(self, min_confidence: float) -> Reason | None:
        """Return why the most probable place is rejected; None if it is accepted."""
        if not self.places:
            return Reason.NO_CONSISTENT_MATCHES
        if self.confidence >= min_confidence:
            return None
        if 1.0 - self.not_in_map >= min_confidence:
            return Reason.AMBIGUOUS
        if self.not_in_map >= min_confidence:
            return Reason.NOT_IN_MAP
        return Reason.TOO_UNCERTAIN

    def message(self, min_confidence: float) -> str:
        """Return the reason as a sentence with its figures; "" if the place is accepted."""
        reason = self.reason(min_confidence)
        if reason is None:
            return ""
        if not self.places:
            return str(reason)
        if reason is Reason.AMBIGUOUS:
            return ambiguous_with(self.places[1].T_map_local)
        best = ", runner-up ".join(str(place) for place in self.places[:2])
        if reason is Reason.NOT_IN_MAP:
            return f"{reason} (probability {format_probability(self.not_in_map)}): {best}"
        return f"{reason.below(self.confidence, min_confidence)}: {best}"


def log_odds(probability: float) -> float:
    """Return the log-odds, finite."""
    p = min(max(probability, 1e-12), 1.0 - 1e-12)
    return math.log(p / (1.0 - p))


def format_probability(probability: float) -> str:
    """Format a probability with two digits, never rounded up to 1."""
    return f"{math.floor(100 * probability) / 100:.2f}"
