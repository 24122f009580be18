"""DSM and ESM: prepared points, X-conv, metric losses, native inference."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from segloc.descriptors.pointset import POINTS
from segloc.system import kernels
from segloc.types import Float32

from .config import TrainConfig, points_of, reorder
from .dataset import SegmentDataset, chunks, packed
from .models import LAYERS, DescriptorNetwork, export, folded, neighbors_of
from .pair_fitting import fit_pair_head, pair_loss
from .tasks import LOSSES, Batch, Inputs, Task, fit_logistic, held_out_quality


class PointSetTask(Task):
    """Task of an X-conv network on 256 points of each segment.

    Inputs are the points and each layer's neighbours, which other threads search.
    """

    def network(self, objects: int) -> DescriptorNetwork:
        return DescriptorNetwork(LAYERS[self.config.network], pair_head=self.config.pair_head)

    def inputs(
        self,
        dataset: SegmentDataset,
        indices: NDArray[np.int64],
        rng: np.random.Generator | None = None,
    ) -> Inputs:
        prepared = prepared_points(dataset, indices, self.config, rng)
        layers = LAYERS[self.config.network]
        return torch.from_numpy(prepared), *neighbors_of(prepared, layers, self.config.threads)

    def loss(self, network: DescriptorNetwork, batch: Batch) -> Tensor:
        x = network(*batch.inputs).float()
        loss = LOSSES[self.config.loss](x, batch.same, batch.different)
        if self.config.pair_weight > 0 and self.config.pair_training == "joint":
            loss = loss + self.config.pair_weight * self._pair_loss(network, x, batch)
        return loss

    def _pair_loss(self, network: DescriptorNetwork, x: Tensor, batch: Batch) -> Tensor:
        logits = network.pair_logits(x[:, None], x[None, :])
        negatives = [batch.different]
        if self.config.pair_negatives == "any":
            negatives.append(batch.different & batch.random[:, None] & batch.random)
        return pair_loss(logits, batch.same, *negatives)

    def describe(self, network: DescriptorNetwork, dataset: SegmentDataset) -> Float32:
        """Describe by the native network, as inference does."""
        table = [(x.points, x.neighbors, x.dilation, x.channels) for x in network.layers]
        native = kernels.Network(table, folded(network), POINTS)
        parts = [np.empty((0, native.dim), np.float32)]
        for indices in chunks(len(dataset), 1024):
            prepared = prepared_points(dataset, indices, self.config)
            parts.append(native.describe(prepared, self.config.threads)[0])
        return np.concatenate(parts)

    def finish(
        self, network: DescriptorNetwork, training: SegmentDataset, held: SegmentDataset
    ) -> None:
        """Fit the heads to finished descriptors of held-out places.

        The quality head predicts whether the nearest one is correct; FC4 is fitted unless it was
        trained with the descriptor.
        """
        found = held_out_quality(self, network, training, held)
        fit_logistic(network.quality_head, found.vectors[found.known], found.right)
        if self.config.pair_weight > 0 and self.config.pair_training == "frozen":
            fit_pair_head(
                network.pair_head,
                [(found.vectors, found.dataset)],
                nearest=self.config.pair_negatives == "batch",
                seed=self.config.seed,
                threads=self.config.threads,
            )

    def export(self, network: DescriptorNetwork, path: Path, card: Mapping[str, Any]) -> None:
        export(network, path, card, self.config.alignment, with_pairs=self.config.pair_weight > 0)


TASK = PointSetTask


def prepared_points(
    dataset: SegmentDataset,
    indices: NDArray[np.int64],
    config: TrainConfig,
    rng: np.random.Generator | None = None,
) -> Float32:
    """Return segments as inputs of the network (B, 256, 3); augmented if a generator is given."""
    parts = points_of(dataset, indices, config.augmentation, rng)
    prepared = kernels.prepare_segments(*packed(parts), POINTS, config.alignment, config.threads)
    return reorder(prepared, config.sampler, rng or np.random.default_rng(config.seed))
