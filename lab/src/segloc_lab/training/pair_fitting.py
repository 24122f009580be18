"""FC4 fitted to finished descriptors, on pairs that show one object and on others of two kinds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Protocol

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from torch import Tensor, nn
from torch.nn import functional

from segloc.system import kernels
from segloc.types import Float32, Float64, Int64

from .config import HeadKind

_HIDDEN = 32


class PairHead(nn.Module):
    """The logarithm of the odds that two descriptors show one object.

    Parameters
    ----------
    kind : {"linear", "quadratic", "two_layer"}
        A linear map of the absolute difference; of that and its square, so that a weighted
        Euclidean distance is among what it can learn; or two layers with a ReLU between them.
    """

    def __init__(self, kind: HeadKind, dim: int) -> None:
        super().__init__()
        self.squares = kind == "quadratic"
        widths = [dim, _HIDDEN, 1] if kind == "two_layer" else [2 * dim if self.squares else dim, 1]
        self.layers = nn.ModuleList(nn.Linear(a, b) for a, b in pairwise(widths))

    def forward(self, a: Tensor, b: Tensor) -> Tensor:
        """Logits of descriptors (..., dim) that broadcast; one axis less."""
        x = (a - b).abs()
        if self.squares:
            x = torch.cat([x, x.square()], dim=-1)
        for number, layer in enumerate(self.layers):
            x = layer(functional.relu(x) if number else x)
        return x.squeeze(-1)

    def tensors(self) -> dict[str, Tensor]:
        """As :class:`segloc.descriptors.pointset.PairHead` reads them."""
        found: dict[str, Tensor] = {}
        for number, layer in enumerate(self.layers):
            assert isinstance(layer, nn.Linear)
            found[f"pair.{number}.weight"] = layer.weight.detach().T
            found[f"pair.{number}.bias"] = layer.bias.detach()
        return found


def pair_loss(logits: Tensor, same: Tensor, *different: Tensor) -> Tensor:
    """Cross-entropy of FC4; pairs that match weigh as much as all kinds of others together.

    Parameters
    ----------
    logits : (...,)
    same : (...,) bool
        Pairs that match.
    *different : (...,) bool
        Pairs of one kind each that do not; the kinds weigh alike.
    """
    logits = logits.float()  # in single precision, whatever the network runs in
    positive = _mean(functional.softplus(-logits), same)
    negative = torch.stack([_mean(functional.softplus(logits), kind) for kind in different])
    return (positive + negative.mean()) / 2


def _mean(losses: Tensor, chosen: Tensor) -> Tensor:
    """Mean over the chosen, 0 without any; without indexing, so that it can be batched."""
    return losses.masked_fill(~chosen, 0.0).sum() / chosen.sum().clamp(min=1)


PAIRS, STEPS = 24_000, 400
SAME_M = 0.5
"""Segments match where their centroids lie within this distance, as in the paper."""

_RATE, _DECAY = 0.02, 1e-5
_NEAREST = 5


class Located(Protocol):
    """Segments of which it is known where they are, and which surely show different objects."""

    @property
    def places(self) -> Int64:
        """(P,) the world of each."""

    @property
    def sessions(self) -> Int64:
        """(P,) the recording of each."""

    @property
    def centroids(self) -> Float64:
        """(P, 3) in the frame of the world, metres."""

    def different(self, a: NDArray[np.integer], b: NDArray[np.integer]) -> NDArray[np.bool_]:
        """Whether segments (broadcast) surely show different objects."""


@dataclass(frozen=True)
class PairSample:
    """N pairs of segments.

    Attributes
    ----------
    first, second : (N,) int64
    same : (N,) bool
        Of one place; all others are of two objects.
    """

    first: Int64
    second: Int64
    same: NDArray[np.bool_]


def near_pairs(segments: Located) -> Int64:
    """(N, 2) all pairs of one world, but different sessions, with centroids within 0.5 m.

    By the paper's labels they match. Of the labels that descriptors are trained with, some show
    different parts of something; FC4 fitted without these is worse than plain distance on all.
    """
    found = [np.empty((0, 2), np.int64)]
    for place in np.unique(segments.places):
        inside = np.flatnonzero(segments.places == place)
        tree = cKDTree(segments.centroids[inside])
        found.append(inside[tree.query_pairs(SAME_M, output_type="ndarray").reshape(-1, 2)])
    pairs = np.concatenate(found)
    pairs = pairs[segments.sessions[pairs[:, 0]] != segments.sessions[pairs[:, 1]]]
    return pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))]


def random_pairs(segments: Located, count: int, rng: np.random.Generator) -> PairSample:
    """Up to so many pairs that match, by the paper's labels, and as many of any two others."""
    near = near_pairs(segments)
    same = near[rng.permutation(len(near))[:count]]
    drawn = rng.integers(len(segments.places), size=(4 * count, 2))
    other = drawn[segments.different(*drawn.T)][:count]
    pairs = np.concatenate([same, other])
    return PairSample(pairs[:, 0], pairs[:, 1], np.arange(len(pairs)) < len(same))


