"""Poses from sets of matches that keep their distances: how SegMatch recognises places.

Dube et al., ICRA 2017 (arXiv 1609.07720), after the geometric consistency grouping of Chen and
Bhanu, 2007.
"""

from __future__ import annotations

import numpy as np
from pydantic import Field

from .. import _native
from ..geometry import Separation
from ..system.section import Section
from ..types import Float64, Int64, Matches


class ConsistencyConfig(Section):
    """When matches are consistent, and how many of them make a place."""

    resolution: float = Field(
        0.4,
        ge=0.001,
        le=100,
        description="edges between two matches differ in length by less, metres",
    )
    min_cluster: int = Field(
        4, ge=3, le=1000, description="distinct objects of a set that counts as a place"
    )
    max_sets: int = Field(
        64, ge=1, le=100_000, description="largest sets of which those at different places are kept"
    )


class ConsistentMatches:
    """Finds sets of matches in which every edge is as long in the query as in the map.

    Every match grows a set, unless it is in one already: again and again the match joins that is
    consistent with most of those that still may. Matches are compared only where their map
    segments are near enough. A set holds an object of the query, and a segment of the map, once.
    """

    def __init__(self, config: ConsistencyConfig, separation: Separation) -> None:
        self.config = config
        self._separation = separation

    def poses(
        self,
        query: Float64,
        map_centroids: Float64,
        matches: Matches,
        objects: Int64,
        most: int,
    ) -> tuple[Float64, Int64]:
        """Least-squares SE(3) of the largest sets at different places, and how many they hold.

        Parameters
        ----------
        query : (P, 3) float64
        map_centroids : (M, 3) float64
        matches : Matches
        objects : (P,) int64
            Which object each query segment is a part of.
        most : int
            Poses at most.

        Returns
        -------
        poses : (K, 4, 4) float64
            T_map_local, largest set first.
        sizes : (K,) int64
        """
        config = self.config
        poses, _, offsets = _native.consistent_sets(
            query,
            map_centroids,
            matches.query,
            matches.map,
            objects,
            resolution=config.resolution,
            min_size=config.min_cluster,
            max_sets=config.max_sets,
        )
        kept: list[int] = []
        for k, T in enumerate(poses):
            if all(self._separation.apart(poses[other], T) for other in kept):
                kept.append(k)
        return poses[kept[:most]], np.diff(offsets)[kept[:most]]
