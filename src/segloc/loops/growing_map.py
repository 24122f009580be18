"""Select the parts that may match a submap, by votes in thin maps of the earlier parts.

A thin map is built for each block of 1, 2, 4, 8... consecutive parts. In it the parts lie far apart
from each other, so a vote for a pose identifies its part. The first n parts are covered by one
block per binary digit of n: a submap votes in that many maps, and each map is built once. The time
grows with the length times its logarithm.
"""

from __future__ import annotations

import math

import numpy as np

from ..config import Config
from ..descriptors import create
from ..map.compact import CompactConfig, best_views
from ..map.segment_map import SegmentMap, concatenate_maps
from ..map.voxel_cloud import VoxelCloud
from ..proposals.coarse_vote import CoarseVoter
from ..proposals.matching import Matcher
from ..types import Int64
from .config import AlignConfig
from .loops import Chain
from .submaps import Submap

SPACING = 5.185
"""Spacing of parts, in part lengths; no multiple of the vote's cell size."""
_VIEWS = CompactConfig(max_views=2)


def thin(prior_map: SegmentMap) -> SegmentMap:
    """Return the best views of each object of a part, without a cloud."""
    return prior_map.kept(best_views(prior_map, _VIEWS), np.zeros(len(prior_map.cloud), dtype=bool))


def lay_out(parts: list[SegmentMap], part_m: float) -> SegmentMap:
    """Return thin parts as one map, each at a place and in a session of its own."""
    side, spacing_m = _side(len(parts)), SPACING * part_m
    slots = [(k % side * spacing_m, k // side * spacing_m, 0.0) for k in range(len(parts))]
    moved = [_place(part, k, slot) for k, (part, slot) in enumerate(zip(parts, slots, strict=True))]
    return concatenate_maps(moved)


def _side(count: int) -> int:
    return max(1, math.isqrt(max(count - 1, 0)) + 1)


def _place(part: SegmentMap, k: int, place: tuple[float, float, float]) -> SegmentMap:
    columns = part.columns()
    if len(part):
        columns["centroids"] = part.centroids - part.centroids.mean(axis=0) + np.array(place)
    columns["session"] = np.full(len(part), k, np.int32)
    cloud = VoxelCloud(np.empty((0, 3), np.float32), np.zeros(3), part.cloud_voxel)
    return SegmentMap(part.descriptor, part.fingerprint, columns, cloud, np.empty((0, 4, 4)))


def blocks_of(known: int) -> list[range]:
    """Return the blocks that cover the first ``known`` parts, the largest first."""
    blocks, first = list[range](), 0
    for digit in reversed(range(known.bit_length())):
        if known >> digit & 1:
            blocks.append(range(first, first + (1 << digit)))
            first += 1 << digit
    return blocks


class PartsVote:
    """Vote for the parts of a block, as of :func:`thin`, that may match a submap."""

    def __init__(self, parts: list[SegmentMap], config: Config, settings: AlignConfig) -> None:
        self._count, self._spacing_m = len(parts), SPACING * settings.part_m
        whole = lay_out(parts, settings.part_m)
        pruner = create(config.method, config.threads, config.weights).pruner
        matcher = Matcher(whole, config.matching, pruner=pruner, threads=config.threads)
        self._vote = CoarseVoter(
            whole,
            matcher,
            config.pose,
            config.local_cloud.radius_m,
            threads=config.threads,
            seed=config.seed,
        )

    def of(self, submap: Submap) -> dict[int, int]:
        """Return the inliers of the best pose in each part of the block that has one."""
        found = self._vote.candidates(submap.scene, submap.descriptors)
        votes: dict[int, int] = {}
        for candidate in found:
            i, j = np.rint(candidate.T_map_local[:2, 3] / self._spacing_m).astype(int).tolist()
            part = j * _side(self._count) + i
            if 0 <= part < self._count:
                votes[part] = max(votes.get(part, 0), candidate.inliers)
        return votes


def searchable_parts(chain: Chain, min_travel_m: float) -> Int64:
    """Return the number of parts, from the first, in which each submap is searched, (N,).

    These are all parts of earlier sessions, and the distant earlier ones of its own.
    """
    owner = np.array([chain.session[nodes[0]] for nodes in chain.parts])
    ends = np.array([chain.travelled[nodes[-1]] for nodes in chain.parts])
    known = np.searchsorted(owner, chain.session).astype(np.int64)
    for session in np.unique(chain.session):
        own = chain.session == session
        behind = ends[owner == session] + min_travel_m
        known[own] += np.searchsorted(behind, chain.travelled[own])
    return known
