"""Descriptors -> matches: the nearest map descriptors of each query segment, pruned if possible."""

from __future__ import annotations

from copy import copy

import numpy as np
from pydantic import Field

from .. import _native
from ..descriptors import Pruner
from ..map.segment_map import SegmentMap
from ..system.section import Section
from ..types import Descriptors, Float32, Int64, Matches

Nearest = tuple[Int64, Float32]
"""Map segments and their distances, (P, K), nearest first."""


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
        4,
        ge=1,
        le=1000,
        description="neighbour multiplier of the single retry; 1: no retry",
    )
    max_escalated: int = Field(400, ge=1, le=10000, description="most neighbours of the retry")
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

    def schedule(self, segments: int) -> tuple[int, ...]:
        """Return the neighbours per query segment: of the first attempt and of the retry.

        In a larger map more segments are similar by chance, so the true neighbour ranks lower.
        """
        share = max(1.0, segments / self.grows_from)
        grown = min(round(self.neighbours * share**self.growth), self.max_neighbours)
        first = max(self.neighbours, grown)
        second = min(self.escalation * first, self.max_escalated)
        return (first, second) if second > first else (first,)


class Matcher:
    """Finds the nearest map descriptors of each query descriptor.

    The search is exact, except in maps large enough for an index (an inverted file): there it reads
    the lists of descriptors around the nearest centres.

    Methods with a ``pruner`` then keep the probable matches.

    Attributes
    ----------
    schedule : tuple of int
        Neighbours per query segment: of the first attempt and of the retry.
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
        self.map_quality = prior_map.quality
        self._map = prior_map
        # Unpacked vectors are kept where each query needs them.
        self._vectors = None if pruner is None else prior_map.vectors
        self.schedule = self.config.schedule(len(prior_map))
        large = len(prior_map) > self.config.indexed_from
        lists = len(prior_map) // self.config.list_size if large else 1
        self._index = _index(prior_map, max(lists, 1), threads)
        self._pruner = pruner
        self._threads = threads
        self._rows: Int64 | None = None  # map rows to search; None: all

    def among(self, rows: Int64) -> Matcher:
        """Return a matcher for some of the map's segments; its search is exact."""
        some = copy(self)
        some.schedule = self.config.schedule(len(rows))[: len(self.schedule)]
        coded = self._map.coded_vectors
        vectors = np.ascontiguousarray(coded.rows(rows) if coded else self._map.vectors[rows])
        some._index = _native.DescriptorIndex(vectors, 1, self._threads)
        some._rows = rows
        return some

    def once(self, growth: float, probes: int) -> Matcher:
        """Return a matcher without a retry, for fewer neighbours from fewer lists."""
        some = copy(self)
        some.config = self.config.model_copy(update={"growth": growth, "probes": probes})
        some.schedule = some.config.schedule(len(self._map))[:1]
        return some

    def match(self, query: Descriptors, neighbours: int | None = None) -> Matches:
        """Match each query segment to its nearest map segments, best match first.

        Their number is ``neighbours``, by default the first of the ``schedule``.
        """
        return self.neighbours(query).matches(neighbours or self.schedule[0])

    def neighbours(self, query: Descriptors) -> NeighbourSearch:
        """Return the neighbour search of a query."""
        return NeighbourSearch(self, query)

    def nearest(self, query: Descriptors, neighbours: int) -> Nearest:
        """Return the nearest map segments of each query segment, with distances, nearest first."""
        found = self._index.search(query.vectors, neighbours, self.config.probes, self._threads)
        return found if self._rows is None else (self._rows[found[0]], found[1])

    @property
    def has_index(self) -> bool:
        """Whether the map has an approximate index."""
        return self._index.lists > 1

    def prune(self, query: Descriptors, matches: Matches) -> Matches:
        """Return the probable matches, scored by probability; all matches without a pruner."""
        if self._pruner is None or self._vectors is None:
            return matches
        score = self._pruner.probability(
            query.vectors, self._vectors, matches.query, matches.map, self._threads
        )
        keep = score >= self.config.min_probability
        return _order(matches.query[keep], matches.map[keep], matches.distance[keep], score[keep])


class NeighbourSearch:
    """Neighbour search of one query; a retry reuses the results of an index.

    An index is read once, for the largest number in the schedule. The first attempt takes the
    nearest of these, which costs it a third more; the retry is then free. Maps without an index are
    searched each time.
    """

    def __init__(self, matcher: Matcher, query: Descriptors) -> None:
        self._matcher, self._query = matcher, query
        self._found: Nearest | None = None

    def matches(self, neighbours: int) -> Matches:
        """Match each query segment to its nearest map segments, best match first.

        The score of a match is exp(-distance), times the quality of both descriptors if they have
        one.
        """
        nearest, distances = self._nearest(neighbours)
        nearest, distances = nearest[:, :neighbours], distances[:, :neighbours]
        rows = np.repeat(np.arange(len(self._query), dtype=np.int64), nearest.shape[1])
        columns, distance = nearest.reshape(-1), distances.reshape(-1)
        score = np.exp(-distance)
        map_quality = self._matcher.map_quality
        if self._query.quality is not None and map_quality is not None:
            score *= self._query.quality[rows] * map_quality[columns]
        return _order(rows, columns, distance, score)

    def _nearest(self, neighbours: int) -> Nearest:
        if not self._matcher.has_index:
            return self._matcher.nearest(self._query, neighbours)
        if self._found is None or self._found[0].shape[1] < neighbours:
            most = max(neighbours, self._matcher.schedule[-1])
            self._found = self._matcher.nearest(self._query, most)
        return self._found


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
