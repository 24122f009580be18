"""The quality head: how likely a descriptor's nearest one in a map is to be of its object."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional

from .batches import limited
from .dataset import SegmentDataset
from .metrics import nearest_is_right
from .models import DescriptorNetwork
from .tasks import Task


def fit_quality(task: Task, model: DescriptorNetwork, dataset: SegmentDataset) -> None:
    """Fit the quality head to how often the nearest descriptor is right.

    A logistic regression on the finished descriptors of up to ``quality_limit`` training
    segments, against the nearest descriptor of the other sessions: what a map would offer.
    """
    config = task.config
    part = limited(dataset, config.quality_limit, config.seed)
    vectors = task.describe(model, part)
    right = nearest_is_right(vectors, part, config.threads)
    fit_head(model.quality_head, torch.from_numpy(vectors), right)


def fit_head(head: torch.nn.Linear, features: Tensor, right: NDArray[np.float32]) -> None:
    """Logistic regression of ``right`` (P,), NaN where not known, on features (P, F)."""
    known = torch.from_numpy(~np.isnan(right))
    x, y = features[known], torch.from_numpy(right)[known]
    torch.nn.init.zeros_(head.weight)
    torch.nn.init.zeros_(head.bias)
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
