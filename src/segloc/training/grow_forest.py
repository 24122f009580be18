"""Train the random forest by which a method prunes its candidate matches, and export it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from .. import _native
from ..descriptors import create
from ..descriptors.random_forest import ForestDescriptor, PairForest, Trees, save_forest
from ..errors import ConfigError, DatasetError, MissingDependency
from ..matching import MatchingConfig
from ..section import Section
from ..types import Float32, Int64
from .dataset import SegmentDataset

Progress = Callable[[str], None]


class ForestConfig(Section):
    """How a forest is grown, and from which pairs."""

    trees: int = Field(25, ge=1)
    max_leaves: int = Field(512, ge=2, description="of one tree: bounds the size of the file")
    min_pairs: int = Field(20, ge=1, description="training pairs in a leaf at least")
    pairs: int = Field(60_000, ge=2, description="right candidates at most; of wrong ones twice")
    segments: int = Field(2_000_000, ge=2, description="of the dataset at most, whole objects")
    queries: int = Field(200_000, ge=1, description="segments whose candidates are looked at")
    map_segments: int = Field(8000, ge=1, description="of the maps that propose candidates")
    neighbours: int = Field(200, ge=1, description="candidates a segment, as in matching")
    different_m: float = Field(3.0, ge=0, description="other objects lie at least this far apart")
    validation_share: float = Field(0.2, gt=0, lt=1)
    seed: int = Field(0, ge=0)
    threads: int = Field(1, ge=1)


@dataclass(frozen=True)
class ForestScores:
    """How well a forest sorts the candidates of segments that it was not grown on.

    Attributes
    ----------
    auc : float
        Chance that it finds a right candidate likelier than a wrong one.
    right_kept, wrong_kept : float
        Shares of the right and of the wrong candidates that pruning keeps by default.
    """

    auc: float
    right_kept: float
    wrong_kept: float


def train_forest(
    dataset: SegmentDataset,
    out: Path,
    method: str,
    config: ForestConfig | None = None,
    card: Mapping[str, Any] | None = None,
    progress: Progress = print,
) -> ForestScores:
    """Grow the forest of a method, and write it to ``out`` (a .safetensors file).

    It learns to tell the right ones from the wrong ones among the candidates that matching
    proposes.

    Parameters
    ----------
    dataset : SegmentDataset
        Split by worlds (or by objects, if there is one world) into training and validation.
    out : Path
    method : str
        One with a forest: segmatch-eigen, segmatch-esf or nsm.
    config : ForestConfig
    card : dict, optional
        Goes into the file: data, command, licence. Figures and settings are added.
    progress : callable

    Returns
    -------
    ForestScores
        Of the exported forest on the validation set.

    Raises
    ------
    ConfigError
        If the method has no forest.
    DatasetError
        If there is no object with two views, or there are not two objects.
    MissingDependency
        Without scikit-learn.
    """
    config = config or ForestConfig()
    descriptor = create(method, config.threads)
    if not isinstance(descriptor, ForestDescriptor):
        raise ConfigError(f"{method} has no forest to train")
    model = _classifier(config)
    some = dataset.limited(config.segments, config.seed)
    training, validation = some.split(config.validation_share, config.seed)
    vectors = descriptor.describe(training.segments()).vectors
    rows, columns, same = training_pairs(vectors, training, config)
    progress(f"{method}: {same.sum()} right candidates, {(~same).sum()} wrong ones")
    features = _native.pair_features(
        vectors, vectors, rows, columns, descriptor.layout.row, config.threads
    )
    model.fit(features, same)
    trees = trees_of([estimator.tree_ for estimator in model.estimators_])
    forest = PairForest(trees, descriptor.layout, descriptor.dim)
    scores = _scores(forest, descriptor, validation, config)
    progress(f"{method}: {scores}")
    figures = {"training segments": len(training), "validation segments": len(validation)}
    text = {name: round(value, 4) for name, value in asdict(scores).items()}
    full = {**(card or {}), "figures": {**figures, **text}, "config": config.model_dump()}
    save_forest(out, trees, descriptor.layout, descriptor.fingerprint, full)
    return scores


def training_pairs(
    vectors: Float32, dataset: SegmentDataset, config: ForestConfig
) -> tuple[Int64, Int64, NDArray[np.bool_]]:
    """Candidates that matching proposes, and whether they show one object.

    Raises
    ------
    DatasetError
        If there are no pairs of one kind.
    """
    rng = np.random.default_rng(config.seed)
    rows, columns, same = _candidates(vectors, dataset, config, rng)
    right, wrong = np.flatnonzero(same), np.flatnonzero(~same)
    if len(right) == 0 or len(wrong) == 0:
        raise DatasetError("a forest needs objects with two views, and two objects at least")
    right = rng.permutation(right)[: config.pairs]
    wrong = rng.permutation(wrong)[: 2 * len(right)]
    chosen = np.concatenate([right, wrong])
    return rows[chosen], columns[chosen], same[chosen]


def _candidates(
    vectors: Float32, dataset: SegmentDataset, config: ForestConfig, rng: np.random.Generator
) -> tuple[Int64, Int64, NDArray[np.bool_]]:
    """What matching proposes where one session is the map and the others of its world ask.

    Worlds are taken together until there are ``config.map_segments`` in a map. Pairs that may or
    may not show one object are left out.
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
        indices, _ = _native.knn(
            vectors[queries], vectors[mapped], config.neighbours, config.threads
        )
        found.append((np.repeat(queries, indices.shape[1]), mapped[indices].reshape(-1)))
    rows, columns = (np.concatenate(part) for part in zip(*found, strict=True))
    same = dataset.labels[rows] == dataset.labels[columns]
    known = (same | dataset.different(rows, columns, config.different_m)) & (rows != columns)
    return rows[known], columns[known], same[known]


