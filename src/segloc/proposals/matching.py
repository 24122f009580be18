"""Descriptors -> matches: the nearest map descriptors of every query segment, perhaps pruned."""

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
    schedule : tuple of int
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
        self.map_quality = prior_map.quality
        self._vectors = np.ascontiguousarray(prior_map.vectors)
        self.schedule = self.config.schedule(len(prior_map))
        large = len(prior_map) > self.config.indexed_from
        lists = len(prior_map) // self.config.list_size if large else 1
        self._index = _native.DescriptorIndex(self._vectors, max(lists, 1), threads)
        self._pruner = pruner
        self._threads = threads
        self._rows: Int64 | None = None  # of the map that are searched; None: all

    def among(self, rows: Int64) -> Matcher:
        """The same search among some of the map's segments alone, exact however many they are."""
        some = copy(self)
        some.schedule = self.config.schedule(len(rows))[: len(self.schedule)]
        vectors = np.ascontiguousarray(self._vectors[rows])
        some._index = _native.DescriptorIndex(vectors, 1, self._threads)
        some._rows = rows
        return some

    def once(self, growth: float, probes: int) -> Matcher:
        """The same search without a second attempt, for fewer neighbours from fewer lists."""
        some = copy(self)
        some.config = self.config.model_copy(update={"growth": growth, "probes": probes})
        some.schedule = some.config.schedule(len(self._vectors))[:1]
        return some

    def match(self, query: Descriptors, neighbours: int | None = None) -> Matches:
        """The nearest map segments of every query segment, best match first.

        So many of them for each; by default the first number of the ``schedule``.
        """
        return self.neighbours(query).matches(neighbours or self.schedule[0])

    def neighbours(self, query: Descriptors) -> NeighbourSearch:
        """The search for the neighbours of a query's segments."""
        return NeighbourSearch(self, query)

    def nearest(self, query: Descriptors, neighbours: int) -> Nearest:
        """So many map segments for each query segment, nearest first, with their distances."""
        found = self._index.search(query.vectors, neighbours, self.config.probes, self._threads)
        return found if self._rows is None else (self._rows[found[0]], found[1])

    @property
    def indexed(self) -> bool:
        """Whether the map is searched through an index."""
        return self._index.lists > 1

    def prune(self, query: Descriptors, matches: Matches) -> Matches:
        """The matches that are likely enough, scored by that; all of them without a pruner."""
        if self._pruner is None:
            return matches
        score = self._pruner.probability(
            query.vectors, self._vectors, matches.query, matches.map, self._threads
        )
        keep = score >= self.config.min_probability
        return _ordered(matches.query[keep], matches.map[keep], matches.distance[keep], score[keep])


class NeighbourSearch:
    """The neighbours of one query's segments, more of them when more are needed.

    The lists of an index are read once, for the longest of the schedule: shorter ones take the
    nearest of what it found. That costs the first a third more, and spares the second its search.
    Smaller maps are searched each time.
    """

    def __init__(self, matcher: Matcher, query: Descriptors) -> None:
        self._matcher, self._query = matcher, query
        self._found: Nearest | None = None

    def matches(self, neighbours: int) -> Matches:
        """So many map segments for each query segment, best match first.

        A match's score is the likelihood exp(-distance), times the quality of both descriptors
        where they have one.
        """
        nearest, distances = self._nearest(neighbours)
        nearest, distances = nearest[:, :neighbours], distances[:, :neighbours]
        rows = np.repeat(np.arange(len(self._query), dtype=np.int64), nearest.shape[1])
        columns, distance = nearest.reshape(-1), distances.reshape(-1)
        score = np.exp(-distance)
        map_quality = self._matcher.map_quality
        if self._query.quality is not None and map_quality is not None:
            score *= self._query.quality[rows] * map_quality[columns]
        return _ordered(rows, columns, distance, score)

    def _nearest(self, neighbours: int) -> Nearest:
        if not self._matcher.indexed:
            return self._matcher.nearest(self._query, neighbours)
        if self._found is None or self._found[0].shape[1] < neighbours:
            most = max(neighbours, self._matcher.schedule[-1])
            self._found = self._matcher.nearest(self._query, most)
        return self._found


def _ordered(query: Int64, map_rows: Int64, distance: Float32, score: Float32) -> Matches:
    order = _native.order_matches(query, map_rows, score)
    return Matches(query[order], map_rows[order], distance[order], score[order])
