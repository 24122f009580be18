"""FC4 fitted to finished descriptors, on pairs that show one object and on others of two kinds."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from .. import _native
from ..types import Float32, Int64
from .config import TrainConfig
from .labels import groups_of
from .pair_heads import PairHead, pair_loss

PAIRS, STEPS = 8000, 400
_RATE, _DECAY = 0.02, 1e-5
_NEAREST = 5


class Labelled(Protocol):
    """Segments of which it is known what they show."""

    @property
    def labels(self) -> Int64:
        """(P,) of one object where they are equal."""

    def different(self, a: NDArray[np.integer], b: NDArray[np.integer]) -> NDArray[np.bool_]:
        """Whether segments (broadcast) surely show different objects."""


@dataclass(frozen=True)
class PairSample:
    """N pairs of segments.

    Attributes
    ----------
    first, second : (N,) int64
    same : (N,) bool
        Of one object; all others are of two.
    """

    first: Int64
    second: Int64
    same: NDArray[np.bool_]


def random_pairs(segments: Labelled, count: int, rng: np.random.Generator) -> PairSample:
    """Up to so many pairs of one object, each object as often, and as many of any two others."""
    groups = [group for group in groups_of(segments.labels) if len(group) > 1]
    chosen = rng.integers(len(groups), size=count if groups else 0)
    same = np.array([rng.choice(groups[g], 2, replace=False) for g in chosen], np.int64)
    drawn = rng.integers(len(segments.labels), size=(4 * count, 2))
    other = drawn[segments.different(*drawn.T)][:count]
    pairs = np.concatenate([same.reshape(-1, 2), other])
    return PairSample(pairs[:, 0], pairs[:, 1], np.arange(len(pairs)) < len(same))


def nearest_wrong(
    segments: Labelled, vectors: Float32, count: int, rng: np.random.Generator, threads: int = 1
) -> tuple[Int64, Int64]:
    """Segments and one each of the nearest descriptors that surely are of another object."""
    queries = rng.integers(len(vectors), size=count)
    k = min(len(vectors), 8 * _NEAREST)
    near, _ = _native.knn(np.ascontiguousarray(vectors[queries]), vectors, k, threads)
    wrong = segments.different(queries[:, None], near)
    rank = rng.integers(1, _NEAREST + 1, size=count)
    found = np.cumsum(wrong, axis=1) == rank[:, None]
    some = found.any(axis=1)
    return queries[some], near[np.arange(count), found.argmax(axis=1)][some]


def fit_pair_head(
    head: PairHead, vectors: Float32, segments: Labelled, nearest: bool, config: TrainConfig
) -> None:
    """Fit FC4 to descriptors (P, dim) of labelled segments; it stays as it is without any pairs.

    Parameters
    ----------
    head : PairHead
    vectors : (P, dim) float32
    segments : Labelled
    nearest : bool
        It also learns from nearest descriptors that are wrong, half of the negatives.
    config : TrainConfig
    """
    rng = np.random.default_rng([config.seed, 4])
    if len(vectors) < 2 or len(np.unique(segments.labels)) == len(vectors):
        return
    pairs = random_pairs(segments, PAIRS, rng)
    first, second, kind = pairs.first, pairs.second, np.where(pairs.same, 0, 1)
    if nearest:
        a, b = nearest_wrong(segments, vectors, PAIRS, rng, config.threads)
        first, second = np.concatenate([first, a]), np.concatenate([second, b])
        kind = np.concatenate([kind, np.full(len(a), 2)])
    x = torch.from_numpy(vectors)
    fit(head, x[first], x[second], torch.from_numpy(kind))


def fit(head: PairHead, a: Tensor, b: Tensor, kind: Tensor) -> None:
    """Fit FC4 to pairs (N, dim): those of kind 0 match, those of every other kind do not."""
    others = [kind == k for k in range(1, int(kind.max()) + 1)]
    optimizer = torch.optim.Adam(head.parameters(), lr=_RATE, weight_decay=_DECAY)
    for step in range(STEPS):
        optimizer.param_groups[0]["lr"] = _RATE * (1 - step / STEPS)
        optimizer.zero_grad()
        pair_loss(head(a, b), kind == 0, *others).backward()
        optimizer.step()
