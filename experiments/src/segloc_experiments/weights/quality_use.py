"""What FC4 and a descriptor's quality are good for, beside the distance of descriptors.

    python -m segloc_experiments.weights.quality_use WEIGHTS DATASET [--out FILE.json]

Given are the areas under the ROC of any pairs (centroids within 0.5 m against 20 m apart), with a
bootstrap over squares of 100 m of the difference to plain distance; and how well the candidates
that a map proposes, the nearest 25 of other sessions, are ordered: the area, and the share of right
ones among the first 1 and 10 %.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch

from segloc import _native
from segloc.descriptors.pointset import load_weights
from segloc.training.dataset import SegmentDataset
from segloc.training.pair_fitting import SAME_M
from segloc.training.scoring import describe, load_descriptor
from segloc.training.shards import load_dataset
from segloc.types import Float32, Float64, Int64

from ..feature_quality.areas import areas, difference
from ..paper.pairs import labelled_pairs
from ..script import parser

_TOPS = (0.01, 0.1)


def main() -> None:
    options = parser(__doc__)
    options.add_argument("weights", type=Path)
    options.add_argument("dataset", type=Path)
    options.add_argument("--k", type=int, default=25)
    options.add_argument("--limit", type=int, default=8000, help="segments")
    options.add_argument("--out", type=Path)
    given = options.parse_args()
    dataset = load_dataset(given.dataset).limited(given.limit, 0)
    vectors, quality = describe(load_descriptor(str(given.weights), 1), dataset)
    judges = _Judges(given.weights, vectors, quality)
    found = {
        "weights": given.weights.name,
        "dataset": given.dataset.name,
        "segments": len(dataset),
        "any pairs": _any_pairs(judges, dataset),
        "candidates": _candidates(judges, dataset, vectors, given.k),
    }
    print(json.dumps(found, indent=1))
    if given.out is not None:
        given.out.write_text(json.dumps(found, indent=1) + "\n", "utf-8")


class _Judges:
    """Scores of pairs by distance, by FC4, and by distance and both qualities."""

    def __init__(self, weights: Path, vectors: Float32, quality: Float32 | None) -> None:
        self._vectors, self._quality = vectors, quality
        self._head = load_weights(weights).pair_head

    def scores(self, a: Int64, b: Int64) -> dict[str, Float64]:
        """By judge; higher for pairs that rather show one object."""
        difference = self._vectors[a].astype(np.float64) - self._vectors[b]
        found = {"distance": -np.linalg.norm(difference, axis=1)}
        if self._head is not None:
            found["FC4"] = self._head.logits(self._vectors[a], self._vectors[b])
        if self._quality is not None:
            sure = np.log(np.maximum(self._quality.astype(np.float64), 1e-12))
            found["distance and quality"] = found["distance"] + sure[a] + sure[b]
        return found


def _any_pairs(judges: _Judges, dataset: SegmentDataset) -> dict[str, Any]:
    pairs = labelled_pairs(dataset, limit=10_000)
    same, places = torch.from_numpy(pairs.same), torch.from_numpy(pairs.places)
    scores = judges.scores(pairs.first, pairs.second)
    each = {k: areas(torch.from_numpy(v)[None], same, places) for k, v in scores.items()}
    return {
        name: {
            "area": round(float(own.value[0]), 4),
            "difference": _rounded(difference(own, each["distance"])),
        }
        for name, own in each.items()
    }


def _rounded(row: Mapping[str, float]) -> dict[str, float]:
    return {name: round(row[name], 4) for name in ("mean", "low", "high")}


def _candidates(
    judges: _Judges, dataset: SegmentDataset, vectors: Float32, k: int
) -> dict[str, Any]:
    queries, mapped = [], []
    for session in np.unique(dataset.sessions):
        own = np.flatnonzero(dataset.sessions == session)
        rest = np.flatnonzero(dataset.sessions != session)
        index, _ = _native.knn(vectors[own], vectors[rest], min(k, len(rest)), 1)
        queries.append(np.repeat(own, index.shape[1]))
        mapped.append(rest[index].reshape(-1))
    a, b = np.concatenate(queries), np.concatenate(mapped)
    near = np.linalg.norm(dataset.centroids[a] - dataset.centroids[b], axis=1) < SAME_M
    right = near & (dataset.places[a] == dataset.places[b])
    rows = {"right": round(float(right.mean()), 4)}
    return rows | {name: _order(score, right) for name, score in judges.scores(a, b).items()}


def _order(score: Float64, right: np.ndarray) -> dict[str, float]:
    order = np.argsort(-score, kind="stable")
    good, bad = score[right], np.sort(score[~right])
    low, high = (np.searchsorted(bad, good, side=side) for side in ("left", "right"))
    area = float((low + high).mean() / (2 * max(len(bad), 1)))
    tops = {f"first {t:.0%}": round(float(right[order[: int(t * len(order))]].mean()), 4)
            for t in _TOPS}  # fmt: skip
    return {"area": round(area, 4), **tops}


if __name__ == "__main__":
    main()
