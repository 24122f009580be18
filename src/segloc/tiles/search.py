"""Localization in tiles, which a prior or a coarse vote selects; they are searched as one map."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Hashable, Iterator, Sequence
from dataclasses import replace
from threading import Lock
from typing import Any, Protocol, TypeVar

import numpy as np

from ..likelihood import Posterior
from ..localization import Reason
from ..localizer import Localizer
from ..map.segment_map import SegmentMap
from ..pipeline import Search
from ..prior import Prior, within
from ..proposals.coarse_vote import CoarseVoter
from ..proposals.matching import Matcher
from ..proposals.proposer import Query
from ..system.stage_times import StageTimes
from ..types import Candidate, Float64, Matches
from .index import Tile, TileIndex

MAX_VOTED, MAX_ALL = 4, 10
"""Maximum number of tiles selected by votes, and of tiles that are all searched. Set by hand."""
Value = TypeVar("Value")


class Tiles(Protocol):
    """Tiles to search; a :class:`segloc.tiles.TiledMap`."""

    index: TileIndex
    recent: Recent

    def tile(self, tile: Tile) -> SegmentMap: ...
    def together(self, tiles: Sequence[Tile]) -> SegmentMap: ...


class TileSearch:
    """Search the tiles that may contain a query.

    The query is matched to a thin map of all tiles, or of those near the prior. A tile with far
    more votes than chance is searched alone. Otherwise the query is matched to all segments of the
    tiles with the most votes; those in which segments agree on poses are searched as one map, so
    that similar places in different tiles make the query ambiguous. Other clouds are compared only
    if there are few tiles.

    Parameters
    ----------
    tiles : Tiles
    coarse : Localizer
        Localizer in the thin map of all tiles.
    """

    def __init__(self, tiles: Tiles, coarse: Localizer) -> None:
        self._tiles, self._coarse = tiles, coarse
        config = coarse.config
        self._vote = CoarseVoter(
            coarse.prior_map,
            coarse.matcher,
            config.pose,
            config.local_cloud.radius_m,
            threads=config.threads,
            seed=config.seed,
        )
        self._settings = config.to_yaml()

    def search(
        self, query: Query, times: StageTimes, deadline_ms: float | None, near: Prior | None
    ) -> Search:
        """Search the tiles that a query may be in.

        Raises
        ------
        MapFormatError
            If a required tile is unavailable; names its file.
        """
        index = self._tiles.index
        tiles = index.tiles if near is None else index.near(near)
        matches, found = _NONE, list[Candidate]()
        if len(tiles) > 1:
            with times("tiles"):
                matches = self._vote.matches(query.descriptors, near)
                found = self._vote.poses(query.scene, matches, near)
        only = None if near is None else replace(near, anywhere=False)
        result: Search | None = None
        for chosen in self._named(query, tiles, found, near, times):
            result = self._searching(chosen, times).search(query, times, deadline_ms, only)
            if result.reason is None or times.beyond(deadline_ms):
                return result
        if near is not None and near.anywhere:
            return self.search(query, times, deadline_ms, None)
        return result or _nowhere(matches, found, near)

    def around(self, position: Float64) -> Localizer | None:
        """Return the localizer in the tile at a (3,) position; None beside all tiles.

        Raises
        ------
        MapFormatError
            If the tile cannot be had; names its file.
        """
        (tile,) = self._tiles.index.owners(position[None])
        if tile is None:
            return None
        return self._searching((tile,), StageTimes(self._coarse.clock))

    def _named(
        self,
        query: Query,
        tiles: tuple[Tile, ...],
        found: list[Candidate],
        near: Prior | None,
        times: StageTimes,
    ) -> Iterator[tuple[Tile, ...]]:
        """Yield sets of tiles to search until the query is localized."""
        searched: list[set[Tile]] = []
        for chosen in self._promising(query, found, near, times):
            if chosen and set(chosen) not in searched:
                searched.append(set(chosen))
                yield chosen
        if 0 < len(tiles) <= MAX_ALL and set(tiles) not in searched:
            yield tiles

    def _promising(
        self, query: Query, found: list[Candidate], near: Prior | None, times: StageTimes
    ) -> Iterator[tuple[Tile, ...]]:
        """Yield tiles in which segments agree on poses: by votes, then by all segments."""
        voted = self._voted(found)
        best = max(voted.values(), default=0)
        strong = [
            tile
            for tile, votes in voted.items()
            if not self._coarse.likelihood.segments_decide(best, votes)
        ][:MAX_VOTED]
        typical = int(np.median([c.inliers for c in found])) if found else 0
        if len(strong) == 1 and self._coarse.likelihood.segments_decide(best, typical):
            yield tuple(strong)
        agree: dict[Tile, int] = {}
        for some in (strong, list(voted)[:MAX_VOTED]):
            with times("tiles"):
                for tile in some:
                    if tile not in agree:
                        agree[tile] = self._agree(query, tile, near)
            yield self._agreeing({tile: agree[tile] for tile in some})

    def _agreeing(self, agree: dict[Tile, int]) -> tuple[Tile, ...]:
        """Return the tiles that segments do not rule out; none if they may agree by chance."""
        best = max(agree.values(), default=0)
        if not self._coarse.likelihood.segments_decide(best, 0):
            return ()
        return tuple(
            tile
            for tile, count in agree.items()
            if not self._coarse.likelihood.segments_decide(best, count)
        )

    def _voted(self, found: list[Candidate]) -> dict[Tile, int]:
        """Return the tiles of the poses with most votes in the thin map, best first."""
        if not found:
            return {}
        index = self._tiles.index
        sees_m = index.margin_m - self._coarse.config.local_cloud.radius_m  # beside a square
        voted: dict[Tile, int] = {}
        owners = index.owners(np.stack([c.T_map_local[:3, 3] for c in found]))
        for own, candidate in zip(owners, found, strict=True):
            x, y = candidate.T_map_local[:2, 3].tolist()
            tile = next((t for t in voted if index.distance(t, x, y) <= sees_m), own)
            if tile is not None:
                voted[tile] = max(voted.get(tile, 0), candidate.inliers)
        return voted

    def _agree(self, query: Query, tile: Tile, near: Prior | None) -> int:
        """Return the inliers of a query in a tile, by all of its segments."""
        part, coarse = self._tiles.tile(tile), self._coarse
        config, pruner = coarse.config, coarse.descriptor.pruner
        matcher = Matcher(part, config.matching, pruner=pruner, threads=config.threads)
        matches = matcher.prune(query.descriptors, matcher.match(query.descriptors))
        centroids = query.scene.segments.centroids
        found = within(near, coarse.estimator.estimate(centroids, part.centroids, matches))
        return max((candidate.inliers for candidate in found), default=0)

    def _searching(self, tiles: tuple[Tile, ...], times: StageTimes) -> Localizer:
        """Return a cached localizer in some tiles."""
        chosen = sorted(tiles, key=lambda tile: tile.cell)
        key = (self._settings, *(tile.file for tile in chosen))

        def made() -> Localizer:
            with times("tiles"):
                part = self._tiles.together(chosen)
                return Localizer(
                    part,
                    self._coarse.config,
                    estimator=self._coarse.estimator,
                    clock=self._coarse.clock,
                )

        return self._tiles.recent.get(key, made, _bytes)


_NONE = Matches(
    np.empty(0, np.int64), np.empty(0, np.int64), np.empty(0, np.float32), np.empty(0, np.float32)
)


_POINT_BYTES, _SEGMENT_BYTES = 45, 100
"""Memory of a localizer's indices by point and by segment of its map."""


