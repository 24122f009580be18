"""Descriptors -> matches: the nearest map descriptors of every query segment, pruned if asked."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from . import _native
from .descriptors import Pruner
from .map.segment_map import SegmentMap
from .types import Descriptors, Float32, Int64, Matches

Nearest = tuple[Int64, Float32]
"""Map segments and their distances, (P, K), nearest first."""


class MatchingConfig(BaseModel):
    """How many candidates a segment gets."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    neighbours: int = Field(25, ge=1, description="map segments proposed for each query segment")
    growth: float = Field(
        0.6, ge=0, description="they grow with this power of the map's size; 0: they do not"
    )
    grows_from: int = Field(50_000, ge=1, description="segments of a map from which they grow")
    max_neighbours: int = Field(200, ge=1, description="up to so many")
    escalation: int = Field(
        4,
        ge=1,
        description="times as many, once, where too few segments agree on a pose; 1: never",
    )
    max_escalated: int = Field(400, ge=1, description="up to so many")
    indexed_from: int = Field(
        100_000, ge=1, description="larger maps are searched through an index, not exactly"
    )
    list_size: int = Field(1000, ge=1, description="segments in a list of the index")
    probes: int = Field(48, ge=1, description="lists that are read for each query segment")
    min_probability: float = Field(
        0.5,
        ge=0,
        le=1,
        description="matches that the method's forest finds less likely are dropped",
    )

    def attempts(self, segments: int) -> tuple[int, ...]:
        """Neighbours proposed in a map of so many segments: at first, and where that fails.

        The more segments a map holds, the more of them look alike by chance, and the true
        neighbour falls behind.
        """
        share = max(1.0, segments / self.grows_from)
        grown = min(round(self.neighbours * share**self.growth), self.max_neighbours)
        first = max(self.neighbours, grown)
        second = min(self.escalation * first, self.max_escalated)
        return (first, second) if second > first else (first,)


class Matcher:
    """Finds, for every query descriptor, its nearest map descriptors.

    The search is exact, except in maps large enough for an index, where it reads the lists of
    descriptors around the nearest centres (an inverted file).

    Methods with a ``pruner`` then keep the matches that it finds likely.

    Attributes
    ----------
    attempts : tuple of int
        Neighbours of each query segment, at first and where that was too few.
    """

    def __init__(
        self,
        prior_map: SegmentMap,
        config: MatchingConfig | None = None,
        *,
        pruner: Pruner | None = None,
        threads: int = 0,
    ) -> None:
        self.config = config or MatchingConfig()
        self._quality = prior_map.quality
        self._vectors = np.ascontiguousarray(prior_map.vectors)
        self.attempts = self.config.attempts(len(prior_map))
        large = len(prior_map) > self.config.indexed_from
        lists = len(prior_map) // self.config.list_size if large else 1
        self._index = _native.DescriptorIndex(self._vectors, max(lists, 1), threads)
        self._pruner = pruner
        self._threads = threads

    def match(self, query: Descriptors, neighbours: int | None = None) -> Matches:
        """The nearest map segments of every query segment, best match first.

        So many of them for each; by default as many as in the first of the ``attempts``.
        A match's score is the likelihood exp(-distance), times the quality of both descriptors
        where they have one.
        """
        neighbours = neighbours or self.attempts[0]
        return self._matches(query, self._nearest(query, neighbours), neighbours)

    def proposals(self, query: Descriptors) -> Iterator[Matches]:
        """The matches of one of the ``attempts`` after another, each found when it is asked for.

        The lists of an index are read once, for all attempts: the first one takes the nearest of
        what the last one needs. That costs the first a third more, and spares the second one's
        search. Smaller maps are searched for each attempt.
        """
        indexed = self._index.lists > 1
        found: Nearest | None = None
        for neighbours in self.attempts:
            if found is None or not indexed:
                found = self._nearest(query, self.attempts[-1] if indexed else neighbours)
            yield self._matches(query, found, neighbours)

    def _nearest(self, query: Descriptors, neighbours: int) -> Nearest:
        return self._index.search(query.vectors, neighbours, self.config.probes, self._threads)

    def _matches(self, query: Descriptors, found: Nearest, neighbours: int) -> Matches:
        indices, distances = found[0][:, :neighbours], found[1][:, :neighbours]
        rows = np.repeat(np.arange(len(query), dtype=np.int64), indices.shape[1])
        columns, distance = indices.reshape(-1), distances.reshape(-1)
        score = np.exp(-distance)
        if query.quality is not None and self._quality is not None:
            score *= query.quality[rows] * self._quality[columns]
        return _ordered(rows, columns, distance, score)

    def prune(self, query: Descriptors, matches: Matches) -> Matches:
        """The matches that are likely enough, scored by that; all of them without a pruner."""
        if self._pruner is None:
            return matches
        score = self._pruner.probability(
            query.vectors, self._vectors, matches.query, matches.map, self._threads
        )
        keep = score >= self.config.min_probability
        return _ordered(matches.query[keep], matches.map[keep], matches.distance[keep], score[keep])


def _ordered(query: Int64, map_rows: Int64, distance: Float32, score: Float32) -> Matches:
    order = _native.order_matches(query, map_rows, score)
    return Matches(query[order], map_rows[order], distance[order], score[order])
