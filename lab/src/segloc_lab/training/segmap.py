"""SegMap as a task: occupancy grids, classification and reconstruction (Dubé et al., RSS 2018)."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional

from segloc.descriptors.segmap import VoxelShapes, prepare
from segloc.system import kernels
from segloc.types import Float32, Segments

from .config import points_of
from .dataset import SegmentDataset, chunks, packed
from .tasks import Batch, Inputs, Task
from .writing import write_segmap

DIM = 64
MAX_OBJECTS = 6_000
"""Objects of the classifier, those with most views; more would outgrow the rest of the network."""

_RECONSTRUCTION = 200.0  # weight of that loss, and of occupied and empty voxels in it
_OCCUPIED, _EMPTY = 0.9, 0.1


class SegMapNetwork(nn.Module):
    """Convolutions over a grid of 32 x 32 x 16, a descriptor, a classifier and a decoder.

    Parameters
    ----------
    objects : int
        Number of classes.
    """

    def __init__(self, objects: int) -> None:
        super().__init__()
        self.conv1 = nn.Conv3d(1, 32, 3, padding=1)
        self.conv2 = nn.Conv3d(32, 64, 3, padding=1)
        self.conv3 = nn.Conv3d(64, 64, 3, padding=1)
        self.fc1 = nn.Linear(8 * 8 * 4 * 64 + 3, 512)
        self.fc1_norm = nn.BatchNorm1d(512)
        self.fc2 = nn.Linear(512, DIM)
        self.norm = nn.BatchNorm1d(DIM)
        self.classifier = nn.Linear(DIM, objects)
        self.expand = nn.Linear(DIM, 8 * 8 * 4 * 32)
        step = {"kernel_size": 3, "padding": 1}
        self.deconv1 = nn.ConvTranspose3d(32, 32, stride=2, output_padding=1, **step)
        self.deconv2 = nn.ConvTranspose3d(32, 32, stride=2, output_padding=1, **step)
        self.deconv3 = nn.ConvTranspose3d(32, 1, **step)

    def trunk_parameters(self) -> int:
        """Number of parameters up to the descriptor and its norm."""
        heads = (self.classifier, self.expand, self.deconv1, self.deconv2, self.deconv3)
        rest = sum(p.numel() for head in heads for p in head.parameters())
        return sum(p.numel() for p in self.parameters()) - rest

    def describe(self, grids: Tensor, scales: Tensor) -> Tensor:
        """Return descriptors (B, 64) of grids (B, 32, 32, 16) with scales (B, 3) [m]."""
        x = functional.max_pool3d(functional.relu(self.conv1(grids[:, None])), 2)
        x = functional.max_pool3d(functional.relu(self.conv2(x)), 2)
        x = functional.relu(self.conv3(x))
        x = torch.cat([x.permute(0, 2, 3, 4, 1).flatten(1), scales], dim=1)
        x = self.fc1_norm(functional.relu(self.fc1(x)))
        return functional.relu(self.fc2(functional.dropout(x, 0.5, self.training)))

    def forward(self, grids: Tensor, scales: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Return descriptors, class logits, and logits of the voxels' occupancy."""
        descriptor = self.describe(grids, scales)
        normed = self.norm(descriptor)
        logits = self.classifier(functional.dropout(normed, 0.35, self.training))
        x = functional.relu(self.expand(normed)).view(-1, 8, 8, 4, 32).permute(0, 4, 1, 2, 3)
        x = functional.relu(self.deconv1(x))
        x = functional.relu(self.deconv2(x))
        return descriptor, logits, self.deconv3(x).squeeze(1)


class SegMapTask(Task):
    """The published network with its published losses."""

    max_objects = MAX_OBJECTS

    def network(self, objects: int) -> SegMapNetwork:
        return SegMapNetwork(objects).to(memory_format=torch.channels_last_3d)

    def inputs(
        self,
        dataset: SegmentDataset,
        indices: NDArray[np.int64],
        rng: np.random.Generator | None = None,
    ) -> Inputs:
        parts = points_of(dataset, indices, self.config.augmentation, rng)
        shapes = voxelised(parts, self.config.threads)
        return torch.from_numpy(shapes.dense()), torch.from_numpy(shapes.scales)

    def loss(self, network: nn.Module, batch: Batch) -> Tensor:
        grids, _ = batch.inputs
        _, logits, occupancy = network(*batch.inputs)
        weight = _EMPTY + (_OCCUPIED - _EMPTY) * grids
        rebuilt = functional.binary_cross_entropy_with_logits(occupancy.float(), grids, weight)
        classes = functional.cross_entropy(logits.float(), batch.labels)
        return classes + _RECONSTRUCTION * rebuilt

    def describe(self, network: SegMapNetwork, dataset: SegmentDataset) -> Float32:
        """Describe by the native network, before weights are rounded for the file."""
        native = kernels.VoxelNetwork(folded(network))
        parts = [np.empty((0, DIM), np.float32)]
        threads = self.config.threads
        for chosen in chunks(len(dataset), 1024):
            shapes = voxelised([dataset.segment(int(i)) for i in chosen], threads)
            parts.append(native.describe(shapes.voxels, shapes.offsets, shapes.scales, threads))
        return np.concatenate(parts)

    def export(self, network: SegMapNetwork, path: Path, card: Mapping[str, Any]) -> None:
        write_segmap(path, folded(network), card)


TASK = SegMapTask


def voxelised(parts: list[Float32], threads: int) -> VoxelShapes:
    """Return occupancy grids of segments, as in inference."""
    P = len(parts)
    segments = Segments(*packed(parts), np.zeros((P, 3)), np.zeros(P, np.float32))
    return prepare(segments, threads)


@torch.no_grad()
def folded(network: SegMapNetwork) -> dict[str, Float32]:
    """Return the tensors of inference (cpp/voxel_network.h), with batch norm folded in."""
    norm = network.fc1_norm
    scale = norm.weight.double() / torch.sqrt(norm.running_var.double() + norm.eps)
    shift = norm.bias.double() - norm.running_mean.double() * scale
    fc2 = network.fc2.weight.double().T
    tensors = {
        "fc1.weight": network.fc1.weight.T,
        "fc1.bias": network.fc1.bias,
        "fc2.weight": scale[:, None] * fc2,
        "fc2.bias": shift @ fc2 + network.fc2.bias,
    }
    for name in ("conv1", "conv2", "conv3"):
        conv: nn.Conv3d = getattr(network, name)
        tensors[f"{name}.weight"] = conv.weight.permute(2, 3, 4, 1, 0)
        tensors[f"{name}.bias"] = conv.bias
    return {name: t.float().contiguous().numpy() for name, t in tensors.items()}
