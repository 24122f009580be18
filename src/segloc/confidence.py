"""How likely a pose is right, by what speaks for it."""

from __future__ import annotations

import math
from dataclasses import replace

from .types import Hypothesis

CHANCE_INLIERS = 3
"""So many segments agree on some pose of any map."""
CONFIDENCE = (-5.5, 1.3, 2.3, 2.4)
"""Of :func:`confidence`: the constant, and the weight of each witness."""


def confidence(hypothesis: Hypothesis) -> float:
    """Probability that a refined hypothesis is right, from what speaks for it.

    A logistic model, fitted by ``benchmarks/calibrate_confidence.py``.
    """
    score = CONFIDENCE[0]
    for weight, witness in zip(CONFIDENCE[1:], witnesses(hypothesis), strict=True):
        score += weight * witness
    return 1.0 / (1.0 + math.exp(-score))


def witnesses(hypothesis: Hypothesis) -> tuple[float, float, float]:
    """What the model of :func:`confidence` weighs: overlap, what is seen, and the margin.

    The number of inliers counts by its margin alone: more of them agree by chance where a query
    has more segments and a map more that look like them. A witness that is not known says what
    chance would.
    """
    seen = hypothesis.overlap if math.isnan(hypothesis.seen) else hypothesis.seen
    margin = 1.0 if math.isnan(hypothesis.margin) else max(hypothesis.margin, 0.1)
    return _logit(hypothesis.overlap), _logit(seen), math.log(margin)


def _logit(share: float) -> float:
    """The odds of a share on a logarithmic scale that ends at 0 and 1."""
    return math.log((share + 0.05) / (1.05 - share))


def confidence_alone(hypothesis: Hypothesis) -> float:
    """The confidence if nothing but chance were at any other place."""
    return confidence(replace(hypothesis, margin=hypothesis.inliers / CHANCE_INLIERS))
