"""Descriptors -> matches: the nearest map descriptors of every query segment, pruned if asked."""

from __future__ import annotations

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from . import _native
from .descriptors import Pruner
from .map import SegmentMap
from .types import Descriptors, Float32, Int64, Matches


class MatchingConfig(BaseModel):
    """How many candidates a segment gets."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    neighbours: int = Field(25, ge=1, description="map segments proposed for each query segment")
    min_probability: float = Field(
        0.5,
        ge=0,
        le=1,
        description="matches that the method's forest finds less likely are dropped",
    )


class Matcher:
    """Finds, for every query descriptor, its nearest map descriptors (exactly).

    Methods with a ``pruner`` then keep the matches that it finds likely.
    """

    def __init__(
        self,
        site: SegmentMap,
        config: MatchingConfig | None = None,
        *,
        pruner: Pruner | None = None,
        threads: int = 0,
    ) -> None:
        self.config = config or MatchingConfig()
        self._quality = site.quality
        self._vectors = np.ascontiguousarray(site.vectors)
        self._pruner = pruner
        self._threads = threads

    def match(self, query: Descriptors) -> Matches:
        """The nearest map segments of every query segment, best match first.

        A match's score is the likelihood exp(-distance), times the quality of both descriptors
        where they have one.
        """
        indices, distances = _native.knn(
            query.vectors, self._vectors, self.config.neighbours, threads=self._threads
        )
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


def _ordered(query: Int64, site: Int64, distance: Float32, score: Float32) -> Matches:
    order = np.lexsort((site, query, -score))
    return Matches(query[order], site[order], distance[order], score[order])
