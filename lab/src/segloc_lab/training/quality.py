"""The quality head: how likely a descriptor's nearest one in a map is to be of its object."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional

from segloc.types import Float32

from .dataset import SegmentDataset
from .metrics import nearest_is_right
from .tasks import Task


@dataclass(frozen=True)
class Judged:
    """Segments that training did not see, and whether their nearest descriptor is right.

    Attributes
    ----------
    dataset : SegmentDataset
        P segments.
    vectors : (P, dim) float32
    known : (K,) int64
        The segments that another session shows, too.
    right : (K,) float32
        1 where the nearest descriptor of another session is of the same object, 0 elsewhere.
    """

    dataset: SegmentDataset
    vectors: Float32
    known: NDArray[np.int64]
    right: Float32


def judged(
    task: Task, network: nn.Module, training: SegmentDataset, held: SegmentDataset
) -> Judged:
    """How often the nearest descriptor is right, for up to ``quality_limit`` held-out segments.

    On the training segments a network does better than it will do on a map. The nearest one is
    looked for among the other sessions and as many training segments, a pool of the size of a map.
    """
    config = task.config
    dataset = held.limited(config.quality_limit, config.seed)
    vectors = task.describe(network, dataset)
    others = task.describe(network, training.limited(config.quality_limit, config.seed))
    right = nearest_is_right(vectors, dataset, config.threads, others)
    known = np.flatnonzero(~np.isnan(right))
    return Judged(dataset, vectors, known, right[known])


def fit_logistic(head: nn.Linear, vectors: Float32, right: NDArray[np.float32]) -> None:
    """Fit a linear head to (P, dim) vectors of which (P,) are right, 1, or wrong, 0.

    A logistic regression; without any vectors the head says one half.
    """
    x, y = torch.from_numpy(vectors), torch.from_numpy(right)
    nn.init.zeros_(head.weight)
    nn.init.zeros_(head.bias)
    if len(y) == 0:
        return
    optimizer = torch.optim.LBFGS(head.parameters(), max_iter=100, line_search_fn="strong_wolfe")

    def closure() -> Tensor:
        optimizer.zero_grad()
        loss = functional.binary_cross_entropy_with_logits(head(x).squeeze(-1), y)
        loss = loss + 1e-3 * head.weight.square().sum()
        loss.backward()
        return loss

    optimizer.step(closure)
