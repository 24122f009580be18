"""How good a descriptor is on a dataset: ROC area, and recall in pools of the size of a map."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from segloc.descriptors import available, create
from segloc.descriptors.base import Descriptor
from segloc.descriptors.pointset import PointSetDescriptor
from segloc.descriptors.profile import ProfileDescriptor
from segloc.descriptors.segmap import SegMapDescriptor
from segloc.descriptors.weightfile import opened
from segloc.errors import WeightsError
from segloc.types import Float32

from .dataset import SegmentDataset
from .metrics import Interval, auc_interval, recall_at_k

KS = (1, 5, 25, 200)
_CHUNK = 2048
_MAX_QUERIES = 5000
"""Queries of a session; if there are more, they are chosen at random."""


@dataclass(frozen=True)
class Report:
    """Figures of one descriptor on one dataset.

    Attributes
    ----------
    auc : Interval
    recalls : list of (pool, recalls)
        Size of the pool, and the recall at each of ``KS``.
    queries : int
    """

    auc: Interval
    recalls: list[tuple[int, NDArray[np.float64]]]
    queries: int


def load_descriptor(name: str, threads: int = 0) -> Descriptor:
    """A descriptor by the path of its weights, or a registered one by its name.

    Raises
    ------
    WeightsError
        If there is neither such a file nor such a name.
    """
    path = Path(name)
    if not path.exists():
        if name in available():
            return create(name, threads)
        raise WeightsError(f"{name}: no such file, and no descriptor of that name")
    with opened(path) as file:
        kind = file.metadata.get("format", "")
    if kind == "segloc network":
        return PointSetDescriptor(path.stem, path, judge="nearest", threads=threads)
    if kind == "segloc profile network":
        return ProfileDescriptor(path, threads)
    if kind == "segloc voxel network":
        return SegMapDescriptor(path, threads)
    raise WeightsError(f"{name}: not the weights of a descriptor")


def describe(
    descriptor: Descriptor, dataset: SegmentDataset
) -> tuple[Float32, NDArray[np.float32] | None]:
    """Vectors (P, dim) of all segments, and their qualities where the descriptor has them."""
    vectors, qualities = [], []
    for first in range(0, len(dataset), _CHUNK):
        part = dataset.segments(np.arange(first, min(first + _CHUNK, len(dataset))))
        found = descriptor.describe(part)
        vectors.append(found.vectors)
        qualities.append(found.quality)
    known = [quality for quality in qualities if quality is not None]
    return np.concatenate(vectors), np.concatenate(known) if len(known) == len(vectors) else None


def score_descriptor(
    descriptor: Descriptor,
    dataset: SegmentDataset,
    distractors: Sequence[SegmentDataset] = (),
    *,
    pools: Sequence[int] = (),
    seed: int = 0,
    threads: int = 1,
) -> Report:
    """Score a descriptor.

    Each session is asked against all others of the dataset, which distractors pad to the sizes in
    ``pools`` as far as they go.

    Parameters
    ----------
    descriptor : Descriptor
    dataset : SegmentDataset
    distractors : sequence of SegmentDataset
        Segments of other worlds.
    pools : sequence of int
        Without any: the dataset's own segments, and all distractors.
    seed, threads : int
    """
    vectors, _ = describe(descriptor, dataset)
    others = [describe(descriptor, part)[0] for part in distractors]
    rng = np.random.default_rng(seed)
    padding = np.concatenate([np.empty((0, vectors.shape[1]), np.float32), *others])
    padding = padding[rng.permutation(len(padding))]
    wanted = list(pools) or sorted({0, len(padding) and len(dataset) + len(padding)})
    sums = [np.zeros(len(KS)) for _ in wanted]
    sizes = [0] * len(wanted)
    asked = 0
    for session in np.unique(dataset.sessions):
        own = np.flatnonzero(dataset.sessions == session)
        rest = np.flatnonzero(dataset.sessions != session)
        own = own[np.isin(dataset.labels[own], dataset.labels[rest])]
        own = rng.permutation(own)[:_MAX_QUERIES]
        if len(own) == 0:
            continue
        asked += len(own)
        for i, size in enumerate(wanted):
            more = padding[: max(0, size - len(rest))]
            pool = np.concatenate([vectors[rest], more])
            labels = np.concatenate([dataset.labels[rest], np.full(len(more), -1)])
            found = recall_at_k(vectors[own], pool, dataset.labels[own], labels, KS, threads)
            sums[i] += found * len(own)
            sizes[i] = max(sizes[i], len(pool))
    recalls = [(size, total / max(asked, 1)) for size, total in zip(sizes, sums, strict=True)]
    return Report(auc_interval(vectors, dataset, seed=seed), recalls, asked)
