"""Coarse vote in a thin map of many tiles: poses supported by most matches."""

from __future__ import annotations

import numpy as np

from ..frontend.segmentation import Segmentation
from ..map.segment_map import SegmentMap
from ..prior import Prior, within
from ..types import Candidate, Descriptors, Int64, Matches
from .matching import Matcher
from .pose import PoseConfig, PoseEstimator

CANDIDATES = 32
"""Most poses proposed by a vote."""
GROWTH, PROBES = 0.3, 16
"""Effort of matching. Set on half a million segments: a vote needs only part of the matches."""
PRIOR_NEIGHBOURS = 8
"""Neighbours of a segment near a prior, where few segments are similar by chance."""


class CoarseVoter:
    """Proposes poses of a query in a thin map, to be verified in maps with a cloud.

    Parameters
    ----------
    thin : SegmentMap
        A few views of each object; without a cloud.
    matcher : Matcher
        Of this map.
    config : PoseConfig
    reach_m : float
        Radius of a local cloud [m].
    threads, seed : int
    """

    def __init__(
        self,
        thin: SegmentMap,
        matcher: Matcher,
        config: PoseConfig,
        reach_m: float,
        *,
        threads: int,
        seed: int,
    ) -> None:
        self._centroids, self._matcher = thin.centroids, matcher.cheaper(GROWTH, PROBES)
        self._reach_m = reach_m
        self._by_x = np.argsort(self._centroids[:, 0], kind="stable").astype(np.int32)
        self._x, self._y = self._centroids[self._by_x, :2].T.copy()
        pose = config.model_copy(update={"max_candidates": CANDIDATES})
        self._estimator = PoseEstimator(pose, threads=threads, seed=seed)

    def candidates(self, scene: Segmentation, descriptors: Descriptors) -> list[Candidate]:
        """Return poses T_map_local of a query, best first."""
        return self.poses(scene, self.matches(descriptors))

    def matches(self, descriptors: Descriptors, near: Prior | None = None) -> Matches:
        """Match the segments of a query in the thin map, or in its part near a prior."""
        if near is None or not near.has_position:
            return self._matcher.prune(descriptors, self._matcher.match(descriptors))
        matcher = self._matcher.among(self._rows(near))
        return matcher.prune(descriptors, matcher.match(descriptors, PRIOR_NEIGHBOURS))

    def poses(
        self, scene: Segmentation, matches: Matches, near: Prior | None = None
    ) -> list[Candidate]:
        """Return poses T_map_local supported by matches, best first."""
        centroids = scene.segments.centroids
        return within(near, self._estimator.estimate(centroids, self._centroids, matches))

    def _rows(self, near: Prior) -> Int64:
        """Return the rows of the thin map that may be in view near a prior."""
        far = near.radius_m + self._reach_m
        x, y = np.asarray(near.position)[:2]
        first, last = np.searchsorted(self._x, [x - far, x + far])
        square = np.abs(self._y[first:last] - y) <= far
        rows = np.sort(self._by_x[first:last][square]).astype(np.int64)
        return rows[near.rows(self._centroids[rows], self._reach_m)]
