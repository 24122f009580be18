"""Matches -> candidate poses."""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

import numpy as np
from pydantic import Field

from .. import _native
from ..geometry import Separation
from ..system.section import Section
from ..types import Candidate, Float64, Int64, Matches, Pose


class ConsistencyConfig(Section):
    """Consistency of matches, and the size of a set."""

    resolution: float = Field(
        0.4,
        ge=0.001,
        le=100,
        description="tolerance of the length of an edge between two matches, metres",
    )
    min_cluster: int = Field(4, ge=3, le=1000, description="fewest distinct objects of a set")
    max_sets: int = Field(
        64, ge=1, le=100_000, description="most sets, before those at one place are merged"
    )


class PoseConfig(Section):
    """Estimation of poses from matches."""

    estimator: Literal["consensus", "prosac", "ransac", "geometric_consistency"] = Field(
        "consensus", description="consensus: yaw and translation, by votes; the others: SE(3)"
    )
    consistency: ConsistencyConfig = ConsistencyConfig()
    edge_tolerance: float = Field(
        0.5, gt=0, le=100, description="tolerance of the edges of a sample, metres (prosac, ransac)"
    )
    inlier_tolerance: float = Field(
        0.6, ge=0.001, le=10, description="largest horizontal residual of an inlier, metres"
    )
    height_tolerance: float = Field(
        1.0, gt=0, le=1000, description="largest vertical residual of an inlier, metres"
    )
    min_edge: float = Field(
        3.0,
        gt=0,
        le=1000,
        description="shortest edge of a sample, metres (prosac, ransac)",
    )
    distinct_radius: float = Field(
        1.0, ge=0, le=1000, description="radius within which segments count as one inlier, metres"
    )
    separation: Separation = Separation()
    max_refined: int = Field(48, ge=1, le=100_000, description="candidates refined by consensus")
    max_draws: int = Field(
        2_000_000, ge=1, le=10**9, description="most samples of prosac and ransac"
    )
    chance: float = Field(
        0.01,
        gt=0,
        lt=1,
        description="share of matches that fit a wrong pose by chance (prosac, ransac)",
    )
    max_candidates: int = Field(8, ge=1, le=1000, description="most candidates for verification")


def _objects(centroids: Float64, radius: float) -> Int64:
    """Return the object of each of (P, 3) segments: that of the first within the radius, in 2D.

    An object cut at two heights has two segments.
    """
    x, y = centroids[:, 0], centroids[:, 1]
    near = (x[:, None] - x) ** 2 + (y[:, None] - y) ** 2 < radius**2
    objects = np.arange(len(centroids), dtype=np.int64)
    first = near.argmax(axis=1) if len(near) else objects  # near[i, i] is true
    for i in np.flatnonzero(first < objects):
        objects[i] = objects[first[i]]
    return objects


class PoseEstimator:
    """Estimates poses supported by many matches, at different places, best first."""

    def __init__(
        self, config: PoseConfig | None = None, *, threads: int = 0, seed: int = 0
    ) -> None:
        self.config = config or PoseConfig()
        self._threads = threads
        self._seed = seed
        self._find = {
            "consensus": self._consensus,
            "prosac": self._sample,
            "ransac": self._sample,
            "geometric_consistency": self._consistent,
        }[self.config.estimator]

    def estimate(self, query: Float64, map_centroids: Float64, matches: Matches) -> list[Candidate]:
        """Estimate candidate poses T_map_local.

        Parameters
        ----------
        query : (P, 3) float64
            Segment centroids of the query cloud, local frame (z up).
        map_centroids : (M, 3) float64
            Segment centroids of the map, map frame (z up).
        matches : Matches
        """
        poses, inliers = self._find(query, map_centroids, matches)
        return [Candidate(T, int(n)) for T, n in zip(poses, inliers, strict=True)]

    def agreement(
        self, query: Float64, map_centroids: Float64, matches: Matches
    ) -> Callable[[Pose], int]:
        """Return a counter of the objects of a query that agree with a pose T_map_local.

        Parameters as :meth:`estimate`.
        """
        return _native.Agreement(
            query,
            map_centroids,
            matches.query,
            matches.map,
            distinct_radius=self.config.distinct_radius,
            inlier_tolerance=self.config.inlier_tolerance,
            height_tolerance=self.config.height_tolerance,
        ).count

    def _consensus(
        self, query: Float64, map_centroids: Float64, matches: Matches
    ) -> tuple[Float64, Int64]:
        config = self.config
        poses, inliers, _ = _native.consensus(
            query,
            map_centroids,
            matches.query,
            matches.map,
            inlier_tolerance=config.inlier_tolerance,
            height_tolerance=config.height_tolerance,
            distinct_radius=config.distinct_radius,
            separation=config.separation.metres,
            separation_deg=config.separation.degrees,
            max_refined=config.max_refined,
            max_hypotheses=config.max_candidates,
            threads=self._threads,
        )
        return poses, inliers

    def _sample(
        self, query: Float64, map_centroids: Float64, matches: Matches
    ) -> tuple[Float64, Int64]:
        config = self.config
        return _native.prosac(
            query,
            map_centroids,
            matches.query,
            matches.map,
            ordered=config.estimator == "prosac",
            edge_tolerance=config.edge_tolerance,
            inlier_tolerance=config.inlier_tolerance,
            min_edge=config.min_edge,
            chance=config.chance,
            separation=config.separation.metres,
            separation_deg=config.separation.degrees,
            max_draws=config.max_draws,
            max_hypotheses=config.max_candidates,
            seed=self._seed,
        )

    def _consistent(
        self, query: Float64, map_centroids: Float64, matches: Matches
    ) -> tuple[Float64, Int64]:
        """Return the least-squares SE(3) of the largest sets at different places, and their sizes.

        The edges of a set have equal lengths in the query and in the map. Each match that is in no
        set yet starts one. The set repeatedly gains the match that is consistent with most of the
        remaining ones. Only matches with nearby map segments are compared. A set holds each query
        object and each map segment once.
        """
        config, sets = self.config, self.config.consistency
        poses, _, offsets = _native.consistent_sets(
            query,
            map_centroids,
            matches.query,
            matches.map,
            _objects(query, config.distinct_radius),
            resolution=sets.resolution,
            min_size=sets.min_cluster,
            max_sets=sets.max_sets,
        )
        kept: list[int] = []
        for k, T in enumerate(poses):
            if all(config.separation.apart(poses[other], T) for other in kept):
                kept.append(k)
        kept = kept[: config.max_candidates]
        return poses[kept], np.diff(offsets)[kept]
