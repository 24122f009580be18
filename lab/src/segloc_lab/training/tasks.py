"""Tasks: what the training loop needs of each kind of network."""

from __future__ import annotations

import importlib
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import wraps
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional

from segloc.errors import ConfigError
from segloc.types import Float32

from .config import TrainConfig
from .dataset import SegmentDataset, chunks
from .metrics import nearest_is_right

Loss = Callable[[Tensor, Tensor, Tensor], Tensor]


def in_float32(loss: Loss) -> Loss:
    """Compute a loss in single precision, whatever the network uses.

    Under autocast, float32 descriptors would be multiplied in bfloat16, whose 8 bits lose the
    differences between distances.
    """

    @wraps(loss)
    def whole(x: Tensor, same: Tensor, different: Tensor) -> Tensor:
        with torch.autocast(x.device.type, enabled=False):
            return loss(x.float(), same, different)

    return whole


def squared_distances(x: Tensor) -> Tensor:
    """Return squared Euclidean distances (B, B) of the rows of (B, dim)."""
    squares = x.square().sum(dim=-1)
    return (squares[:, None] + squares[None, :] - 2.0 * x @ x.T).clamp(min=0.0)


def info_nce(x: Tensor, same: Tensor, different: Tensor) -> Tensor:
    """Return the cross-entropy of picking a matching descriptor among all different ones.

    Logits are negative squared distances, so that the scale of the descriptors is learned.

    Parameters
    ----------
    x : (B, dim)
    same, different : (B, B) bool
        Pairs that are neither are ignored.
    """
    logits = -squared_distances(x)
    others = torch.logsumexp(logits.masked_fill(~different, -1e9), dim=1, keepdim=True)
    losses = torch.logaddexp(logits, others) - logits
    return losses[same].mean()


def hard_triplet(x: Tensor, same: Tensor, different: Tensor) -> Tensor:
    """Return soft-margin triplets of each anchor's farthest same and nearest different one."""
    distances = (squared_distances(x) + 1e-12).sqrt()
    farthest = distances.masked_fill(~same, -1.0).amax(dim=1)
    nearest = distances.masked_fill(~different, 1e9).amin(dim=1)
    valid = same.any(dim=1) & different.any(dim=1)
    return functional.softplus(farthest - nearest)[valid].mean()


def ratio_triplet(x: Tensor, same: Tensor, different: Tensor, margin: float = 0.1) -> Tensor:
    """Return ratio triplets plus the distance of matching pairs, with in-batch hard negatives.

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
    """Weight pairs by absolute and relative cosine similarity (Wang et al., CVPR 2019).

    Only mined pairs of an anchor count: negatives more similar than its least similar positive less
    the margin, positives less similar than its most similar negative plus the margin.
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


Inputs = tuple[Tensor, ...]


@dataclass(frozen=True)
class Batch:
    """B segments as a network's input, with their relations."""

    inputs: Inputs  # prepared by the task; the first axis of each is B
    labels: Tensor  # (B,) int64, object numbers over the training set, from 0
    same: Tensor  # (B, B) bool; pairs that are neither same nor different are ignored
    different: Tensor
    random: Tensor  # (B,) bool; False for segments of objects drawn as hard ones

    def to(self, device: torch.device) -> Batch:
        """Move the batch to a device."""
        parts = (*self.inputs, self.labels, self.same, self.different, self.random)
        *inputs, labels, same, different, random = (t.to(device, non_blocking=True) for t in parts)
        return Batch(tuple(inputs), labels, same, different, random)


class Task(ABC):
    """A kind of network: its inputs, loss and export.

    Depends on the configuration and the arguments alone. ``inputs`` is called from other threads
    than training.
    """

    max_objects: int | None = None
    """Limit to the objects with most views, if the network's size depends on their number."""

    def __init__(self, config: TrainConfig) -> None:
        self.config = config

    @abstractmethod
    def network(self, objects: int) -> nn.Module:
        """Return a new network; ``objects`` is the number of objects of the training set."""

    @abstractmethod
    def inputs(
        self,
        dataset: SegmentDataset,
        indices: NDArray[np.int64],
        rng: np.random.Generator | None = None,
    ) -> Inputs:
        """Return segments as inputs of the network; augmented if a generator is given."""

    @abstractmethod
    def loss(self, network: nn.Module, batch: Batch) -> Tensor:
        """Return the loss of a batch, a scalar."""

    @abstractmethod
    def export(self, network: nn.Module, path: Path, card: Mapping[str, Any]) -> None:
        """Write the weights file for inference."""

    def describe(self, network: nn.Module, dataset: SegmentDataset) -> Float32:
        """Return descriptors (P, dim) of all segments of a dataset."""
        device = next(network.parameters()).device
        was_training = network.training
        network.eval()
        parts = []
        with torch.inference_mode():
            for indices in chunks(len(dataset), 256):
                inputs = [t.to(device) for t in self.inputs(dataset, indices)]
                parts.append(network(*inputs).float().cpu().numpy())
        network.train(was_training)
        return np.concatenate(parts)

    def finish(  # noqa: B027
        self, network: nn.Module, training: SegmentDataset, held: SegmentDataset
    ) -> None:
        """Fit the heads to finished descriptors, before the export.

        ``held`` holds segments the network was not trained on.
        """


MODULES = {"dsm": "pointset", "esm": "pointset", "profile": "profile", "segmap": "segmap"}
"""Module of each network, with its ``TASK``."""


def create_task(config: TrainConfig) -> Task:
    """Return the task of the configured network."""
    name = config.network
    if name not in MODULES:
        raise ConfigError(f"no network {name!r} to train; available: {', '.join(sorted(MODULES))}")
    task: Task = importlib.import_module(f"{__package__}.{MODULES[name]}").TASK(config)
    return task


@dataclass(frozen=True)
class HeldOut:
    """Held-out segments, and whether their nearest descriptor is right."""

    dataset: SegmentDataset  # P segments
    vectors: Float32  # (P, dim)
    known: NDArray[np.int64]  # (K,), segments that another session contains
    right: Float32  # (K,), 1 if the nearest of another session is of the same object, else 0


def held_out_quality(
    task: Task, network: nn.Module, training: SegmentDataset, held: SegmentDataset
) -> HeldOut:
    """Measure on up to ``quality_limit`` held-out segments whether the nearest descriptor is right.

    A network does better on its training segments than on a map. The nearest descriptor is searched
    among the other sessions and as many training segments: a pool of the size of a map.
    """
    config = task.config
    dataset = held.limited(config.quality_limit, config.seed)
    vectors = task.describe(network, dataset)
    others = task.describe(network, training.limited(config.quality_limit, config.seed))
    right = nearest_is_right(vectors, dataset, config.threads, others)
    known = np.flatnonzero(~np.isnan(right))
    return HeldOut(dataset, vectors, known, right[known])


def fit_logistic(head: nn.Linear, vectors: Float32, right: NDArray[np.float32]) -> None:
    """Fit a linear head to (P, dim) vectors of which (P,) are right, 1, or wrong, 0.

    A logistic regression; without any vectors the output is one half.
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
