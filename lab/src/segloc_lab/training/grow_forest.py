"""Train and export the random forest that prunes a method's candidate matches."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from segloc.descriptors import create
from segloc.descriptors.random_forest import (
    ForestDescriptor,
    Layout,
    PairForest,
    Trees,
)
from segloc.errors import ConfigError, DatasetError, MissingDependency
from segloc.proposals import MatchingConfig
from segloc.system import kernels
from segloc.system.section import Section
from segloc.types import Float32, Int64

from .dataset import SegmentDataset
from .metrics import share_below
from .writing import write_forest

Progress = Callable[[str], None]

_MAX_ODDS, _BISECTIONS = 4.0, 12


@dataclass(frozen=True)
class ForestScores:
    """Quality of a forest on candidates it was not trained on."""

    auc: float  # probability that a correct candidate is scored above a wrong one
    right_kept: float  # share of the correct candidates that pruning keeps by default
    wrong_kept: float


def train_forest(
    dataset: SegmentDataset,
    out: Path,
    method: str,
    config: ForestConfig | None = None,
    card: Mapping[str, Any] | None = None,
    progress: Progress = print,
) -> ForestScores:
    """Train the forest of a method, and write it to ``out`` (a .safetensors file).

    It classifies the candidates of matching as correct or wrong.

    Parameters
    ----------
    dataset : SegmentDataset
        Split by worlds (or by objects, if there is one world) into training and validation.
    method : str
        Method with a forest: segmatch-eigen, segmatch-esf or nsm.
    card : dict, optional
        Stored in the file: data, command, licence. Figures and settings are added.

    Returns
    -------
    ForestScores
        Of the exported forest on the validation set.
    """
    config = config or ForestConfig()
    descriptor = create(method, config.threads)
    if not isinstance(descriptor, ForestDescriptor):
        raise ConfigError(f"{method} has no forest to train")
    model = _classifier(config)
    some = dataset.limited(config.segments, config.seed)
    training, validation = some.split(config.validation_share, config.seed)
    vectors = descriptor.describe(training.segments()).vectors
    pairs = training_pairs(vectors, training, config)
    progress(f"{method}: {pairs.same.sum()} correct candidates, {(~pairs.same).sum()} wrong ones")
    layout = descriptor.layout
    features = kernels.pair_features(
        vectors, vectors, pairs.rows, pairs.columns, layout.row, config.threads
    )
    model.fit(features, pairs.same)
    trees = trees_of([estimator.tree_ for estimator in model.estimators_])
    held = descriptor.describe(validation.segments()).vectors
    pairs = candidates(held, validation, config, np.random.default_rng(config.seed))
    trees = _keeping(trees, layout, held, pairs, config)
    scores = _scores(PairForest(trees, layout, descriptor.dim), held, pairs, config)
    progress(f"{method}: {scores}")
    figures = {"training segments": len(training), "validation segments": len(validation)}
    text = {name: round(value, 4) for name, value in asdict(scores).items()}
    full = {**(card or {}), "figures": {**figures, **text}, "config": config.model_dump()}
    write_forest(out, trees, layout, descriptor.fingerprint, full)
    return scores


def _classifier(config: ForestConfig) -> Any:
    try:
        from sklearn.ensemble import RandomForestClassifier
    except ImportError as error:
        raise MissingDependency("scikit-learn", "lab", "training a forest") from error
    return RandomForestClassifier(
        config.trees,
        max_leaf_nodes=config.max_leaves,
        min_samples_leaf=config.min_pairs,
        class_weight="balanced",
        random_state=config.seed,
        n_jobs=config.threads,
    )


def trees_of(trees: list[Any]) -> Trees:
    """Convert scikit-learn's trees to arrays, with children side by side."""
    roots, parts, start = [], [], 0
    for tree in trees:
        roots.append(start)
        parts.append(_tree_arrays(tree, start))
        start += tree.node_count
    feature, threshold, child = (np.concatenate(part) for part in zip(*parts, strict=True))
    return Trees(np.array(roots, np.int32), feature, threshold, child)


def _tree_arrays(tree: Any, start: int) -> tuple[NDArray[np.int32], Float32, NDArray[np.int32]]:
    order = [0]  # breadth first, so that siblings are adjacent
    first_child = np.full(tree.node_count, -1, np.int32)
    for position in range(tree.node_count):
        node = order[position]
        if tree.children_left[node] >= 0:
            first_child[position] = start + len(order)
            order += [tree.children_left[node], tree.children_right[node]]
    nodes = np.array(order)
    inner = first_child >= 0
    shares = tree.value[nodes, 0]
    answers = (shares[:, 1] / shares.sum(axis=1)).astype(np.float32)
    threshold = np.where(inner, _rounded_down(tree.threshold[nodes]), answers)
    return np.where(inner, tree.feature[nodes], 0).astype(np.int32), threshold, first_child


def _rounded_down(thresholds: NDArray[np.float64]) -> Float32:
    """Round down to float32, so that comparisons of float32 features are unchanged."""
    rounded = thresholds.astype(np.float32)
    lower = np.nextafter(rounded, np.float32(-np.inf), dtype=np.float32)
    return np.where(rounded > thresholds, lower, rounded).astype(np.float32)


def _keeping(
    trees: Trees, layout: Layout, vectors: Float32, pairs: Candidates, config: ForestConfig
) -> Trees:
    """Scale the odds so that pruning keeps ``config.right_kept`` of the correct candidates.

    Poses are estimated from the candidates kept, so lost correct ones matter. All odds are scaled
    by one factor, found by bisection.
    """
    right = pairs.only(pairs.same)
    low, high = -_MAX_ODDS, _MAX_ODDS
    for _ in range(_BISECTIONS if len(right.rows) else 0):
        middle = (low + high) / 2
        forest = PairForest(_weighed(trees, middle), layout, vectors.shape[1])
        kept = _scores(forest, vectors, right, config).right_kept
        low, high = (low, middle) if kept > config.right_kept else (middle, high)
    return _weighed(trees, (low + high) / 2)