def _bytes(localizer: Localizer) -> int:
    """Estimate a localizer's memory: its map and its indices."""
    prior_map = localizer.prior_map
    points = _POINT_BYTES * len(prior_map.voxel_cloud)
    return prior_map.memory_bytes + points + _SEGMENT_BYTES * len(prior_map)


def _nowhere(matches: Matches, found: list[Candidate], near: Prior | None) -> Search:
    """The result where no tile has a right to be searched."""
    reason, most = Reason.NO_CONSISTENT_MATCHES, max((c.inliers for c in found), default=0)
    message = f"{reason} (of the segments {most} agree on a place, as by chance)"
    return Search(len(matches), matches, found, Posterior(), reason, message, near=near)


class Recent:
    """Thread-safe cache that drops the least recently used.

    Parameters
    ----------
    most_bytes : int
        Maximum size, apart from the latest entry.
    """

    def __init__(self, most_bytes: int) -> None:
        self._most_bytes = most_bytes
        self._kept: OrderedDict[Hashable, tuple[Any, int]] = OrderedDict()
        self._lock = Lock()

    def __len__(self) -> int:
        return len(self._kept)

    @property
    def bytes(self) -> int:
        """Total size of the entries."""
        with self._lock:
            return sum(size for _, size in self._kept.values())

    def get(self, key: Hashable, make: Callable[[], Value], size: Callable[[Value], int]) -> Value:
        """Return the entry of a key, or create it."""
        with self._lock:
            if key in self._kept:
                self._kept.move_to_end(key)
                found: Value = self._kept[key][0]
                return found
        made = make()
        with self._lock:
            self._kept[key] = made, size(made)
            self._kept.move_to_end(key)
            excess = sum(size for _, size in self._kept.values()) - self._most_bytes
            while excess > 0 and len(self._kept) > 1:
                excess -= self._kept.popitem(last=False)[1][1]
        return made
