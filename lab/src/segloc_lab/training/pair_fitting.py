"""Fit FC4 to finished descriptors, on matching pairs and two kinds of different ones."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import torch
from scipy.spatial import cKDTree
from torch import Tensor, nn
from torch.nn import functional

from segloc.system import kernels
from segloc.types import Float32, Int64

from .config import HeadKind
from .dataset import SegmentDataset

_HIDDEN = 32


class PairHead(nn.Module):
    """Log-odds that two descriptors show one object.

    Parameters
    ----------
    kind : {"linear", "quadratic", "two_layer"}
        A linear map of the absolute difference; of that and its square, which includes weighted
        Euclidean distances; or two layers with a ReLU in between.
    """

    def __init__(self, kind: HeadKind, dim: int) -> None:
        super().__init__()
        self.squares = kind == "quadratic"
        widths = [dim, _HIDDEN, 1] if kind == "two_layer" else [2 * dim if self.squares else dim, 1]
        self.layers = nn.ModuleList(nn.Linear(a, b) for a, b in pairwise(widths))

    def forward(self, a: Tensor, b: Tensor) -> Tensor:
        """Return logits of descriptors (..., dim) that broadcast; one axis less."""
        x = (a - b).abs()
        if self.squares:
            x = torch.cat([x, x.square()], dim=-1)
        for number, layer in enumerate(self.layers):
            x = layer(functional.relu(x) if number else x)
        return x.squeeze(-1)

    def tensors(self) -> dict[str, Tensor]:
        """Return tensors for :class:`segloc.descriptors.pointset.PairHead`."""
        found: dict[str, Tensor] = {}
        for number, layer in enumerate(self.layers):
            found[f"pair.{number}.weight"] = layer.weight.detach().T
            found[f"pair.{number}.bias"] = layer.bias.detach()
        return found


def pair_loss(logits: Tensor, same: Tensor, *different: Tensor) -> Tensor:
    """Return FC4's cross-entropy; matching pairs weigh as much as all kinds of others together.

    Parameters
    ----------
    logits : (...,)
    same : (...,) bool
        Matching pairs.
    *different : (...,) bool
        Different pairs of one kind each; all kinds weigh the same.
    """
    logits = logits.float()  # in single precision, whatever the network uses
    positive = _mean(functional.softplus(-logits), same)
    negative = torch.stack([_mean(functional.softplus(logits), kind) for kind in different])
    return (positive + negative.mean()) / 2


def _mean(losses: Tensor, chosen: Tensor) -> Tensor:
    """Return the mean over the chosen, 0 if none; without indexing, so that it can be batched."""
    return losses.masked_fill(~chosen, 0.0).sum() / chosen.sum().clamp(min=1)


PAIRS, STEPS = 24_000, 400
SAME_M = 0.5
"""Maximum distance between centroids of matching segments [m], as in the paper."""

_RATE, _DECAY = 0.02, 1e-5
_NEAREST = 5


def near_pairs(segments: SegmentDataset) -> Int64:
    """Return all pairs (N, 2) of one world, but different sessions, with centroids within 0.5 m.

    They match by the paper's labels. By the training labels some show different parts of an object;
    FC4 fitted without these is worse than plain distance on all.
    """
    found = [np.empty((0, 2), np.int64)]
    for place in np.unique(segments.places):
        inside = np.flatnonzero(segments.places == place)
        tree = cKDTree(segments.centroids[inside])
        found.append(inside[tree.query_pairs(SAME_M, output_type="ndarray").reshape(-1, 2)])
    pairs = np.concatenate(found)
    pairs = pairs[segments.sessions[pairs[:, 0]] != segments.sessions[pairs[:, 1]]]
    return pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))]


def random_pairs(
    segments: SegmentDataset, count: int, rng: np.random.Generator
) -> tuple[Int64, Int64]:
    """Draw up to ``count`` matching pairs by the paper's labels, and as many of any two others.

    Returns both kinds, (N, 2) each.
    """
    near = near_pairs(segments)
    same = near[rng.permutation(len(near))[:count]]
    drawn = rng.integers(len(segments.places), size=(4 * count, 2))
    return same, drawn[segments.different(*drawn.T)][:count]


def nearest_wrong(
    segments: SegmentDataset, vectors: Float32, count: int, rng: np.random.Generator, threads: int
) -> Int64:
    """Return segments, each with one of the nearest descriptors of another object, (N, 2)."""
    queries = rng.integers(len(vectors), size=count)
    k = min(len(vectors), 8 * _NEAREST)
    near, _ = kernels.knn(np.ascontiguousarray(vectors[queries]), vectors, k, threads)
    wrong = segments.different(queries[:, None], near)
    rank = rng.integers(1, _NEAREST + 1, size=count)
    found = np.cumsum(wrong, axis=1) == rank[:, None]
    pairs = np.column_stack([queries, near[np.arange(count), found.argmax(axis=1)]])
    return pairs[found.any(axis=1)]


def fit_pair_head(
    head: PairHead,
    parts: Sequence[tuple[Float32, SegmentDataset]],
    *,
    nearest: bool = False,
    seed: int = 0,
    threads: int = 1,
) -> None:
    """Fit FC4 to descriptors of several sets of segments of about equal weight.

    FC4 is unchanged if no two segments match.

    Parameters
    ----------
    parts : sequence of ((P, dim) float32, SegmentDataset)
        Descriptors and their segments.
    nearest : bool
        True to draw half of the negatives from nearest descriptors.
    """
    rng = np.random.default_rng([seed, 4])
    firsts, seconds, kinds = [], [], []
    for vectors, segments in parts:
        found = [*random_pairs(segments, PAIRS // len(parts), rng)]
        if nearest:
            found.append(nearest_wrong(segments, vectors, PAIRS // len(parts), rng, threads))
        for kind, pairs in enumerate(found):
            firsts.append(vectors[pairs[:, 0]])
            seconds.append(vectors[pairs[:, 1]])
            kinds.append(np.full(len(pairs), kind))
    first, second, kind = (torch.from_numpy(np.concatenate(x)) for x in (firsts, seconds, kinds))
    if (kind == 0).any() and (kind == 1).any():
        fit(head, first, second, kind)


def fit(head: PairHead, a: Tensor, b: Tensor, kind: Tensor) -> None:
    """Fit FC4 to pairs (N, dim): kind 0 matches, every other kind is different."""
    others = [kind == k for k in range(1, int(kind.max()) + 1)]
    optimizer = torch.optim.Adam(head.parameters(), lr=_RATE, weight_decay=_DECAY)
    for step in range(STEPS):
        optimizer.param_groups[0]["lr"] = _RATE * (1 - step / STEPS)
        optimizer.zero_grad()
        pair_loss(head(a, b), kind == 0, *others).backward()
        optimizer.step()
