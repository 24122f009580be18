"""Localization in tiles: a prior or a coarse vote says which, and they are searched as one map."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Protocol

import numpy as np

from ..localization import Localization
from ..localizer import Localizer
from ..map.segment_map import SegmentMap
from ..prior import Prior
from ..search import Query
from ..stage_times import StageTimes
from .index import Tile, TileIndex
from .recent import Recent

FEW, MORE = 4, 10
"""Tiles that are searched at first, and where nothing is found in them. Set by hand."""
COARSE_CANDIDATES = 32
"""Poses that the thin map of all tiles proposes."""


class Tiles(Protocol):
    """What is searched: a :class:`segloc.tiles.TiledMap`."""

    index: TileIndex
    recent: Recent

    def together(self, tiles: Sequence[Tile]) -> SegmentMap: ...


class TileSearch:
    """Searches the tiles that a query may be in.

    With a prior, the tiles are those that a sensor near it may be in. Without one, the query is
    matched to a thin map of all tiles: those of the best poses are searched as one map, so a
    place that fits as well in another of them makes the query ambiguous.

    Parameters
    ----------
    tiles : Tiles
    coarse : Localizer
        In the thin map of all tiles.
    """

    def __init__(self, tiles: Tiles, coarse: Localizer) -> None:
        self._tiles, self._coarse = tiles, coarse
        config = coarse.config
        pose = config.pose.model_copy(update={"max_candidates": COARSE_CANDIDATES})
        kind = type(coarse.estimator)
        self._estimator = kind(pose, threads=config.threads, seed=config.seed)
        self._settings = config.to_yaml()

    def locate(
        self, query: Query, times: StageTimes, deadline_ms: float | None, near: Prior | None
    ) -> Localization:
        """The pose of a query, or the reason why there is none.

        Raises
        ------
        MapFormatError
            If a tile that is needed cannot be had; names its file.
        """
        result: Localization | None = None
        for tiles in self._named(query, near, times):
            localizer = self._searching(tiles, times)
            only = None if near is None else Prior(near.position, near.radius_m)
            result = localizer.locate(query, times, deadline_ms, only)
            if result.localized or times.beyond(deadline_ms):
                return result
        if near is not None and near.anywhere:
            return self.locate(query, times, deadline_ms, None)
        return result or self._nowhere(query, times, deadline_ms, near)

    def _nowhere(
        self, query: Query, times: StageTimes, deadline_ms: float | None, near: Prior | None
    ) -> Localization:
        """What a map of nothing answers: no tile has a better right to be asked."""
        coarse = self._coarse

        def made() -> Localizer:
            return Localizer(coarse.prior_map, coarse.config, clock=coarse.clock)

        key = (self._settings, self._tiles.index.coarse.file)
        thin = self._tiles.recent.get(key, Localizer, made, _bytes)
        return thin.locate(query, times, deadline_ms, near)

    def _named(
        self, query: Query, near: Prior | None, times: StageTimes
    ) -> Iterator[tuple[Tile, ...]]:
        """Sets of tiles to search, one after another until the query is localized."""
        index = self._tiles.index
        if near is not None:
            if found := index.near(near):
                yield found
            return
        if len(index.tiles) <= FEW:
            yield index.tiles
            return
        with times("tiles"):
            voted = self._voted(query)
        if voted:
            yield voted[:FEW]
        if len(voted) > FEW:
            yield voted[:MORE]

    def _voted(self, query: Query) -> tuple[Tile, ...]:
        """The tiles of the poses on which most matches with the thin map agree, best first."""
        matches = self._coarse.matcher.match(query.descriptors)
        centroids = query.scene.segments.centroids
        map_centroids = self._coarse.prior_map.centroids
        candidates = self._estimator.estimate(centroids, map_centroids, matches)
        if not candidates:
            return ()
        return self._tiles.index.at(np.stack([c.T_map_local[:3, 3] for c in candidates]))

    def _searching(self, tiles: tuple[Tile, ...], times: StageTimes) -> Localizer:
        """A localizer in some tiles, kept among what the tiles were last used for."""
        chosen = sorted(tiles, key=lambda tile: tile.cell)
        key = (self._settings, *(tile.file for tile in chosen))

        def made() -> Localizer:
            with times("tiles"):
                part = self._tiles.together(chosen)
                return Localizer(part, self._coarse.config, clock=self._coarse.clock)

        return self._tiles.recent.get(key, Localizer, made, _bytes)


def _bytes(localizer: Localizer) -> int:
    """About what a localizer takes: its map, and as much again for what is looked up in it."""
    return 2 * localizer.prior_map.memory_bytes
