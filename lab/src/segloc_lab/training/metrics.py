"""ROC area and recall of descriptors."""

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
from segloc.descriptors.weightfile import open_weights
from segloc.errors import WeightsError
from segloc.system import kernels
from segloc.types import Float32

from .dataset import SegmentDataset, chunks
from .labels import pairs_of

_RESAMPLES = 500
"""Bootstrap resamples."""


@dataclass(frozen=True)
class Scores:
    """Scores of a set of descriptors; recalls are None if no object is in two sessions."""

    # Probability that a random matching pair (of different sessions if there are several) is closer
    # than a random pair of different objects.
    auc: float
    # Share of segments with a view in another session that have one among the 25 nearest
    # descriptors of other sessions.
    recall: float | None
    recall_first: float | None  # the same for the nearest descriptor

    def __str__(self) -> str:
        if self.recall is None or self.recall_first is None:
            return f"auc {self.auc:.4f}; no recall, which needs objects in two sessions"
        recalls = f"recall@25 {self.recall:.4f}, recall@1 {self.recall_first:.4f}"
        return f"auc {self.auc:.4f}, {recalls}"


def score(
    vectors: Float32, dataset: SegmentDataset, *, k: int = 25, seed: int = 0, threads: int = 1
) -> Scores:
    """Score descriptors (P, dim) of all segments of a dataset."""
    ranks = _ranks(vectors, dataset, k, threads)
    ranks = ranks[ranks >= 0]
    recall = float((ranks < k).mean()) if len(ranks) else None
    first = float((ranks == 0).mean()) if len(ranks) else None
    return Scores(_auc(vectors, dataset, np.random.default_rng(seed)), recall, first)


def nearest_is_right(
    vectors: Float32,
    dataset: SegmentDataset,
    threads: int = 1,
    distractors: Float32 | None = None,
) -> NDArray[np.float32]:
    """Return 1 where the nearest descriptor of another session is of the same object, (P,).

    0 if not, NaN if no other session shows the object. ``distractors`` (M, dim) enlarge the pool to
    a map's size.
    """
    ranks = _ranks(vectors, dataset, 1, threads, distractors)
    return np.where(ranks < 0, np.nan, ranks == 0).astype(np.float32)


def _ranks(
    vectors: Float32,
    dataset: SegmentDataset,
    k: int,
    threads: int,
    distractors: Float32 | None = None,
) -> NDArray[np.int64]:
    """Return the rank of the first correct one among the k nearest of other sessions, (P,).

    k if there is none, -1 if no other session shows the object.
    """
    ranks = np.full(len(dataset), -1, np.int64)
    for session in np.unique(dataset.sessions):
        queries = np.flatnonzero(dataset.sessions == session)
        others = np.flatnonzero(dataset.sessions != session)
        queries = queries[np.isin(dataset.labels[queries], dataset.labels[others])]
        if len(queries) == 0:
            continue
        pool, labels = vectors[others], dataset.labels[others]
        if distractors is not None:
            pool = np.concatenate([pool, distractors])
            labels = np.concatenate([labels, np.full(len(distractors), -1)])
        indices, _ = kernels.knn(
            np.ascontiguousarray(vectors[queries]), np.ascontiguousarray(pool), k, threads
        )
        hit = labels[indices] == dataset.labels[queries][:, None]
        ranks[queries] = np.where(hit.any(axis=1), hit.argmax(axis=1), k)
    return ranks


def _auc(vectors: Float32, dataset: SegmentDataset, rng: np.random.Generator) -> float:
    a, b = matching_pairs(dataset)
    if len(a) == 0:
        return 0.5
    count = max(len(a), 2000)
    c, d = _different_pairs(dataset, 4 * count, count, rng)
    positive = np.linalg.norm(vectors[a] - vectors[b], axis=1)
    negative = np.linalg.norm(vectors[c] - vectors[d], axis=1)
    return 1.0 - share_below(positive, negative) if len(negative) else 0.5


