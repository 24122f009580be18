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
from ..thin_vote import ThinVote
from .index import Tile, TileIndex
from .recent import Recent

STRONG = 0.5
"""Tiles are searched first in which a pose has such a share of the votes of the best."""
FEW, MORE = 4, 10
"""Tiles that are searched where nothing is found in these, and then. Set by hand."""


class Tiles(Protocol):
    """What is searched: a :class:`segloc.tiles.TiledMap`."""

    index: TileIndex
    recent: Recent

    def together(self, tiles: Sequence[Tile]) -> SegmentMap: ...


class TileSearch:
    """Searches the tiles that a query may be in.

    The query is matched to a thin map of all tiles, or of what lies near the prior: the tiles of
    the poses that have nearly as many votes as the best are searched as one map, so a place that
    fits as well in another of them makes the query ambiguous. Where it is not found there, more
    tiles are searched.

    Parameters
    ----------
    tiles : Tiles
    coarse : Localizer
        In the thin map of all tiles.
    """

    def __init__(self, tiles: Tiles, coarse: Localizer) -> None:
        self._tiles, self._coarse = tiles, coarse
        self._vote = ThinVote(coarse.prior_map, coarse.matcher, coarse.config)
        self._settings = coarse.config.to_yaml()

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
        tiles = index.tiles if near is None else index.near(near)
        if len(tiles) <= 1:
            yield from (tiles,) * len(tiles)
            return
        with times("tiles"):
            voted = self._voted(query, near)
        best = max(voted.values(), default=0)
        strong = [tile for tile, votes in voted.items() if votes >= STRONG * best]
        everywhere = len(tiles) <= (FEW if near is None else MORE)
        more = [list(tiles)] if everywhere else [list(voted)[:FEW], list(voted)[:MORE]]
        searched: list[set[str]] = []
        for chosen in (strong[:FEW], *more):
            files = {tile.file for tile in chosen}
            if files and files not in searched:
                searched.append(files)
                yield tuple(chosen)

    def _voted(self, query: Query, near: Prior | None) -> dict[Tile, int]:
        """The tiles of the poses on which most matches with the thin map agree, best first."""
        found = self._vote.candidates(query.scene, query.descriptors, near)
        if not found:
            return {}
        index = self._tiles.index
        sees_m = index.margin_m - self._coarse.config.local_cloud.radius_m  # beside a square, too
        voted: dict[Tile, int] = {}
        owners = index.owners(np.stack([c.T_map_local[:3, 3] for c in found]))
        for own, candidate in zip(owners, found, strict=True):
            x, y = candidate.T_map_local[:2, 3].tolist()
            tile = next((t for t in voted if index.distance(t, x, y) <= sees_m), own)
            if tile is not None:
                voted[tile] = max(voted.get(tile, 0), candidate.inliers)
        return voted

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
    """About what a localizer takes: its map, and three times as much for looking up."""
    return 4 * localizer.prior_map.memory_bytes
