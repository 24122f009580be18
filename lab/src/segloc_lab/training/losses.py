"""Losses on a batch of descriptors with known same and different pairs."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps

import torch
from torch import Tensor
from torch.nn import functional

Loss = Callable[[Tensor, Tensor, Tensor], Tensor]


def in_float32(loss: Loss) -> Loss:
    """A loss in single precision, whatever the network runs in.

    Under autocast even float32 descriptors would be multiplied in bfloat16, whose 8 bits lose the
    differences between distances.
    """

    @wraps(loss)
    def whole(x: Tensor, same: Tensor, different: Tensor) -> Tensor:
        with torch.autocast(x.device.type, enabled=False):
            return loss(x.float(), same, different)

    return whole


def squared_distances(x: Tensor) -> Tensor:
    """(B, B) squared Euclidean distances of the rows of (B, dim)."""
    squares = x.square().sum(dim=-1)
    return (squares[:, None] + squares[None, :] - 2.0 * x @ x.T).clamp(min=0.0)


def info_nce(x: Tensor, same: Tensor, different: Tensor) -> Tensor:
    """Cross-entropy of picking one of the same object among all that differ.

    The logits are negative squared distances, so that the scale of the descriptors is learned.

    Parameters
    ----------
    x : (B, dim)
    same, different : (B, B) bool
        Pairs that are neither are left out.
    """
    logits = -squared_distances(x)
    others = torch.logsumexp(logits.masked_fill(~different, -1e9), dim=1, keepdim=True)
    losses = torch.logaddexp(logits, others) - logits
    return losses[same].mean()


def hard_triplet(x: Tensor, same: Tensor, different: Tensor) -> Tensor:
    """Soft-margin triplets of each anchor's farthest same and nearest different descriptor."""
    distances = (squared_distances(x) + 1e-12).sqrt()
    farthest = distances.masked_fill(~same, -1.0).amax(dim=1)
    nearest = distances.masked_fill(~different, 1e9).amin(dim=1)
    valid = same.any(dim=1) & different.any(dim=1)
    return functional.softplus(farthest - nearest)[valid].mean()


def ratio_triplet(x: Tensor, same: Tensor, different: Tensor, margin: float = 0.1) -> Tensor:
    """Triplets by ratio plus a term that draws pairs together, with in-batch hard negatives.

    With d+ and d- the squared distances of a matching pair and of the anchor's nearest different
    descriptor: max(0, 1 - d- / (d+ + margin)) + d+ (Wohlhart and Lepetit, "Learning descriptors for
    object recognition and 3D pose estimation", CVPR 2015, with squared distances).
    """
    distances = squared_distances(x)
    nearest = distances.masked_fill(~different, 1e9).amin(dim=1, keepdim=True)
    losses = (1.0 - nearest / (distances + margin)).clamp(min=0.0) + distances
    valid = same & different.any(dim=1, keepdim=True)
    return losses[valid].mean()


def multi_similarity(
    x: Tensor,
    same: Tensor,
    different: Tensor,
    alpha: float = 2.0,
    beta: float = 40.0,
    base: float = 0.5,
    margin: float = 0.1,
) -> Tensor:
    """Pairs weighted by their own and by relative similarity, the cosine (Wang et al., CVPR 2019).

    Of an anchor's pairs those count that are mined: negatives more similar than its least similar
    positive less the margin, positives less similar than its most similar negative plus the margin.
    """
    unit = functional.normalize(x)
    similarity = unit @ unit.T
    least = similarity.masked_fill(~same, 2.0).amin(dim=1, keepdim=True)
    most = similarity.masked_fill(~different, -2.0).amax(dim=1, keepdim=True)
    positive = same & (similarity < most + margin)
    negative = different & (similarity > least - margin)
    gap = similarity - base

    def pull(weight: float, mask: Tensor) -> Tensor:
        return torch.log1p((weight * gap).exp().masked_fill(~mask, 0.0).sum(dim=1)) / abs(weight)

    valid = same.any(dim=1) & different.any(dim=1)
    return (pull(-alpha, positive) + pull(beta, negative))[valid].mean()


LOSSES: dict[str, Loss] = {
    "info_nce": in_float32(info_nce),
    "triplet": in_float32(hard_triplet),
    "esm": in_float32(ratio_triplet),
    "multi_similarity": in_float32(multi_similarity),
}