def share_below(values: NDArray[np.floating], others: NDArray[np.floating]) -> float:
    """Return the share of pairs with the other one below; equal ones count half."""
    others = np.sort(others)
    below = np.searchsorted(others, values, "left") + np.searchsorted(others, values, "right")
    return float(below.mean() / (2 * len(others)))


def matching_pairs(dataset: SegmentDataset) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return indices of all pairs of one label, of different sessions if there are several."""
    a, b = pairs_of(dataset.labels)
    if len(np.unique(dataset.sessions)) < 2:
        return a, b
    across = dataset.sessions[a] != dataset.sessions[b]
    return a[across], b[across]


@dataclass(frozen=True)
class Interval:
    """Value with its 95 % interval."""

    value: float
    low: float
    high: float

    def __str__(self) -> str:
        return f"{self.value:.4f} ({self.low:.4f} to {self.high:.4f})"


def auc_interval(vectors: Float32, dataset: SegmentDataset, *, seed: int = 0) -> Interval:
    """Return the area under the ROC with a bootstrap interval over places.

    Pairs of one place are correlated, so whole places are resampled: worlds if there are at least
    five, else squares of 100 m. A pair belongs to the place of its first segment.

    Parameters
    ----------
    vectors : (P, dim) float32
    """
    rng = np.random.default_rng(seed)
    places = bootstrap_places(dataset)
    a, b = matching_pairs(dataset)
    count = max(20_000, len(a))
    c, d = _different_pairs(dataset, 2 * count, count, rng)
    right = -np.linalg.norm(vectors[a] - vectors[b], axis=1)
    wrong = -np.linalg.norm(vectors[c] - vectors[d], axis=1)
    return area_interval(right, wrong, places[a], places[c], rng)


def area_interval(
    right: NDArray[np.floating],
    wrong: NDArray[np.floating],
    right_places: NDArray[np.int64],
    wrong_places: NDArray[np.int64],
    rng: np.random.Generator,
) -> Interval:
    """Return the area under the ROC of any score, with a bootstrap interval over places.

    Parameters
    ----------
    right, wrong : (R,), (W,)
        Scores of matching and different pairs; higher for matching ones.
    right_places, wrong_places : (R,), (W,) int64
        Place of each pair, from 0; see :func:`bootstrap_places`.

    Returns
    -------
    Interval
        0.5 within 0 and 1 if there are no pairs of one kind.
    """
    if len(right) == 0 or len(wrong) == 0:
        return Interval(0.5, 0.0, 1.0)
    order = np.argsort(wrong, kind="stable")
    low = np.searchsorted(wrong[order], right, side="left")
    high = np.searchsorted(wrong[order], right, side="right")

    def area(weights: NDArray[np.float64]) -> float:
        below = np.concatenate([[0.0], np.cumsum(weights[wrong_places[order]])])
        own = weights[right_places]
        return float(own @ (below[low] + below[high]) / (2 * below[-1] * own.sum()))

    count = int(max(right_places.max(), wrong_places.max())) + 1
    drawn = [
        area(weights)
        for weights in rng.multinomial(count, np.full(count, 1 / count), _RESAMPLES).astype(float)
        if weights[right_places].any() and weights[wrong_places].any()
    ]
    lower, upper = np.quantile(drawn, [0.025, 0.975]) if drawn else (0.0, 1.0)
    return Interval(area(np.ones(count)), float(lower), float(upper))


def bootstrap_places(dataset: SegmentDataset) -> NDArray[np.int64]:
    """Return the place of each segment (P,): its world, or its square of 100 m."""
    keys = dataset.places[:, None].astype(np.float64)
    if len(np.unique(dataset.places)) < 5:
        keys = np.column_stack([keys, np.floor(dataset.centroids[:, :2] / 100.0)])
    return np.unique(keys, axis=0, return_inverse=True)[1].reshape(-1).astype(np.int64)


def _different_pairs(
    dataset: SegmentDataset, draws: int, count: int, rng: np.random.Generator
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Draw up to ``count`` pairs that certainly differ."""
    a, b = rng.integers(len(dataset), size=(2, draws))
    differ = dataset.different(a, b)
    return a[differ][:count], b[differ][:count]


