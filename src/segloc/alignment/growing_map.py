"""Which parts may show what a submap shows: one vote in a thin map of all parts before it.

The map grows part by part. Each part lies in it at a place of its own, far from all others, so that
a vote for poses says which parts they are in. So a submap is localized in a few parts, however
many there are.
"""

from __future__ import annotations

import math

import numpy as np

from ..config import Config
from ..descriptors import create
from ..map.compact import CompactConfig, best_views
from ..map.parts import concatenated
from ..map.segment_map import SegmentMap
from ..map.voxel_cloud import VoxelCloud
from ..matching import Matcher
from ..pose import PoseEstimator
from ..types import Float64, Int64
from .config import AlignConfig
from .loops import Chain
from .submaps import Submap

SPACING = 5.185
"""Between parts, as a multiple of their length: no multiple of the cells that votes fall into."""
CANDIDATES = 32
_VIEWS = CompactConfig(max_views=2)


def thin(prior_map: SegmentMap) -> SegmentMap:
    """The best views of each object of a part, without a cloud."""
    return prior_map.kept(best_views(prior_map, _VIEWS), np.zeros(len(prior_map.cloud), dtype=bool))


def laid_out(parts: list[SegmentMap], part_m: float) -> SegmentMap:
    """Thin parts as one map: in their order, each about a place of its own, as a session."""
    side, spacing_m = _side(len(parts)), SPACING * part_m
    slots = [(k % side * spacing_m, k // side * spacing_m, 0.0) for k in range(len(parts))]
    moved = [_moved(part, k, slot) for k, (part, slot) in enumerate(zip(parts, slots, strict=True))]
    return concatenated(moved)


def _side(count: int) -> int:
    return max(1, math.isqrt(max(count - 1, 0)) + 1)


def _moved(part: SegmentMap, k: int, place: tuple[float, float, float]) -> SegmentMap:
    columns = part.columns()
    if len(part):
        columns["centroids"] = part.centroids - part.centroids.mean(axis=0) + np.array(place)
    columns["session"] = np.full(len(part), k, np.int32)
    cloud = VoxelCloud(np.empty((0, 3), np.float32), np.zeros(3), part.cloud_voxel)
    return SegmentMap(part.descriptor, part.fingerprint, columns, cloud, np.empty((0, 4, 4)))


class GrowingMap:
    """The thin map of the first parts, asked which of them a submap may be in.

    Parameters
    ----------
    whole : SegmentMap
        Of all parts, as :func:`laid_out` makes it.
    parts : int
        How many there are in all.
    known : int
        How many of them are searched.
    config : Config
    settings : AlignConfig
    """

    def __init__(
        self, whole: SegmentMap, parts: int, known: int, config: Config, settings: AlignConfig
    ) -> None:
        rows = int(np.searchsorted(whole.session, known))
        chosen = np.arange(len(whole)) < rows
        self._map = whole.kept(chosen, np.zeros(0, dtype=bool))
        self._side, self._known = _side(parts), known
        self._spacing_m = SPACING * settings.part_m
        self._limit = settings.searched_parts
        exact = config.matching.model_copy(update={"indexed_from": 10**12})
        pruner = create(config.method, config.threads, config.weights).pruner
        self._matcher = Matcher(self._map, exact, pruner=pruner, threads=config.threads)
        pose = config.pose.model_copy(update={"max_candidates": CANDIDATES})
        self._estimator = PoseEstimator(pose, threads=config.threads, seed=config.seed)

    def parts_of(self, submap: Submap) -> list[int]:
        """The parts to search for a submap: those of the best poses, best first."""
        if self._known <= self._limit:
            return list(range(self._known))
        matches = self._matcher.match(submap.descriptors)
        matches = self._matcher.prune(submap.descriptors, matches)
        centroids = submap.scene.segments.centroids
        found = self._estimator.estimate(centroids, self._map.centroids, matches)
        if not found:
            return []
        positions = np.stack([candidate.T_map_local[:2, 3] for candidate in found])
        return list(dict.fromkeys(self._slots(positions)))[: self._limit]

    def _slots(self, positions: Float64) -> list[int]:
        cells = np.rint(positions / self._spacing_m).astype(np.int64)
        numbers = cells[:, 1] * self._side + cells[:, 0]
        return [int(k) for k in numbers if 0 <= k < self._known]


def known_parts(chain: Chain, min_travel_m: float) -> Int64:
    """How many parts each submap is looked for in, (N,): the first so many.

    They are those of the sessions before its own, and of its own those that are far behind it.
    """
    owner = np.array([chain.session[nodes[0]] for nodes in chain.parts])
    ends = np.array([chain.travelled[nodes[-1]] for nodes in chain.parts])
    known = np.searchsorted(owner, chain.session).astype(np.int64)
    for session in np.unique(chain.session):
        own = chain.session == session
        behind = ends[owner == session] + min_travel_m
        known[own] += np.searchsorted(behind, chain.travelled[own])  # those that lie below it
    return known
