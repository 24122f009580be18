"""Local cloud -> candidate poses, by stems: for forests, where segments are inconclusive."""

from __future__ import annotations

import numpy as np

from segloc.frontend.segmentation import SegmentationConfig
from segloc.map.config import BuildConfig
from segloc.map.segment_map import SegmentMap
from segloc.map.voxel_cloud import VoxelCloud
from segloc.prior import Prior
from segloc.proposals.proposer import Query
from segloc.types import Candidate, Int64

from .config import Effort, LandmarkConfig, StemConfig
from .landmark_map import LandmarkMap
from .localizer import LandmarkLocalizer
from .stems import StemFinder, Stems

MIN_SUPPORT, MIN_SHARE = 5.0, 0.2
"""Least support of a pose by stems, and its share of the query's stems, for verification. In
simulated forests wrong poses have a share of at most 0.19, correct ones of at least 0.28."""
EFFORT = Effort()
"""More effort took half as long again in simulated forests, parks and towns, and found no more."""
RANGE_M, MAX_STEMS = 40.0, 96
"""Range of a query's stems, beyond which they have few points, and their largest number."""


class StemProposer:
    """Proposes poses at which the stems of a query lie on stems of the map.

    Parameters
    ----------
    cloud : VoxelCloud
        Cloud of the map with its ground.
    config : StemConfig, optional
    segmentation : SegmentationConfig, optional
        Definition of ground.

    Notes
    -----
    The first query finds the map's stems, in about 2 s per million points.
    """

    def __init__(
        self,
        cloud: VoxelCloud,
        config: StemConfig | None = None,
        segmentation: SegmentationConfig | None = None,
    ) -> None:
        self.config = config or StemConfig()
        self._cloud = cloud
        self._finder = StemFinder(self.config, segmentation)
        self._localizer: LandmarkLocalizer | None = None

    name = "stems"

    @classmethod
    def of(cls, prior_map: SegmentMap, config: BuildConfig) -> StemProposer:
        """Return the proposer of a map: the entry point of the group ``segloc.proposers``."""
        return cls(prior_map.voxel_cloud, segmentation=config.segmentation)

    def propose(self, query: Query, prior: Prior | None = None) -> list[Candidate]:
        """Propose poses by the stems of a query; none if it has few.

        The prior is not used: there are few stems, and a pose elsewhere reveals an alias.
        """
        scene, seen_from_origin = query.scene, query.cloud.num_scans == 1
        near = np.hypot(scene.surface[:, 0], scene.surface[:, 1]) < RANGE_M
        stems = self._finder.find(scene.surface[near], seen_from_origin=seen_from_origin)
        columns = stems.transform(np.eye(4))
        nearest = np.argsort(np.hypot(columns[:, 0], columns[:, 1]), kind="stable")
        columns = columns[np.sort(nearest[:MAX_STEMS])]
        if len(columns) < self.config.fewest:
            return []
        if self._localizer is None:  # concurrent callers build it twice, harmlessly
            self._localizer = LandmarkLocalizer(self._stem_map(), LandmarkConfig(efforts=(EFFORT,)))
        search, _ = self._localizer.search(columns)
        least = max(MIN_SUPPORT, MIN_SHARE * len(columns))
        found = [a for a in search.agreements if a.support >= least]
        return [Candidate(a.T_map_local, 0, a.support / len(columns)) for a in found]

    def _stem_map(self) -> LandmarkMap:
        stems = self._finder.find(self._cloud.points, spacing=self._cloud.voxel)
        rows = _largest(stems, self.config.most)
        columns = stems.transform(np.eye(4))[rows]
        positions = columns[:, :3] + self._cloud.origin
        views = np.ones(len(rows), np.int64)
        return LandmarkMap(positions, columns[:, 3:6], columns[:, 6], views, np.empty((0, 4, 4)))


def _largest(stems: Stems, most: int) -> Int64:
    """Return the rows of the stems with most points, in their order."""
    assert stems.counts is not None  # set by StemFinder
    return np.sort(np.argsort(-stems.counts, kind="stable")[:most])
