"""Descriptors -> matches: the nearest map descriptors of every query segment."""

from __future__ import annotations

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from . import _native
from .map import SegmentMap
from .types import Descriptors, Float32, Int64, Matches


class MatchingConfig(BaseModel):
    """How many candidates a segment gets."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    neighbours: int = Field(25, ge=1, description="map segments proposed for each query segment")


class Matcher:
    """Finds, for every query descriptor, its nearest map descriptors (exactly)."""

    def __init__(
        self, site: SegmentMap, config: MatchingConfig | None = None, *, threads: int = 0
    ) -> None:
        self.config = config or MatchingConfig()
        self._quality = site.quality
        self._vectors = np.ascontiguousarray(site.vectors)
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


def _ordered(query: Int64, site: Int64, distance: Float32, score: Float32) -> Matches:
    order = np.lexsort((site, query, -score))
    return Matches(query[order], site[order], distance[order], score[order])
