"""Matching and different pairs of segments, and their scores by a method."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from segloc.descriptors.base import Descriptor, Pruner
from segloc.errors import DatasetError
from segloc.types import Float32, Float64, Int64

from ...training.dataset import FAR_M, SegmentDataset
from ...training.metrics import Interval, area_interval, bootstrap_places, describe
from ...training.pair_fitting import near_pairs


@dataclass(frozen=True)
class Pairs:
    """M pairs of segments of different sessions.

    Attributes
    ----------
    first, second : (M,) int64
        Indices into the dataset.
    same : (M,) bool
        Whether they show one object.
    places : (M,) int64
        Of the first segment, for a bootstrap over places.
    """

    first: Int64
    second: Int64
    same: NDArray[np.bool_]
    places: Int64

    def __len__(self) -> int:
        return len(self.same)


@dataclass(frozen=True)
class Described:
    """Descriptors of the segments of M pairs.

    Attributes
    ----------
    vectors : (P, dim) float32
    quality : (P,) float32 or None
    first, second : (M,) int64
        The pairs, as indices into ``vectors``.
    """

    vectors: Float32
    quality: Float32 | None
    first: Int64
    second: Int64


@dataclass(frozen=True)
class Roc:
    """A receiver operating characteristic.

    Attributes
    ----------
    false_positive, true_positive : (n,) float64
        Rates, rising from 0 to 1.
    area : Interval
        Below the curve, with its 95 % interval over places.
    """

    false_positive: Float64
    true_positive: Float64
    area: Interval

    def save(self, path: Path) -> None:
        """Write the curve and its area to a file."""
        with path.open("wb") as stream:
            np.savez(
                stream,
                false_positive=self.false_positive,
                true_positive=self.true_positive,
                area=np.array([self.area.value, self.area.low, self.area.high]),
            )

    @staticmethod
    def load(path: Path) -> Roc:
        """Read what :meth:`save` wrote."""
        with np.load(path, allow_pickle=False) as file:
            area = Interval(*(float(value) for value in file["area"]))
            return Roc(file["false_positive"], file["true_positive"], area)


def labelled_pairs(dataset: SegmentDataset, *, limit: int = 20_000, seed: int = 0) -> Pairs:
    """Draw as many matching as different pairs, all across sessions.

    The labels are the paper's: centroids within 0.5 m show one object, centroids more than 20 m
    apart (or in different worlds) two. Extents play no part, so some of the matching pairs show
    different parts of something.

    Parameters
    ----------
    limit : int
        Pairs of each kind at most, a random sample.
    """
    rng = np.random.default_rng(seed)
    a, b = near_pairs(dataset).T
    if len(a) == 0:
        raise DatasetError("no object is seen in two sessions")
    chosen = np.sort(rng.permutation(len(a))[:limit])
    a, b = a[chosen], b[chosen]
    c, d = _far(dataset, len(a), rng)
    first, second = np.concatenate([a, c]), np.concatenate([b, d])
    same = np.arange(len(first)) < len(a)
    return Pairs(first, second, same, bootstrap_places(dataset)[first])


def _far(dataset: SegmentDataset, count: int, rng: np.random.Generator) -> tuple[Int64, Int64]:
    """Draw ``count`` random pairs of different sessions more than 20 m apart."""
    found = [np.empty((0, 2), np.int64)]
    missing = count
    for _ in range(64):
        pairs = rng.integers(len(dataset), size=(4 * count, 2))
        a, b = pairs.T
        apart = np.linalg.norm(dataset.centroids[a] - dataset.centroids[b], axis=1) > FAR_M
        apart |= dataset.places[a] != dataset.places[b]
        pairs = pairs[apart & (dataset.sessions[a] != dataset.sessions[b])][:missing]
        found.append(pairs)
        missing -= len(pairs)
        if missing == 0:
            first, second = np.concatenate(found).T
            return first, second
    raise DatasetError(f"no two segments of different sessions lie {FAR_M:g} m apart")


def described(descriptor: Descriptor, dataset: SegmentDataset, pairs: Pairs) -> Described:
    """Describe the segments of pairs, each once."""
    used, place = np.unique(np.concatenate([pairs.first, pairs.second]), return_inverse=True)
    first, second = np.split(place.reshape(-1).astype(np.int64), 2)
    vectors, quality = describe(descriptor, dataset.subset(used))
    return Described(vectors, quality, first, second)


def pair_scores(found: Described, pruner: Pruner | None = None, threads: int = 1) -> Float64:
    """Return a method's score that each pair matches, (M,) float64.

    Minus the distance of the descriptors; where there is a pruner, the probability that it gives
    the pair: that of the forest of SegMatch and NSM, or of FC4 for ``-fq``
    (:class:`~segloc.descriptors.pointset.PairHead`).
    """
    if pruner is None:
        return -_distances(found)
    likely = pruner.probability(found.vectors, found.vectors, found.first, found.second, threads)
    return likely.astype(np.float64)


def trust_scores(found: Described) -> Float64 | None:
    """Return a map's candidate matches by falling score, (M,); None without a quality.

    The logarithm of exp(-distance) times both qualities, as in
    :meth:`segloc.proposals.matching.Matcher.match`. A quality is the probability that a segment's
    *nearest* descriptor is correct, not that a given pair shows one object.
    """
    if found.quality is None:
        return None
    sure = np.log(np.maximum(found.quality.astype(np.float64), 1e-12))
    return sure[found.first] + sure[found.second] - _distances(found)


def _distances(found: Described) -> Float64:
    between = found.vectors[found.first].astype(np.float64) - found.vectors[found.second]
    distances: Float64 = np.linalg.norm(between, axis=1)
    return distances


def roc(scores: Float64, pairs: Pairs, *, seed: int = 0, points: int = 200) -> Roc:
    """Return the ROC of scores (M,) of pairs.

    Parameters
    ----------
    scores : (M,)
    seed : int
        Of the bootstrap.
    points : int
        To which the curve is thinned; its area is that of all pairs.
    """
    order = np.argsort(-scores, kind="stable")
    last = np.append(np.diff(scores[order]) != 0, True)  # equal scores are one step
    right = np.cumsum(pairs.same[order])[last]
    wrong = np.cumsum(~pairs.same[order])[last]
    true = np.concatenate([[0.0], right / max(1, right[-1])])
    false = np.concatenate([[0.0], wrong / max(1, wrong[-1])])
    kept = _thinned(false, true, points)
    area = area_interval(
        scores[pairs.same],
        scores[~pairs.same],
        pairs.places[pairs.same],
        pairs.places[~pairs.same],
        np.random.default_rng(seed),
    )
    return Roc(false[kept], true[kept], area)


def _thinned(x: Float64, y: Float64, points: int) -> Int64:
    """Return indices of points spread evenly along a curve from (0, 0) to (1, 1)."""
    along = (x + y) / 2
    kept = np.searchsorted(along, np.linspace(0.0, 1.0, points) - 1e-12)
    return np.unique(np.clip(kept, 0, len(x) - 1)).astype(np.int64)
