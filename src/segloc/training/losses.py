"""Losses on a batch of descriptors with known same and different pairs."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional


def squared_distances(x: Tensor) -> Tensor:
    """(B, B) squared Euclidean distances of the rows of (B, dim)."""
    return (x[:, None] - x[None, :]).square().sum(dim=-1)


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


def pair_match(logits: Tensor, same: Tensor, different: Tensor) -> Tensor:
    """Cross-entropy of FC4 over all pairs of a batch, both kinds weighted alike.

    ``logits`` is (B, B, 2).
    """
    log_p = functional.log_softmax(logits, dim=-1)
    return -(log_p[..., 1][same].mean() + log_p[..., 0][different].mean()) / 2
