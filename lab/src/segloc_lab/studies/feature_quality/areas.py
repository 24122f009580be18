"""Areas under the ROC by two judges of the same pairs, and a paired bootstrap between them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import torch
from torch import Tensor

RESAMPLES = 500


@dataclass(frozen=True)
class Areas:
    """Areas of M networks.

    Attributes
    ----------
    value : (M,)
    drawn : (R, M)
        The same where places are drawn with replacement.
    """

    value: Tensor
    drawn: Tensor


def areas(scores: Tensor, same: Tensor, places: Tensor) -> Areas:
    """Area under the ROC of scores (M, N) of N pairs, and of bootstrap samples of their places.

    Every call draws the same places, so that differences between calls are paired.

    Parameters
    ----------
    scores : (M, N)
        Higher for pairs that show one object.
    same : (N,) bool
    places : (N,) int64
        Of each pair.
    """
    _, place = torch.unique(places, return_inverse=True)
    count = int(place.max()) + 1
    generator = torch.Generator().manual_seed(0)
    drawn = torch.randint(count, (RESAMPLES, count), generator=generator)
    weights = torch.zeros(RESAMPLES, count).scatter_add_(1, drawn, torch.ones(RESAMPLES, count))
    weights = torch.cat([torch.ones(1, count), weights]).to(scores.device, torch.float64)
    each = torch.stack([_weighted(own, same, weights[:, place]) for own in scores], dim=1)
    return Areas(each[0], each[1:])


def _weighted(scores: Tensor, same: Tensor, weights: Tensor) -> Tensor:
    """(R,) the area for each row of weights (R, N) of the pairs."""
    order = scores[~same].argsort()
    wrong, own = scores[~same][order].contiguous(), scores[same].contiguous()
    below = torch.nn.functional.pad(weights[:, ~same][:, order].cumsum(dim=1), (1, 0))
    low = torch.searchsorted(wrong, own, right=False)
    high = torch.searchsorted(wrong, own, right=True)
    good = weights[:, same]
    total = (good * (below[:, low] + below[:, high])).sum(dim=1)
    return total / (2 * below[:, -1] * good.sum(dim=1)).clamp(min=1e-12)


def difference(judged: Areas, plain: Areas) -> dict[str, float]:
    """By how much one judge is better than another, over networks and places.

    The mean over networks with the 2.5 and 97.5 % quantiles where both are drawn anew.
    """
    each = judged.drawn - plain.drawn
    M = each.shape[1]
    generator = torch.Generator().manual_seed(1)
    chosen = torch.randint(M, each.shape, generator=generator).to(each.device)
    means = each.gather(1, chosen).mean(dim=1)
    low, high = (torch.quantile(means, q) for q in (0.025, 0.975))
    own = judged.value - plain.value
    return {
        "mean": float(own.mean()),
        "low": float(low),
        "high": float(high),
        "least": float(own.min()),
        "most": float(own.max()),
    }


def gain(found: Mapping[str, float]) -> str:
    """A :func:`difference` as a cell of a table: the mean, and its interval."""
    return f"{found['mean']:+.4f} ({found['low']:+.4f} to {found['high']:+.4f})"