def _weighed(trees: Trees, log_odds: float) -> Trees:
    """Multiply the odds of all leaves by ``exp(log_odds)``."""
    answers = trees.threshold.astype(np.float64)
    weighed = answers * np.exp(log_odds)
    weighed = (weighed / (1 - answers + weighed)).astype(np.float32)
    return replace(trees, threshold=np.where(trees.first_child < 0, weighed, trees.threshold))


def _scores(
    forest: PairForest, vectors: Float32, pairs: Candidates, config: ForestConfig
) -> ForestScores:
    likely = forest.probability(vectors, vectors, pairs.rows, pairs.columns, config.threads)
    right, wrong = likely[pairs.same], likely[~pairs.same]
    auc = share_below(right, wrong) if len(right) and len(wrong) else 0.5
    least = MatchingConfig().min_probability
    kept = (float((part >= least).mean()) if len(part) else 0.0 for part in (right, wrong))
    return ForestScores(auc, *kept)


class ForestConfig(Section):
    """Settings of a forest and its training pairs."""

    trees: int = Field(25, ge=1)
    max_leaves: int = Field(512, ge=2, description="per tree; bounds the size of the file")
    min_pairs: int = Field(20, ge=1, description="minimum training pairs per leaf")
    pairs: int = Field(60_000, ge=2, description="maximum correct candidates; twice as many wrong")
    right_kept: float = Field(
        0.75, gt=0, lt=1, description="share of correct candidates kept in held-out worlds"
    )
    segments: int = Field(2_000_000, ge=2, description="maximum segments used, whole objects")
    queries: int = Field(200_000, ge=1, description="segments with candidates")
    map_segments: int = Field(8000, ge=1, description="segments of the maps of candidates")
    neighbours: int = Field(200, ge=1, description="candidates per segment, as in matching")
    different_m: float = Field(3.0, ge=0, description="minimum distance of other objects")
    validation_share: float = Field(0.2, gt=0, lt=1)
    seed: int = Field(0, ge=0)
    threads: int = Field(1, ge=1)


@dataclass(frozen=True)
class Candidates:
    """N pairs of segments, and whether they show one object."""

    rows: Int64
    columns: Int64
    same: NDArray[np.bool_]

    def only(self, chosen: NDArray[np.int64] | NDArray[np.bool_]) -> Candidates:
        """Return a subset."""
        return Candidates(self.rows[chosen], self.columns[chosen], self.same[chosen])


def training_pairs(vectors: Float32, dataset: SegmentDataset, config: ForestConfig) -> Candidates:
    """Return candidates of matching, equally many per world if possible."""
    rng = np.random.default_rng(config.seed)
    found = candidates(vectors, dataset, config, rng)
    if not found.same.any() or found.same.all():
        raise DatasetError("a forest needs at least two objects with two views")
    worlds = dataset.places[found.rows]
    share = -(-config.pairs // len(np.unique(worlds)))
    chosen = [np.empty(0, np.int64)]
    for world in np.unique(worlds):
        right = rng.permutation(np.flatnonzero((worlds == world) & found.same))[:share]
        wrong = rng.permutation(np.flatnonzero((worlds == world) & ~found.same))
        chosen += [right, wrong[: 2 * len(right)]]
    return found.only(np.concatenate(chosen))


def candidates(
    vectors: Float32, dataset: SegmentDataset, config: ForestConfig, rng: np.random.Generator
) -> Candidates:
    """Return candidates with one session as the map, and queries of its world's other sessions.

    Worlds are combined to maps of ``config.map_segments``. Uncertain pairs are dropped.
    """
    found = [(np.empty(0, np.int64), np.empty(0, np.int64))]
    group, turn = _shared_maps(dataset, config.map_segments)
    maps = [(group == g, turn == t) for g in np.unique(group) for t in np.unique(turn[group == g])]
    limit = config.queries // max(1, len(maps)) + 1
    for inside, there in maps:
        mapped = np.flatnonzero(inside & there)
        asking = inside & ~there if turn.any() else inside
        queries = rng.permutation(np.flatnonzero(asking))[:limit]
        if len(mapped) == 0 or len(queries) == 0:
            continue
        indices, _ = kernels.knn(
            vectors[queries], vectors[mapped], config.neighbours, config.threads
        )
        found.append((np.repeat(queries, indices.shape[1]), mapped[indices].reshape(-1)))
    rows, columns = (np.concatenate(part) for part in zip(*found, strict=True))
    same = dataset.labels[rows] == dataset.labels[columns]
    known = (same | dataset.different(rows, columns, config.different_m)) & (rows != columns)
    return Candidates(rows, columns, same).only(known)


def _shared_maps(dataset: SegmentDataset, least: int) -> tuple[Int64, Int64]:
    """Return the group of worlds of every segment, and its session within the world.

    The first sessions of a group's worlds have at least ``least`` segments, if available.
    """
    group, turn = np.zeros((2, len(dataset)), np.int64)
    number = gathered = 0
    for world in np.unique(dataset.places):
        own = np.flatnonzero(dataset.places == world)
        _, turn[own] = np.unique(dataset.sessions[own], return_inverse=True)
        group[own] = number
        gathered += int((turn[own] == 0).sum())
        if gathered >= least:
            number, gathered = number + 1, 0
    return group, turn
