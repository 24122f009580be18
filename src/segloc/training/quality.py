"""The quality head: how likely a descriptor's nearest one in a map is to be of its object."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional

from ..types import Float32
from .batches import limited
from .dataset import SegmentDataset
from .metrics import nearest_is_right
from .models import DescriptorNetwork
from .tasks import Task


def fit_quality(
    task: Task, model: DescriptorNetwork, training: SegmentDataset, held: SegmentDataset
) -> None:
    """Fit the quality head to how often the nearest descriptor is right.

    A logistic regression on the descriptors of up to ``quality_limit`` held-out segments: on the
    training segments a network does better than it will do on a map. The nearest one is looked for
    among the other sessions and as many training segments, a pool of the size of a map.
    """
    config = task.config
    held = limited(held, config.quality_limit, config.seed)
    vectors = task.describe(model, held)
    others = task.describe(model, limited(training, config.quality_limit, config.seed))
    right = nearest_is_right(vectors, held, config.threads, others)
    known = ~np.isnan(right)
    fit_logistic(model.quality_head, vectors[known], right[known])


def fit_logistic(head: nn.Linear, vectors: Float32, right: NDArray[np.float32]) -> None:
    """Fit a linear head to (P, dim) vectors of which (P,) are right, 1, or wrong, 0."""
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
