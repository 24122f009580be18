"""Descriptors of whole datasets, and the quality head that is fitted to them."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from .. import _native
from ..descriptors.pointset import POINTS
from ..types import Float32
from .batches import limited, prepared_batch
from .config import TrainConfig
from .dataset import SegmentDataset
from .export import folded
from .metrics import nearest_is_right
from .models import DescriptorNetwork


def describe(model: DescriptorNetwork, dataset: SegmentDataset, config: TrainConfig) -> Float32:
    """Descriptors (P, dim) of all segments of a dataset, by the native network."""
    table = [(x.points, x.neighbors, x.dilation, x.channels) for x in model.layers]
    network = _native.Network(table, folded(model), POINTS)
    parts = [np.empty((0, network.dim), np.float32)]
    for first in range(0, len(dataset), 1024):
        indices = np.arange(first, min(first + 1024, len(dataset)))
        prepared = prepared_batch(dataset, indices, config)
        parts.append(network.describe(prepared, config.threads)[0])
    return np.concatenate(parts)


def fit_quality(model: DescriptorNetwork, dataset: SegmentDataset, config: TrainConfig) -> None:
    """Fit the quality head to how often the nearest descriptor is right.

    A logistic regression on the finished descriptors of up to ``validation_limit`` training
    segments, against the nearest descriptor of the other sessions: what a map would offer.
    """
    part = limited(dataset, config)
    vectors = describe(model, part, config)
    right = nearest_is_right(vectors, part, config.threads)
    known = ~np.isnan(right)
    x, y = torch.from_numpy(vectors[known]), torch.from_numpy(right[known])
    head = model.quality_head
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
