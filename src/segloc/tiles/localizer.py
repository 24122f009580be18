"""Localization in tiles, which a prior or a coarse vote selects; they are searched as one map."""

from __future__ import annotations

import time
from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from ..config import Config
from ..errors import ConfigError
from ..likelihood import Posterior
from ..localization import Reason
from ..localizer import Localizer, likelihood_of, proposers_of
from ..map.segment_map import SegmentMap
from ..pipeline import Search
from ..prior import Prior
from ..proposals.coarse_vote import CoarseVoter
from ..proposals.proposer import Query
from ..system.stage_times import Clock, StageTimes
from ..types import Candidate, Float64, LocalCloud, Matches, Pose
from .index import Tile
from .pieces import MAX_ALL, Pieces, TiledCloud, TiledOccupancy
from .store import holds_tiles
from .tiled_map import TiledMap

MAX_VOTED = 4
"""Most tiles selected by votes: of 480 queries in 32 tiles, three lose ten that are found by four,
and eight find one more."""
_SEGMENT_BYTES = 100
"""Memory of an index by segment."""


class TiledLocalizer(Localizer):
    """Finds the pose of the sensor in a tiled map; used like a :class:`segloc.Localizer`.

    Up to ten tiles, of all or of those near the prior, are searched as one map: the query is
    matched to their segments, and the clouds of tiles are read where poses are proposed, so that
    similar places in different tiles make the query ambiguous. Of more tiles, up to four are
    searched so, in which most segments agree on a pose by a thin map.

    Parameters
    ----------
    tiles : TiledMap
    config : Config, optional
        By default the configuration of the map.
    clock : callable
        Clock of the times of stages; returns seconds.

    Attributes
    ----------
    tiles : TiledMap
    prior_map : SegmentMap
        The thin map of all tiles.

    Raises
    ------
    ConfigError
        If it is not given a TiledMap.
    MapMismatch, MapFormatError
        As a Localizer; or if the thin map cannot be read.
    """

    def __init__(
        self,
        tiles: TiledMap,
        config: Config | None = None,
        *,
        clock: Clock = time.perf_counter,
    ) -> None:
        if not isinstance(tiles, TiledMap):
            raise ConfigError(
                f"a TiledLocalizer needs a TiledMap, not {type(tiles).__name__}: "
                "open one by segloc.tiles.TiledMap(place)"
            )
        super().__init__(tiles.coarse(), config, proposers=(), clock=clock)
        self.tiles, config = tiles, self.config
        self._vote = CoarseVoter(
            self.prior_map,
            self.matcher,
            config.pose,
            config.local_cloud.radius_m,
            threads=config.threads,
            seed=config.seed,
        )
        self._pieces = Pieces(tiles, config)
        self._settings = config.to_yaml()
        self._again = partial(TiledLocalizer, tiles, config, clock=clock)  # opens them again

    def search(
        self,
        query: Query,
        times: StageTimes | None = None,
        deadline_ms: float | None = None,
        near: Prior | None = None,
        *,
        known: Sequence[Pose] = (),
        thorough: bool = False,
    ) -> Search:
        """Search the tiles that a query may be in, as :meth:`segloc.Localizer.search`.

        Raises
        ------
        ConfigError
            If ``thorough``: only maps in one piece are searched so.
        MapFormatError
            If a required tile is unavailable; names its file.
        """
        if thorough:
            raise ConfigError("a thorough search of tiles is not supported; pass a .segmap file")
        times = times or StageTimes(self.clock)
        index = self.tiles.index
        tiles = index.tiles if near is None else index.near(near)
        only = None if near is None else replace(near, anywhere=False)
        matches, found = Matches.none(), list[Candidate]()
        if len(tiles) > MAX_ALL:
            with times("tiles"):
                matches = self._vote.matches(query.descriptors, near)
                rough = near and near.widened(self.config.pose.separation)
                found = self._vote.poses(query.scene, matches, rough)
            tiles = self._voted(found)
        chosen = {*tiles, *self._owners(known)}
        result: Search | None = None
        if chosen:
            here = self._searching(chosen, times)
            result = here.search(query, times, deadline_ms, only, known=known)
            if result.reason is None or times.beyond(deadline_ms):
                return result
        if near is not None and near.anywhere:
            return self.search(query, times, deadline_ms, None, known=known)
        return result or self._nowhere(matches, found, near)

    def compare(self, cloud: LocalCloud, known: Sequence[Pose]) -> Posterior:
        """Compare a cloud with the tiles at known poses, as :meth:`segloc.Localizer.compare`.

        Raises
        ------
        MapFormatError
            If a tile cannot be read; names its file.
        """
        held = self._owners(known)
        if not held:
            return Posterior()
        return self._searching(held, StageTimes(self.clock)).compare(cloud, known)

    def around(self, position: Float64) -> Localizer | None:
        """Return the localizer of the tile at a (3,) position; None beside all tiles.

        Raises
        ------
        MapFormatError
            If the tile cannot be read; names its file.
        """
        (tile,) = self.tiles.index.owners(position[None])
        if tile is None:
            return None
        return self._searching((tile,), StageTimes(self.clock))

    def _owners(self, poses: Sequence[Pose]) -> tuple[Tile, ...]:
        """Return the tiles at poses, each once."""
        if not poses:
            return ()
        owners = self.tiles.index.owners(np.stack([T[:3, 3] for T in poses]))
        return tuple(dict.fromkeys(tile for tile in owners if tile is not None))

    def _voted(self, found: list[Candidate]) -> tuple[Tile, ...]:
        """Return the tiles with most votes in the thin map, less those that the best rules out."""
        if not found:
            return ()
        index = self.tiles.index
        sees_m = index.margin_m - self.config.local_cloud.radius_m  # beside a square
        voted: dict[Tile, int] = {}
        owners = index.owners(np.stack([c.T_map_local[:3, 3] for c in found]))
        for own, candidate in zip(owners, found, strict=True):
            x, y = candidate.T_map_local[:2, 3].tolist()
            tile = next((t for t in voted if index.distance(t, x, y) <= sees_m), own)
            if tile is not None:
                voted[tile] = max(voted.get(tile, 0), candidate.inliers)
        best, ruled_out = max(voted.values(), default=0), self.likelihood.segments_suffice
        left = [tile for tile, votes in voted.items() if not ruled_out(best, votes)]
        return tuple(left[:MAX_VOTED])

    def _searching(self, tiles: Iterable[Tile], times: StageTimes) -> Localizer:
        """Return a cached localizer in some tiles: their segments; the pieces have the rest."""
        chosen = sorted(tiles, key=lambda tile: tile.cell)
        key = (self._settings, *(tile.file for tile in chosen))

        def build() -> Localizer:
            with times("tiles"):
                part, config = self.tiles.together(chosen, cloud_later=True), self.config
                occupancy = TiledOccupancy(self._pieces, chosen)
                return Localizer(
                    part,
                    config,
                    estimator=self.estimator,
                    proposers=proposers_of(part, config, occupancy),
                    likelihood=likelihood_of(TiledCloud(self._pieces, chosen), part, config),
                    clock=self.clock,
                )

        return self.tiles.recent.get(key, build, _bytes)

    def _nowhere(self, matches: Matches, found: list[Candidate], near: Prior | None) -> Search:
        """Return the result if no tile has votes."""
        reason, most = Reason.NO_CONSISTENT_MATCHES, max((c.inliers for c in found), default=0)
        message = f"{reason} (of the segments {most} agree on a place, as by chance)"
        return Search(
            self.prior_map, len(matches), matches, found, Posterior(), reason, message, near=near
        )


def _bytes(localizer: Localizer) -> int:
    """Estimate a localizer's memory: its segments and their index."""
    return localizer.prior_map.memory_bytes + _SEGMENT_BYTES * len(localizer.prior_map)


def open_map(where: str) -> SegmentMap | TiledMap:
    """Open a map file, or the folder or URL of tiles.

    Raises
    ------
    MapFormatError
        If it holds no map, or a damaged one; names the file.
    """
    return TiledMap(where) if holds_tiles(where) else SegmentMap.load(where)


def localizer_in(prior_map: SegmentMap | TiledMap, config: Config | None = None) -> Localizer:
    """Return the localizer in a map of either kind."""
    if isinstance(prior_map, TiledMap):
        return TiledLocalizer(prior_map, config)
    return Localizer(prior_map, config)
