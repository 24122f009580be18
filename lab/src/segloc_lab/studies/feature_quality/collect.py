"""A dataset's segments and pairs as the compact file keeps them."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from segloc import _native

from ...training.dataset import SegmentDataset
from ...training.shards import load_dataset
from ..paper.pairs import labelled_pairs
from .compact import _LARGEST, _STEP_M, POINTS, Segments

_HELD_SHARE = 0.15


def compacted(folder: Path, split: str, most: int, pairs: int, seed: int = 0) -> Segments:
    """One split of a dataset; whole objects are left out where it has more than ``most`` segments.

    Parameters
    ----------
    folder : Path
    split : {"train", "test"}
        Of a training split some worlds are held out, as :meth:`SegmentDataset.split` parts them.
    most, pairs : int
        Segments, and pairs of each kind, at most.
    seed : int
    """
    dataset = load_dataset(folder).limited(most, seed)
    held = np.zeros(len(dataset), bool)
    first = second = np.empty(0, np.int64)
    same = np.empty(0, bool)
    if split == "train":
        _, apart = dataset.split(_HELD_SHARE, seed)
        held = np.isin(dataset.labels, apart.labels)
    else:
        found = labelled_pairs(dataset, limit=pairs, seed=seed)
        first, second, same = found.first, found.second, found.same
    points, offsets = _points(dataset)
    return Segments(
        points, offsets, dataset.labels, dataset.sessions, dataset.places, held,
        dataset.centroids, first, second, same,
    )  # fmt: skip


def _points(dataset: SegmentDataset) -> tuple[np.ndarray, np.ndarray]:
    segments = dataset.segments()
    sizes = np.minimum(np.diff(segments.offsets), POINTS)
    prepared = _native.prepare_segments(segments.points, segments.offsets, POINTS, "none", 1)
    kept = np.arange(POINTS)[None] < sizes[:, None]
    steps = np.clip(np.rint(prepared[kept] / _STEP_M), -_LARGEST, _LARGEST)
    offsets = np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64)
    return steps.astype(np.int16), offsets
