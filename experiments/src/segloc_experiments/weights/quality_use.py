"""What a descriptor's quality is good for.

    python -m segloc_experiments.weights.quality_use WEIGHTS DATASET

Each session of the dataset is matched against the others. Printed are: how well the quality tells
right from wrong nearest neighbours; the recall of all queries and of the best 80 %; and how much of
the top of the match list is right when it is ordered by distance, by quality, and by both.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from segloc import _native
from segloc.training.scoring import describe, load_descriptor
from segloc.training.shards import load_dataset

from ..script import parser


def area(score: np.ndarray, right: np.ndarray) -> float:
    """Area under the ROC curve of a score."""
    good, bad = score[right], np.sort(score[~right])
    low, high = (np.searchsorted(bad, good, side=side) for side in ("left", "right"))
    return float((low + high).mean() / (2 * max(len(bad), 1)))


def main() -> None:
    options = parser(__doc__)
    options.add_argument("weights")
    options.add_argument("dataset", type=Path)
    options.add_argument("--k", type=int, default=25)
    given = options.parse_args()
    dataset = load_dataset(given.dataset)
    vectors, quality = describe(load_descriptor(given.weights, 1), dataset)
    if quality is None:
        raise SystemExit(f"{given.weights}: a descriptor without quality")
    ranks, distances, qualities = [], [], []
    for session in np.unique(dataset.sessions):
        own = np.flatnonzero(dataset.sessions == session)
        rest = np.flatnonzero(dataset.sessions != session)
        own = own[np.isin(dataset.labels[own], dataset.labels[rest])]
        if len(own) == 0:
            continue
        index, distance = _native.knn(vectors[own], vectors[rest], given.k, 1)
        hit = dataset.labels[rest][index] == dataset.labels[own][:, None]
        ranks.append(np.where(hit.any(axis=1), hit.argmax(axis=1), given.k))
        distances.append(distance[:, 0])
        qualities.append(quality[own])
    rank, near, worth = (np.concatenate(parts) for parts in (ranks, distances, qualities))
    right = rank == 0
    best = worth >= np.quantile(worth, 0.2)
    print(f"queries {len(rank)}; nearest right {right.mean():.4f}; mean quality {worth.mean():.4f}")
    by_quality, by_distance = area(worth, right), area(-near, right)
    print(f"ROC area of the quality {by_quality:.4f}, of the distance {by_distance:.4f}")
    for k in (1, 5, given.k):
        print(f"recall@{k}: all {(rank < k).mean():.4f}, best 80 % {(rank[best] < k).mean():.4f}")
    logit = np.log(np.clip(worth, 1e-6, 1 - 1e-6) / np.clip(1 - worth, 1e-6, 1))
    both = logit / max(logit.std(), 1e-9) - near / near.std()
    for name, score in (("distance", -near), ("quality", worth), ("both", both)):
        order = np.argsort(-score)
        shares = [right[order[: round(len(order) * top)]].mean() for top in (0.1, 0.25, 0.5)]
        print(f"right among the first 10, 25, 50 % by {name}: "
              + ", ".join(f"{share:.4f}" for share in shares))  # fmt: skip


if __name__ == "__main__":
    main()