def nearest_wrong(
    segments: Located, vectors: Float32, count: int, rng: np.random.Generator, threads: int = 1
) -> tuple[Int64, Int64]:
    """Segments and one each of the nearest descriptors that surely are of another object."""
    queries = rng.integers(len(vectors), size=count)
    k = min(len(vectors), 8 * _NEAREST)
    near, _ = kernels.knn(np.ascontiguousarray(vectors[queries]), vectors, k, threads)
    wrong = segments.different(queries[:, None], near)
    rank = rng.integers(1, _NEAREST + 1, size=count)
    found = np.cumsum(wrong, axis=1) == rank[:, None]
    some = found.any(axis=1)
    return queries[some], near[np.arange(count), found.argmax(axis=1)][some]


def fit_pair_head(
    head: PairHead,
    parts: Sequence[tuple[Float32, Located]],
    *,
    nearest: bool = False,
    seed: int = 0,
    threads: int = 1,
) -> None:
    """Fit FC4 to descriptors of several sets of segments, all of which weigh about alike.

    It stays as it is where no two segments match.

    Parameters
    ----------
    parts : sequence of ((P, dim) float32, Located)
        Descriptors and what they describe.
    nearest : bool
        It also learns from nearest descriptors that are wrong, half of the negatives.
    """
    rng = np.random.default_rng([seed, 4])
    firsts, seconds, kinds = [], [], []
    for vectors, segments in parts:
        pairs = random_pairs(segments, PAIRS // len(parts), rng)
        firsts.append(vectors[pairs.first])
        seconds.append(vectors[pairs.second])
        kinds.append(np.where(pairs.same, 0, 1))
        if nearest:
            a, b = nearest_wrong(segments, vectors, PAIRS // len(parts), rng, threads)
            firsts.append(vectors[a])
            seconds.append(vectors[b])
            kinds.append(np.full(len(a), 2))
    first, second, kind = (torch.from_numpy(np.concatenate(x)) for x in (firsts, seconds, kinds))
    if (kind == 0).any() and (kind == 1).any():
        fit(head, first, second, kind)


def fit(head: PairHead, a: Tensor, b: Tensor, kind: Tensor) -> None:
    """Fit FC4 to pairs (N, dim): those of kind 0 match, those of every other kind do not."""
    others = [kind == k for k in range(1, int(kind.max()) + 1)]
    optimizer = torch.optim.Adam(head.parameters(), lr=_RATE, weight_decay=_DECAY)
    for step in range(STEPS):
        optimizer.param_groups[0]["lr"] = _RATE * (1 - step / STEPS)
        optimizer.zero_grad()
        pair_loss(head(a, b), kind == 0, *others).backward()
        optimizer.step()