def recall_at_k(
    queries: Float32,
    pool: Float32,
    query_labels: NDArray[np.int64],
    pool_labels: NDArray[np.int64],
    ks: tuple[int, ...] = (1, 5, 25, 200),
    threads: int = 1,
) -> NDArray[np.float64]:
    """Return the share of queries with a correct one among their k nearest in the pool, per k.

    Parameters
    ----------
    queries : (Q, dim) float32
    pool : (M, dim) float32
    query_labels : (Q,) int64
    pool_labels : (M,) int64
        -1 for distractors. Queries with labels not in the pool are skipped.

    Returns
    -------
    (len(ks),) float64
        NaN if no query has a correct one.
    """
    known = np.isin(query_labels, pool_labels)
    if not known.any():
        return np.full(len(ks), np.nan)
    indices, _ = kernels.knn(
        np.ascontiguousarray(queries[known]), np.ascontiguousarray(pool), max(ks), threads
    )
    hit = pool_labels[indices] == query_labels[known][:, None]
    return np.array([hit[:, :k].any(axis=1).mean() for k in ks])


KS = (1, 5, 25, 200)
_CHUNK = 2048
_MAX_QUERIES = 5000
"""Maximum queries per session, chosen at random."""


@dataclass(frozen=True)
class Report:
    """Scores of a descriptor on a dataset."""

    auc: Interval
    recalls: list[tuple[int, NDArray[np.float64]]]  # size of the pool, and recall at each of KS
    queries: int


def load_descriptor(name: str, threads: int = 0) -> Descriptor:
    """Load a descriptor by the path of its weights, or a registered one by its name."""
    path = Path(name)
    if not path.is_file() and name in available():
        return create(name, threads)
    if not path.exists():
        raise WeightsError(f"{name}: neither a file nor a registered descriptor")
    with open_weights(path) as file:
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
    """Return vectors (P, dim) of all segments, and their qualities if available."""
    vectors, qualities = [], []
    for indices in chunks(len(dataset), _CHUNK):
        found = descriptor.describe(dataset.segments(indices))
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

    Each session queries all others of the dataset, enlarged by distractors to the sizes in
    ``pools`` if possible.

    Parameters
    ----------
    distractors : sequence of SegmentDataset
        Segments of other worlds.
    pools : sequence of int
        By default: the dataset's own segments, and all distractors.
    """
    vectors, _ = describe(descriptor, dataset)
    others = [describe(descriptor, part)[0] for part in distractors]
    rng = np.random.default_rng(seed)
    padding = np.concatenate([np.empty((0, vectors.shape[1]), np.float32), *others])
    padding = padding[rng.permutation(len(padding))]
    wanted = list(pools) or sorted({0, len(padding) and len(dataset) + len(padding)})
    sums = [np.zeros(len(KS)) for _ in wanted]
    sizes = [0] * len(wanted)
    queried = 0
    for session in np.unique(dataset.sessions):
        own = np.flatnonzero(dataset.sessions == session)
        rest = np.flatnonzero(dataset.sessions != session)
        own = own[np.isin(dataset.labels[own], dataset.labels[rest])]
        own = rng.permutation(own)[:_MAX_QUERIES]
        if len(own) == 0:
            continue
        queried += len(own)
        for i, size in enumerate(wanted):
            more = padding[: max(0, size - len(rest))]
            pool = np.concatenate([vectors[rest], more])
            labels = np.concatenate([dataset.labels[rest], np.full(len(more), -1)])
            found = recall_at_k(vectors[own], pool, dataset.labels[own], labels, KS, threads)
            sums[i] += found * len(own)
            sizes[i] = max(sizes[i], len(pool))
    recalls = [(size, total / max(queried, 1)) for size, total in zip(sizes, sums, strict=True)]
    return Report(auc_interval(vectors, dataset, seed=seed), recalls, queried)
