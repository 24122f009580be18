"""Descriptors -> matches: the nearest map descriptors of each query segment, pruned if possible."""

from __future__ import annotations

from collections.abc import Callable
from copy import copy

import numpy as np
from pydantic import Field

from .. import _native
from ..descriptors import Pruner
from ..map.segment_map import SegmentMap
from ..system.section import Section
from ..types import Descriptors, Float32, Int64, Matches

_MOST_ALONE = 32_768
"""Most matches of a query where nothing but segments proposes poses: as many as vote."""

_Nearest = Callable[[Float32, int, int, int], tuple[Int64, Float32]]
"""Finds the k nearest vectors of queries, in some lists: their rows in the map, and distances."""


class MatchingConfig(Section):
    """Number of matches per query segment."""

    neighbours: int = Field(
        25, ge=1, le=10000, description="map segments matched to each query segment"
    )
    growth: float = Field(
        0.6, ge=0, le=4, description="exponent of the map's size by which neighbours grow; 0: never"
    )
    grows_from: int = Field(
        50_000, ge=1, le=1000000000000, description="segments of a map from which neighbours grow"
    )
    max_neighbours: int = Field(200, ge=1, le=10000, description="most neighbours after growth")
    escalation: int = Field(
        4, ge=1, le=1000, description="most times as many for a query of few segments; 1: as many"
    )
    matches: int = Field(
        4000, ge=1, le=10**9, description="most matches of a query of few segments"
    )
    indexed_from: int = Field(
        100_000,
        ge=1,
        le=1000000000000,
        description="segments of a map from which an approximate index is used",
    )
    list_size: int = Field(1000, ge=1, le=1000000000, description="segments per list of the index")
    probes: int = Field(48, ge=1, le=1000000, description="lists read per query segment")
    min_probability: float = Field(
        0.5,
        ge=0,
        le=1,
        description="least probability of a match by the method's forest or FC4",
    )

    def neighbours_among(self, segments: int, queried: int) -> int:
        """Return the neighbours per segment of a query of ``queried`` segments in a map.

        In a larger map more segments are similar by chance, so the true neighbour ranks lower. A
        query of few segments needs more of their matches, and can afford them.
        """
        share = max(1.0, segments / self.grows_from)
        grown: int = round(self.neighbours * share**self.growth)
        least = max(self.neighbours, min(grown, self.max_neighbours))
        return max(least, min(self.escalation * least, self.matches // max(queried, 1)))

    def alone(self, segments: int) -> MatchingConfig:
        """Return the same for a map in which nothing but segments proposes poses.

        If it is one from which neighbours grow, larger queries have more of them, too.
        """
        more = max(self.matches, _MOST_ALONE)
        return self.model_copy(update={"matches": more}) if segments > self.grows_from else self


class Matcher:
    """Finds the nearest map descriptors of each query descriptor.

    The search is exact, except in maps large enough for an index (an inverted file): there it reads
    the lists of descriptors around the nearest centres.

    Methods with a ``pruner`` then keep the probable matches.
    """

    def __init__(
        self,
        prior_map: SegmentMap,
        config: MatchingConfig,
        *,
        pruner: Pruner | None = None,
        threads: int = 0,
    ) -> None:
        self.config = config
        self.map_quality = prior_map.quality
        self._map = prior_map
        # Unpacked vectors are kept where each query needs them.
        self._vectors = None if pruner is None else prior_map.vectors
        large = len(prior_map) > self.config.indexed_from
        lists = len(prior_map) // self.config.list_size if large else 1
        self._size = len(prior_map)
        self._nearest: _Nearest = _index(prior_map, max(lists, 1), threads).search
        self._pruner = pruner
        self._threads = threads

    def among(self, rows: Int64) -> Matcher:
        """Return a matcher for some of the map's segments; its search is exact.

        It has no index: one would cost as much as the searches of several queries.
        """
        some, coded = copy(self), self._map.coded_vectors
        vectors = np.ascontiguousarray(coded.rows(rows) if coded else self._map.vectors[rows])

        def nearest(queries: Float32, k: int, _: int, threads: int) -> tuple[Int64, Float32]:
            few, distances = _native.knn(queries, vectors, k, threads)
            return rows[few], distances

        some._size, some._nearest = len(rows), nearest
        return some

    def cheaper(self, growth: float, probes: int) -> Matcher:
        """Return a matcher for fewer neighbours from fewer lists."""
        some, fewer = copy(self), {"growth": growth, "probes": probes, "escalation": 1}
        some.config = self.config.model_copy(update=fewer)
        return some

    def match(self, query: Descriptors, neighbours: int | None = None) -> Matches:
        """Match each query segment to its nearest map segments, best match first.

        Their number is by default that of the configuration. The score of a match is
        exp(-distance), times the quality of both descriptors if they have one.
        """
        count = neighbours or self.config.neighbours_among(self._size, len(query))
        nearest, distances = self._nearest(query.vectors, count, self.config.probes, self._threads)
        rows = np.repeat(np.arange(len(query), dtype=np.int64), nearest.shape[1])
        columns, distance = nearest.reshape(-1), distances.reshape(-1)
        score = np.exp(-distance)
        if query.quality is not None and self.map_quality is not None:
            score *= query.quality[rows] * self.map_quality[columns]
        return _order(rows, columns, distance, score)

    def prune(self, query: Descriptors, matches: Matches) -> Matches:
        """Return the probable matches, scored by probability; all matches without a pruner."""
        if self._pruner is None or self._vectors is None:
            return matches
        score = self._pruner.probability(
            query.vectors, self._vectors, matches.query, matches.map, self._threads
        )
        keep = score >= self.config.min_probability
        return _order(matches.query[keep], matches.map[keep], matches.distance[keep], score[keep])


def _index(prior_map: SegmentMap, lists: int, threads: int) -> _native.DescriptorIndex:
    """Return the index of a map's descriptors; those of a lattice stay integers."""
    coded = prior_map.coded_vectors
    lattice = None if coded is None else coded.lattice()
    if coded is None or lattice is None:
        return _native.DescriptorIndex(np.ascontiguousarray(prior_map.vectors), lists, threads)
    return _native.DescriptorIndex(coded.codes, *lattice, lists, threads)


def _order(query: Int64, map_rows: Int64, distance: Float32, score: Float32) -> Matches:
    order = _native.order_matches(query, map_rows, score)
    return Matches(query[order], map_rows[order], distance[order], score[order])
