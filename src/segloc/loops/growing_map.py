"""Which parts may show what a submap shows: votes in thin maps of the parts before it.

A thin map is made of each block of 1, 2, 4, 8... parts that follow one another. Each part lies in
it at a place of its own, far from all others, so that a vote for poses says which parts they are
in. The first so many parts are one block for each binary digit of their number: a submap votes in
so few maps, however many parts there are, and each map is made once. So the time grows with the
length and its logarithm.
"""

from __future__ import annotations

import math

import numpy as np

from ..config import Config
from ..descriptors import create
from ..map.compact import CompactConfig, best_views
from ..map.segment_map import SegmentMap, concatenated
from ..map.voxel_cloud import VoxelCloud
from ..proposals.coarse_vote import CoarseVoter
from ..proposals.matching import Matcher
from ..types import Int64
from .config import AlignConfig
from .loops import Chain
from .submaps import Submap

SPACING = 5.185
"""Between parts, as a multiple of their length: no multiple of the cells that votes fall into."""
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


def blocks_of(known: int) -> list[range]:
    """The blocks that the first so many parts are made of, the largest first."""
    blocks, first = list[range](), 0
    for digit in reversed(range(known.bit_length())):
        if known >> digit & 1:
            blocks.append(range(first, first + (1 << digit)))
            first += 1 << digit
    return blocks


class PartsVote:
    """A vote for the parts of a block that a submap may be in.

    Parameters
    ----------
    parts : list of SegmentMap
        Of the block, as :func:`thin` makes them.
    config : Config
    settings : AlignConfig
    """

    def __init__(self, parts: list[SegmentMap], config: Config, settings: AlignConfig) -> None:
        self._count, self._spacing_m = len(parts), SPACING * settings.part_m
        whole = laid_out(parts, settings.part_m)
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
        """For each part of the block that a pose is in, how many segments agree with the best."""
        found = self._vote.candidates(submap.scene, submap.descriptors)
        votes: dict[int, int] = {}
        for candidate in found:
            i, j = np.rint(candidate.T_map_local[:2, 3] / self._spacing_m).astype(int).tolist()
            part = j * _side(self._count) + i
            if 0 <= part < self._count:
                votes[part] = max(votes.get(part, 0), candidate.inliers)
        return votes


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