def _shared_maps(dataset: SegmentDataset, least: int) -> tuple[Int64, Int64]:
    """Of every segment, the group of its world, and which of the world's sessions saw it.

    The first sessions of a group's worlds have ``least`` segments together, where there are so
    many.
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


def _classifier(config: ForestConfig) -> Any:
    try:
        from sklearn.ensemble import RandomForestClassifier
    except ImportError as error:
        raise MissingDependency("scikit-learn", "baselines", "training a forest") from error
    return RandomForestClassifier(
        config.trees,
        max_leaf_nodes=config.max_leaves,
        min_samples_leaf=config.min_pairs,
        class_weight="balanced",
        random_state=config.seed,
        n_jobs=config.threads,
    )


def trees_of(trees: list[Any]) -> Trees:
    """scikit-learn's trees as arrays, children side by side behind their parent."""
    roots, parts, start = [], [], 0
    for tree in trees:
        roots.append(start)
        parts.append(_tree_arrays(tree, start))
        start += tree.node_count
    feature, threshold, child = (np.concatenate(part) for part in zip(*parts, strict=True))
    return Trees(np.array(roots, np.int32), feature, threshold, child)


def _tree_arrays(tree: Any, start: int) -> tuple[NDArray[np.int32], Float32, NDArray[np.int32]]:
    order = [0]  # breadth first, so that a node's children follow each other
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
    """The largest float32 that is not above: float32 features then compare as before."""
    rounded = thresholds.astype(np.float32)
    lower = np.nextafter(rounded, np.float32(-np.inf), dtype=np.float32)
    return np.where(rounded > thresholds, lower, rounded).astype(np.float32)


def _scores(
    forest: PairForest, descriptor: ForestDescriptor, dataset: SegmentDataset, config: ForestConfig
) -> ForestScores:
    vectors = descriptor.describe(dataset.segments()).vectors
    rows, columns, same = _candidates(vectors, dataset, config, np.random.default_rng(config.seed))
    likely = forest.probability(vectors, vectors, rows, columns, config.threads)
    right, wrong = likely[same], np.sort(likely[~same])
    if len(right) == 0 or len(wrong) == 0:
        return ForestScores(0.5, 0.0, 0.0)
    below = np.searchsorted(wrong, right, "left") + np.searchsorted(wrong, right, "right")
    auc = float(below.mean() / (2 * len(wrong)))
    least = MatchingConfig().min_probability
    return ForestScores(auc, float((right >= least).mean()), float((wrong >= least).mean()))
