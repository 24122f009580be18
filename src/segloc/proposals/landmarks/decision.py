"""The verdict on landmarks: a pure function of how well they lie on the map, here and elsewhere."""

from __future__ import annotations

import math
from dataclasses import dataclass

from ...localization import Reason, ambiguous_with
from .agreement import Agreement
from .config import LandmarkConfig

CHANCE_SUPPORT = 3.0
"""What some wrong place of a map has almost always; a rival is not taken to have less."""
CONFIDENCE = (2.42, 8.48, 14.81)
"""Log-odds that a pose is right: a constant, times log(share), times log(ratio). Fitted by
``segloc_lab.calibration.landmarks``."""
_LEAST = 1e-3


@dataclass(frozen=True)
class LandmarkVerdict:
    """What is decided of a query.

    Attributes
    ----------
    reason : Reason or None
        Why no pose is believed; None where the best is.
    message : str
        The same as a sentence with its figures; "" where a pose is believed.
    confidence : float
        Probability that the best is right, in [0, 1].
    best, rival : Agreement or None
        The best pose, and the best one at another place.
    """

    reason: Reason | None
    message: str = ""
    confidence: float = 0.0
    best: Agreement | None = None
    rival: Agreement | None = None

    @property
    def undecided(self) -> bool:
        """Whether too little spoke for any pose, so that more matches may help."""
        return self.reason is not None and self.reason is not Reason.AMBIGUOUS

    @property
    def rank(self) -> tuple[bool, float]:
        """The better of two verdicts on one query has the higher one."""
        return self.reason is None, self.best.support if self.best else 0.0


def decide(
    best: Agreement, rival: Agreement | None, landmarks: int, config: LandmarkConfig
) -> LandmarkVerdict:
    """Believe a pose, or say why not.

    A pose is believed when enough of the query's landmarks lie on the map's, in number and as a
    share, no other place has nearly as many, and its calibrated probability is high enough.
    """
    share, ratio = best.support / max(landmarks, 1), ratio_to_rival(best, rival)
    confidence = probability(share, ratio)
    reason, message = None, ""
    if best.support < config.min_support:
        reason = Reason.TOO_FEW_INLIERS
        message = f"too few inliers (support {best.support:.1f} < {config.min_support:g})"
    elif share < config.min_share:
        reason = Reason.TOO_LITTLE_OVERLAP
        message = reason.below(share, config.min_share)
    elif rival is not None and rival.support > config.max_rival * best.support:
        reason, message = Reason.AMBIGUOUS, ambiguous_with(rival.T_map_local)
    elif confidence < config.min_confidence:
        reason = Reason.TOO_UNCERTAIN
        message = reason.below(confidence, config.min_confidence)
    return LandmarkVerdict(reason, message, confidence, best, rival)


def ratio_to_rival(best: Agreement, rival: Agreement | None) -> float:
    """How many times as much support as the rival, or as chance."""
    return best.support / max(rival.support if rival else 0.0, CHANCE_SUPPORT)


def probability(share: float, ratio: float) -> float:
    """How likely a pose with enough support is to be right, in [0, 1]."""
    constant, of_share, of_ratio = CONFIDENCE
    logit = constant + of_share * math.log(max(share, _LEAST))
    logit += of_ratio * math.log(max(ratio, _LEAST))
    return 1 / (1 + math.exp(-max(-50.0, min(50.0, logit))))
