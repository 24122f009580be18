"""Local cloud -> candidate poses, by its stems: for forests, where segments say too little."""

from __future__ import annotations

import numpy as np

from ...frontend.segmentation import SegmentationConfig
from ...prior import Prior
from ...types import Candidate, Float32, Float64, Int64
from ..proposer import Proposals, Query
from .config import Effort, LandmarkConfig, StemConfig
from .landmark_map import LandmarkMap
from .localizer import LandmarkLocalizer
from .stems import StemFinder, Stems

LEAST_SUPPORT, LEAST_SHARE = 5.0, 0.2
"""Of stems on stems of the map: with less, a pose is not worth comparing clouds for. Wrong poses of
simulated forests have a share of at most 0.19, right ones 0.28 and more."""
EFFORT = Effort()
"""More of it found no more in simulated forests, parks and towns, in half as much time again."""
RANGE_M, MOST_STEMS = 40.0, 96
"""Stems of a query that are farther away are left out, since few points show them; and so are the
farthest where there are more."""


class StemProposer:
    """Proposes poses at which the stems that a query shows stand in the map, too.

    Parameters
    ----------
    cloud : (N, 3) float32
        The map's, relative to ``origin``; with its ground.
    origin : (3,) float64
    voxel : float
        That the cloud was thinned to, metres.
    config : StemConfig, optional
    segmentation : SegmentationConfig, optional
        What ground is.

    Notes
    -----
    The map's stems are found when they are first needed, in about 2 s a million points.
    """

    def __init__(
        self,
        cloud: Float32,
        origin: Float64,
        voxel: float,
        config: StemConfig | None = None,
        segmentation: SegmentationConfig | None = None,
    ) -> None:
        self.config = config or StemConfig()
        self._cloud, self._origin, self._voxel = cloud, origin, voxel
        self._finder = StemFinder(self.config, segmentation)
        self._localizer: LandmarkLocalizer | None = None

    name = "stems"
    exhaustive = False

    def propose(self, query: Query, prior: Prior | None = None) -> Proposals:
        """Propose poses by the stems of a query; none if it has few.

        The prior is not used: there are few stems, and a pose elsewhere shows an ambiguity.
        """
        scene, seen_from_origin = query.scene, query.cloud.num_scans == 1
        near = np.hypot(scene.surface[:, 0], scene.surface[:, 1]) < RANGE_M
        stems = self._finder.find(scene.surface[near], seen_from_origin=seen_from_origin)
        columns = stems.moved(np.eye(4))
        nearest = np.argsort(np.hypot(columns[:, 0], columns[:, 1]), kind="stable")
        columns = columns[np.sort(nearest[:MOST_STEMS])]
        if len(columns) < self.config.fewest:
            return Proposals([])
        if self._localizer is None:  # threads that ask at once make the same
            self._localizer = LandmarkLocalizer(self._mapped(), LandmarkConfig(efforts=(EFFORT,)))
        search, _ = self._localizer.search(columns)
        least = max(LEAST_SUPPORT, LEAST_SHARE * len(columns))
        found = [a for a in search.agreements if a.support >= least]
        candidates = [Candidate(a.T_map_local, 0, a.support / len(columns)) for a in found]
        return Proposals(candidates, search.reason is None)

    def _mapped(self) -> LandmarkMap:
        stems = self._finder.find(self._cloud, spacing=self._voxel)
        rows = _best_seen(stems, self.config.most)
        columns = stems.moved(np.eye(4))[rows]
        positions = columns[:, :3] + self._origin
        views = np.ones(len(rows), np.int64)
        return LandmarkMap(positions, columns[:, 3:6], columns[:, 6], views, np.empty((0, 4, 4)))


def _best_seen(stems: Stems, most: int) -> Int64:
    """Which stems most points show, in the order in which they are."""
    assert stems.counts is not None  # they were found
    return np.sort(np.argsort(-stems.counts, kind="stable")[:most])
