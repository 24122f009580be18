"""How likely a pose is right, by what speaks for it."""

from __future__ import annotations

import math
from dataclasses import replace

from ..types import Hypothesis

CHANCE_INLIERS = 3
"""So many segments agree on some pose of any map."""
CHANCE_OVERLAP = 0.25
CHANCE_SEEN = 0.5
"""So well do clouds agree somewhere in any map."""
LEAST_SEEN = 0.3
"""Where everything is looked through, clouds agree less than chance has it: that tells nothing."""
MOST_FROM_INLIERS = 8.0
"""However many segments agree, clouds that disagree outweigh them."""
CONFIDENCE = (-7.8, 0.8, 0.8, 2.4, 2.4)
"""Of :func:`confidence`: the constant, and the weight of each witness."""


def confidence(hypothesis: Hypothesis) -> float:
    """Probability that a refined hypothesis is right, from what speaks for it.

    A logistic model, fitted by ``benchmarks/calibrate_confidence.py``.
    """
    score = CONFIDENCE[0]
    for weight, witness in zip(CONFIDENCE[1:], witnesses(hypothesis), strict=True):
        score += weight * witness
    return 1.0 / (1.0 + math.exp(-score))


def witnesses(hypothesis: Hypothesis) -> tuple[float, float, float, float]:
    """What the model of :func:`confidence` weighs.

    What is seen; the logarithm of how much likelier so many inliers are where the best different
    place has as many as it has (Poisson, without the constant); and how much more the clouds
    overlap, and is seen, than at the best different places. Such comparisons need no thresholds
    that would depend on the map's size, the scene or the sensor: other places say what chance
    achieves for this query. A witness that is not known says what chance would.
    """
    seen = _logit(hypothesis.seen_or_overlap)
    margin = 1.0 if math.isnan(hypothesis.margin) else max(hypothesis.margin, 0.1)
    return (
        seen,
        min(hypothesis.inliers * math.log(margin), MOST_FROM_INLIERS),
        _logit(hypothesis.overlap) - _logit(_known(hypothesis.rival_overlap, CHANCE_OVERLAP)),
        seen - _logit(max(_known(hypothesis.rival_seen, CHANCE_SEEN), LEAST_SEEN)),
    )


def _known(share: float, otherwise: float) -> float:
    return otherwise if math.isnan(share) else share


def _logit(share: float) -> float:
    """The odds of a share on a logarithmic scale that ends at 0 and 1."""
    return math.log((share + 0.05) / (1.05 - share))


def confidence_alone(hypothesis: Hypothesis) -> float:
    """The confidence if nothing but chance were at any other place."""
    nan = math.nan
    margin = hypothesis.inliers / CHANCE_INLIERS
    return confidence(replace(hypothesis, margin=margin, rival_overlap=nan, rival_seen=nan))
