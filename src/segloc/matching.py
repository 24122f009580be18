"""Descriptors -> matches: the nearest map descriptors of every query segment."""

from __future__ import annotations

import numpy as np
from pydantic import BaseModel, ConfigDict, Field
from scipy.spatial import cKDTree

from .types import Descriptors, Float32, Matches


class MatchingConfig(BaseModel):
    """How many candidates a segment gets."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    neighbours: int = Field(25, ge=1, description="map segments proposed for each query segment")


class Matcher:
    """Finds, for every query descriptor, its nearest map descriptors (exactly)."""

    def __init__(self, vectors: Float32, threads: int = 0) -> None:
        self._tree = cKDTree(vectors)
        self._vectors = vectors
        self._threads = threads

    def match(self, query: Descriptors, neighbours: int) -> Matches:
        """The ``neighbours`` nearest map segments of every query segment, best match first."""
        k = min(neighbours, len(self._vectors))
        distance, index = self._tree.query(query.vectors, k=k)
        rows = np.repeat(np.arange(len(query), dtype=np.int64), k)
        return _ordered(rows, index.reshape(-1), distance.reshape(-1).astype(np.float32))


def _ordered(query: np.ndarray, site: np.ndarray, distance: Float32) -> Matches:
    order = np.lexsort((site, query, distance))
    return Matches(query[order], site[order], distance[order], -distance[order])
