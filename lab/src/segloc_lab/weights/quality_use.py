"""What FC4 and a descriptor's quality are good for, beside the distance of descriptors.

    python -m segloc_lab.weights.quality_use DATASET --methods dsm esm --store docs/results

For each network, the areas under the ROC of any pairs (centroids within 0.5 m against 20 m apart),
with a bootstrap over squares of 100 m of the difference to plain distance; and how well the
candidates that a map proposes, the nearest 25 of other sessions, are ordered: the area, and the
share of right ones among the first 1 and 10 %.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np
import torch

from segloc import _native
from segloc.descriptors.pointset import load_weights
from segloc.descriptors.weightfile import shipped_weights
from segloc.types import Float32, Float64, Int64

from ..results.fingerprints import DESCRIBING
from ..results.store import Cell, Result
from ..script import shown, storing
from ..studies.feature_quality.areas import areas, difference, gain
from ..studies.paper.pairs import labelled_pairs
from ..training.dataset import SegmentDataset
from ..training.pair_fitting import SAME_M
from ..training.scoring import describe, load_descriptor
from ..training.shards import load_dataset

_TOPS = (0.01, 0.1)
COLUMNS = (
    "network",
    "judge",
    "any pairs: area",
    "less distance (95 %)",
    "candidates: area",
    *(f"right among the first {top:.0%}" for top in _TOPS),
    "among all",
)


def main() -> None:
    options = storing(__doc__)
    options.add_argument("dataset", type=Path)
    options.add_argument("--name", default="fc4-order", help="of the stored table")
    options.add_argument("--methods", nargs="+", default=["dsm", "esm"])
    options.add_argument("--k", type=int, default=25)
    options.add_argument("--limit", type=int, default=8000, help="segments")
    given = options.parse_args()
    dataset = load_dataset(given.dataset).limited(given.limit, 0)
    rows: list[tuple[Cell, ...]] = []
    for method in given.methods:
        weights = shipped_weights(f"{method}.safetensors")
        vectors, quality = describe(load_descriptor(str(weights), 1), dataset)
        judges = _Judges(weights, vectors, quality)
        orders = _candidates(judges, dataset, vectors, given.k)
        for judge, areas_of in _any_pairs(judges, dataset).items():
            rows.append((method, judge, *areas_of, *orders[judge]))
    Result.measured(
        given.name,
        f"python -m segloc_lab.weights.quality_use {shown(given.dataset)} "
        f"--methods {' '.join(given.methods)} --k {given.k} --limit {given.limit} "
        "--store docs/results",
        COLUMNS,
        rows,
        stages=(*DESCRIBING, "training"),
        methods=tuple(given.methods),
        note=f"{len(dataset)} segments, the {given.k} nearest of other sessions of each.",
    ).tell(given.store)


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


def _any_pairs(judges: _Judges, dataset: SegmentDataset) -> Mapping[str, tuple[Cell, Cell]]:
    """By judge: the area, and how much larger it is than that of plain distance."""
    pairs = labelled_pairs(dataset, limit=10_000)
    same, places = torch.from_numpy(pairs.same), torch.from_numpy(pairs.places)
    scores = judges.scores(pairs.first, pairs.second)
    each = {k: areas(torch.from_numpy(v)[None], same, places) for k, v in scores.items()}
    return {
        name: (round(float(own.value[0]), 4), gain(difference(own, each["distance"])))
        for name, own in each.items()
    }


def _candidates(
    judges: _Judges, dataset: SegmentDataset, vectors: Float32, k: int
) -> Mapping[str, tuple[float, ...]]:
    """By judge: the area, and the shares of right ones among the first of :data:`_TOPS`."""
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
    return {name: tuple(_order(score, right)) for name, score in judges.scores(a, b).items()}


def _order(score: Float64, right: np.ndarray) -> Iterator[float]:
    order = np.argsort(-score, kind="stable")
    good, bad = score[right], np.sort(score[~right])
    low, high = (np.searchsorted(bad, good, side=side) for side in ("left", "right"))
    yield round(float((low + high).mean() / (2 * max(len(bad), 1))), 4)
    for top in (*_TOPS, 1.0):
        yield round(float(right[order[: max(1, int(top * len(order)))]].mean()), 4)


if __name__ == "__main__":
    main()
