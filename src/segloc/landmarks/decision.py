"""The verdict on landmarks: a pure function of how well they lie on the map, here and elsewhere."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..localization import Reason
from .agreement import Agreement
from .config import LandmarkConfig

_SLOPE, _HALF = 40.0, 0.2
"""TODO."""


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
    share, and no other place has nearly as many.
    """
    share = best.support / max(landmarks, 1)
    confidence = float(1 / (1 + np.exp(-_SLOPE * (share - _HALF))))
    reason, message = None, ""
    if best.support < config.min_support:
        reason = Reason.TOO_FEW_INLIERS
        message = f"too few inliers (support {best.support:.1f} < {config.min_support:g})"
    elif share < config.min_share:
        reason = Reason.TOO_LITTLE_OVERLAP
        message = f"too little overlap ({share:.2f} < {config.min_share:.2f})"
    elif rival is not None and rival.support > config.max_rival * best.support:
        at = f"{rival.T_map_local[0, 3]:.0f}, {rival.T_map_local[1, 3]:.0f}"
        reason = Reason.AMBIGUOUS
        message = f"ambiguous (another place, at {at}, explains the query about as well)"
    return LandmarkVerdict(reason, message, confidence, best, rival)
