"""The profile network: shape profiles, three dense layers, native inference."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional

from segloc.descriptors.pointset import POINTS
from segloc.descriptors.profile import (
    KIND,
    LIMIT,
    PROFILE_SIZE,
    PROFILE_VERSION,
    PreparedSegments,
    profiles,
)
from segloc.descriptors.weightfile import write_weights
from segloc.system import kernels
from segloc.types import Float32

from .config import TrainConfig, augment, points_of
from .dataset import SegmentDataset, chunks, packed
from .tasks import LOSSES, Batch, Inputs, Task, fit_logistic, held_out_quality

DIM = 32
WIDTHS = (384, 256)
_AT_ONCE = 4096


class ProfileNetwork(nn.Module):
    """Map profiles (B, 175) to descriptors (B, DIM).

    Numbers are standardised by a batch norm and clipped, then pass dense layers of ``WIDTHS`` with
    ELU and batch norm, and a linear one. ``quality_head`` reads the last hidden layer.
    """

    def __init__(self) -> None:
        super().__init__()
        self.standardise = nn.BatchNorm1d(PROFILE_SIZE, eps=1e-6, momentum=0.02, affine=False)
        sizes = (PROFILE_SIZE, *WIDTHS)
        self.hidden = nn.ModuleList(nn.Linear(a, b) for a, b in pairwise(sizes))
        self.norms = nn.ModuleList(nn.BatchNorm1d(width) for width in WIDTHS)
        self.output = nn.Linear(WIDTHS[-1], DIM)
        self.quality_head = nn.Linear(WIDTHS[-1], 1)

    def features(self, profile: Tensor) -> Tensor:
        """Return the last hidden layer of profiles, (B, WIDTHS[-1])."""
        x = self.standardise(profile).clamp(-LIMIT, LIMIT)
        for layer, norm in zip(self.hidden, self.norms, strict=True):
            x = norm(functional.elu(layer(x)))
        return x

    def forward(self, profile: Tensor) -> Tensor:
        """Return descriptors (B, DIM)."""
        return self.output(self.features(profile))


class ProfileTask(Task):
    """Task of a small network on each segment's shape profile."""

    def network(self, objects: int) -> ProfileNetwork:
        return ProfileNetwork()

    def inputs(
        self,
        dataset: SegmentDataset,
        indices: NDArray[np.int64],
        rng: np.random.Generator | None = None,
    ) -> Inputs:
        prepared = prepared_segments(dataset, indices, self.config, rng)
        return (torch.from_numpy(profiles(prepared, self.config.threads)),)

    def loss(self, network: nn.Module, batch: Batch) -> Tensor:
        x = network(*batch.inputs).float()
        return LOSSES[self.config.loss](x, batch.same, batch.different)

    def finish(
        self, network: ProfileNetwork, training: SegmentDataset, held: SegmentDataset
    ) -> None:
        """Fit the quality to the share of correct nearest descriptors, on held-out places."""
        found = held_out_quality(self, network, training, held)
        rows = [np.empty((0, WIDTHS[-1]), np.float32)]
        with torch.inference_mode():
            for numbers in chunks(len(found.known), _AT_ONCE):
                some = found.known[numbers]
                rows.append(network.features(*self.inputs(found.dataset, some)).numpy())
        fit_logistic(network.quality_head, np.concatenate(rows), found.right)

    def export(self, network: ProfileNetwork, path: Path, card: Mapping[str, Any]) -> None:
        write_weights(path, KIND, folded(network), {"profile": str(PROFILE_VERSION)}, card)


TASK = ProfileTask


def prepared_segments(
    dataset: SegmentDataset,
    indices: NDArray[np.int64],
    config: TrainConfig,
    rng: np.random.Generator | None = None,
) -> PreparedSegments:
    """Return aligned and sampled segments with heights; augmented if a generator is given."""
    parts = points_of(dataset, indices, config.augmentation)
    heights = dataset.heights[indices].astype(np.float32)
    if rng is not None:
        changed = [augment(part, config.augmentation, rng) for part in parts]
        # Points cut off above or below move the centroid.
        rise = [a[:, 2].mean() - b[:, 2].mean() for a, b in zip(changed, parts, strict=True)]
        parts, heights = changed, heights + np.array(rise, np.float32)
    points = kernels.prepare_segments(*packed(parts), POINTS, config.alignment, config.threads)
    return PreparedSegments(points, heights)


@torch.no_grad()
def folded(network: ProfileNetwork) -> dict[str, Float32]:
    """Return the tensors of inference (cpp/perceptron.h); the quality is the last output."""
    norm = network.standardise
    tensors = {
        "input.mean": norm.running_mean,
        "input.scale": 1.0 / torch.sqrt(norm.running_var + norm.eps),
        "output.weight": torch.cat([network.output.weight, network.quality_head.weight]).T,
        "output.bias": torch.cat([network.output.bias, network.quality_head.bias]),
    }
    for index, (layer, after) in enumerate(zip(network.hidden, network.norms, strict=True)):
        scale = after.weight / torch.sqrt(after.running_var + after.eps)
        tensors[f"hidden.{index}.weight"] = layer.weight.T
        tensors[f"hidden.{index}.bias"] = layer.bias
        tensors[f"hidden.{index}.scale"] = scale
        tensors[f"hidden.{index}.shift"] = after.bias - after.running_mean * scale
    return {name: tensor.float().contiguous().numpy() for name, tensor in tensors.items()}
