"""Which segments make a batch, how they are related, and what the network reads of them."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from .. import _native
from ..descriptors.pointset import POINTS
from ..types import Float32
from .augment import augment
from .config import TrainConfig
from .dataset import SegmentDataset
from .sampling import reorder


def groups_of(dataset: SegmentDataset) -> list[NDArray[np.int64]]:
    """Indices of the segments of each object with at least two."""
    order = np.argsort(dataset.labels, kind="stable")
    groups = np.split(order, np.flatnonzero(np.diff(dataset.labels[order])) + 1)
    return [group for group in groups if len(group) > 1]


def draw_batch(
    groups: list[NDArray[np.int64]],
    mistakable: NDArray[np.int64],
    config: TrainConfig,
    rng: np.random.Generator,
) -> NDArray[np.int64]:
    """Some views of some objects: random ones, and others that are easily taken for them."""
    order = rng.permutation(len(groups))
    hard = round(config.hard_share * config.classes) if len(mistakable) else 0
    chosen = list(order[: config.classes - hard])
    if hard:
        rivals = mistakable[rng.choice(chosen, size=4 * hard)]
        picked = rivals[np.arange(len(rivals)), rng.integers(rivals.shape[1], size=len(rivals))]
        chosen += list(dict.fromkeys(picked[~np.isin(picked, chosen)]))[:hard]
    views = [
        rng.choice(groups[g], size=min(config.views, len(groups[g])), replace=False) for g in chosen
    ]
    return np.concatenate(views)


def relations(
    dataset: SegmentDataset, indices: NDArray[np.int64], far_m: float
) -> tuple[Tensor, Tensor]:
    labels = dataset.labels[indices]
    same = (labels[:, None] == labels[None, :]) & ~np.eye(len(indices), dtype=bool)
    different = dataset.different(indices[:, None], indices[None, :], far_m)
    return torch.from_numpy(same), torch.from_numpy(different)


def prepared_batch(
    dataset: SegmentDataset,
    indices: NDArray[np.int64],
    config: TrainConfig,
    rng: np.random.Generator | None = None,
) -> Float32:
    """Segments as the network reads them, (B, 256, 3); augmented where a generator is given."""
    parts = [dataset.segment(int(i)) for i in indices]
    if rng is not None:
        parts = [augment(part, config.augmentation, rng) for part in parts]
    offsets = np.cumsum([0, *(len(part) for part in parts)], dtype=np.int64)
    prepared = _native.prepare_segments(
        np.concatenate(parts), offsets, POINTS, config.alignment, config.threads
    )
    return reorder(prepared, config.sampler, rng or np.random.default_rng(config.seed))


def limited(dataset: SegmentDataset, config: TrainConfig) -> SegmentDataset:
    """At most `validation_limit` segments: whole objects, so that matches stay together."""
    if len(dataset) <= config.validation_limit:
        return dataset
    rng = np.random.default_rng(config.seed)
    names = rng.permutation(np.unique(dataset.labels))
    rank = np.empty(int(names.max()) + 1, np.int64)
    rank[names] = np.arange(len(names))
    order = np.argsort(rank[dataset.labels], kind="stable")[: config.validation_limit]
    return dataset.subset(np.sort(order))
