"""What a forest learns from: candidates that matching proposes, and whether they are right."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from segloc import _native
from segloc.errors import DatasetError
from segloc.system.section import Section
from segloc.types import Float32, Int64

from .dataset import SegmentDataset


class ForestConfig(Section):
    """How a forest is grown, and from which pairs."""

    trees: int = Field(25, ge=1)
    max_leaves: int = Field(512, ge=2, description="of one tree: bounds the size of the file")
    min_pairs: int = Field(20, ge=1, description="training pairs in a leaf at least")
    pairs: int = Field(60_000, ge=2, description="right candidates at most; of wrong ones twice")
    right_kept: float = Field(
        0.75, gt=0, lt=1, description="of the right candidates, of worlds that are held out"
    )
    segments: int = Field(2_000_000, ge=2, description="of the dataset at most, whole objects")
    queries: int = Field(200_000, ge=1, description="segments whose candidates are looked at")
    map_segments: int = Field(8000, ge=1, description="of the maps that propose candidates")
    neighbours: int = Field(200, ge=1, description="candidates a segment, as in matching")
    different_m: float = Field(3.0, ge=0, description="other objects lie at least this far apart")
    validation_share: float = Field(0.2, gt=0, lt=1)
    seed: int = Field(0, ge=0)
    threads: int = Field(1, ge=1)


@dataclass(frozen=True)
class Candidates:
    """N pairs of segments, and whether they show one object.

    Attributes
    ----------
    rows, columns : (N,) int64
    same : (N,) bool
    """

    rows: Int64
    columns: Int64
    same: NDArray[np.bool_]

    def only(self, chosen: NDArray[np.int64] | NDArray[np.bool_]) -> Candidates:
        """Some of them."""
        return Candidates(self.rows[chosen], self.columns[chosen], self.same[chosen])


def training_pairs(vectors: Float32, dataset: SegmentDataset, config: ForestConfig) -> Candidates:
    """Candidates that matching proposes: of every world as many, as far as there are.

    Raises
    ------
    DatasetError
        If there are no pairs of one kind.
    """
    rng = np.random.default_rng(config.seed)
    found = candidates(vectors, dataset, config, rng)
    if not found.same.any() or found.same.all():
        raise DatasetError("a forest needs objects with two views, and two objects at least")
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
    return Candidates(rows, columns, same).only(known)


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
