"""One vote in a thin map of many places: poses on which most matches agree."""

from __future__ import annotations

import numpy as np

from ..config import Config
from ..frontend.segmentation import Segmentation
from ..map.segment_map import SegmentMap
from ..prior import Prior, within
from ..proposals.matching import Matcher
from ..proposals.pose import PoseEstimator
from ..types import Candidate, Descriptors, Int64, Matches

CANDIDATES = 32
"""Poses that a vote proposes."""
GROWTH, PROBES = 0.3, 16
"""Of matching: a vote need not find all that agrees. Set by queries in half a million segments."""
NEAR = 8
"""Neighbours of a segment near a prior: there are few that look alike by chance."""


class ThinVote:
    """Says where in a thin map a query may be; what it shows must be looked at elsewhere.

    Parameters
    ----------
    thin : SegmentMap
        A few views of each object; without a cloud.
    matcher : Matcher
        In this map.
    config : Config
    """

    def __init__(self, thin: SegmentMap, matcher: Matcher, config: Config) -> None:
        self._centroids, self._matcher = thin.centroids, matcher.once(GROWTH, PROBES)
        self._reach_m = config.local_cloud.radius_m
        self._by_x = np.argsort(self._centroids[:, 0], kind="stable").astype(np.int32)
        self._x, self._y = self._centroids[self._by_x, :2].T.copy()
        pose = config.pose.model_copy(update={"max_candidates": CANDIDATES})
        self._estimator = PoseEstimator(pose, threads=config.threads, seed=config.seed)

    def candidates(
        self, scene: Segmentation, descriptors: Descriptors, near: Prior | None = None
    ) -> list[Candidate]:
        """Poses T_map_local of a query, best first; near a prior, if there is one."""
        return self.poses(scene, self.matches(descriptors, near), near)

    def matches(self, descriptors: Descriptors, near: Prior | None = None) -> Matches:
        """What of the thin map a query's segments look like."""
        if near is None:
            return self._matcher.prune(descriptors, self._matcher.match(descriptors))
        matcher = self._matcher.among(self._rows(near))
        return matcher.prune(descriptors, matcher.match(descriptors, NEAR))

    def poses(
        self, scene: Segmentation, matches: Matches, near: Prior | None = None
    ) -> list[Candidate]:
        """Poses T_map_local on which matches agree, best first."""
        centroids = scene.segments.centroids
        return within(near, self._estimator.estimate(centroids, self._centroids, matches))

    def _rows(self, near: Prior) -> Int64:
        """What may be in view near a prior; only what lies in a square about it is looked at."""
        far = near.radius_m + self._reach_m
        x, y = np.asarray(near.position)[:2]
        first, last = np.searchsorted(self._x, [x - far, x + far])
        square = np.abs(self._y[first:last] - y) <= far
        rows = np.sort(self._by_x[first:last][square]).astype(np.int64)
        return rows[near.rows(self._centroids[rows], self._reach_m)]
