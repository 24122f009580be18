"""Localization in tiles, which a prior or a coarse vote selects; they are searched as one map."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from ..config import Config
from ..errors import ConfigError
from ..likelihood import Posterior
from ..localization import Reason
from ..localizer import Localizer, proposers_of
from ..map.segment_map import SegmentMap
from ..pipeline import Search
from ..prior import Prior, within
from ..proposals.coarse_vote import CoarseVoter
from ..proposals.proposer import Estimator, Query
from ..system.stage_times import Clock, StageTimes
from ..types import Candidate, Float64, LocalCloud, Matches, Pose
from .index import Tile
from .pieces import MAX_ALL, SEGMENT_BYTES, Pieces, TiledOccupancy, tiled_likelihood
from .store import holds_tiles
from .tiled_map import TiledMap

MAX_VOTED = 4
"""Maximum number of tiles selected by votes. Set by hand."""


class TiledLocalizer(Localizer):
    """Finds the pose of the sensor in a tiled map; used like a :class:`segloc.Localizer`.

    Up to ten tiles, of all or of those near the prior, are searched as one map: the query is
    matched to their segments, and the clouds of tiles are read where poses are proposed, so that
    similar places in different tiles make the query ambiguous. Of more tiles, a query is matched to
    a thin map. A tile with far more votes than chance is searched alone. Otherwise the query is
    matched to all segments of the tiles with the most votes; those in which segments agree on poses
    are searched as one map.

    Parameters
    ----------
    tiles : TiledMap
    config : Config, optional
        By default the configuration of the map.
    estimator : Estimator, optional
        Estimates poses from matches of segments; by default that of ``config.pose``.
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
        estimator: Estimator | None = None,
        clock: Clock = time.perf_counter,
    ) -> None:
        if not isinstance(tiles, TiledMap):
            raise ConfigError(
                f"a TiledLocalizer needs a TiledMap, not {type(tiles).__name__}: "
                "open one by segloc.tiles.TiledMap(place)"
            )
        super().__init__(tiles.coarse(), config, estimator=estimator, proposers=(), clock=clock)
        self.tiles, config = tiles, self.config
        self._vote = CoarseVoter(
            self.prior_map,
            self.matcher,
            config.pose,
            config.local_cloud.radius_m,
            threads=config.threads,
            seed=config.seed,
        )
        self._pieces = Pieces(tiles, config, self.descriptor.pruner)
        self._settings = config.to_yaml()
        self._reopen = partial(TiledLocalizer, tiles, config, estimator=estimator, clock=clock)

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle the location and the configuration; unpickling opens the tiles again."""
        return self._reopen, ()

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
        matches, found = _NONE, list[Candidate]()
        sets: Iterable[Iterable[Tile]] = [tiles] if tiles else ()
        if len(tiles) > MAX_ALL:
            with times("tiles"):
                matches = self._vote.matches(query.descriptors, near)
                found = self._vote.poses(query.scene, matches, near)
            sets = self._promising(query, found, near, times)
        held, searched = self._owners(known), list[set[Tile]]()
        result: Search | None = None
        for chosen in map(set, sets):
            if not chosen or chosen in searched:
                continue
            searched.append(chosen)
            here = self._searching(chosen.union(held), times)
            result = here.search(query, times, deadline_ms, only, known=known)
            if result.reason is None or times.beyond(deadline_ms):
                return result
        if near is not None and near.anywhere:
            return self.search(query, times, deadline_ms, None, known=known)
        if result is None and held:
            here = self._searching(held, times)
            return here.search(query, times, deadline_ms, only, known=known)
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

    def _promising(
        self, query: Query, found: list[Candidate], near: Prior | None, times: StageTimes
    ) -> Iterator[tuple[Tile, ...]]:
        """Yield tiles in which segments agree on poses: by votes, then by all segments."""
        voted = self._votes(found)
        best = max(voted.values(), default=0)
        strong = [
            tile
            for tile, votes in voted.items()
            if not self.likelihood.segments_suffice(best, votes)
        ][:MAX_VOTED]
        typical = int(np.median([c.inliers for c in found])) if found else 0
        if len(strong) == 1 and self.likelihood.segments_suffice(best, typical):
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
        if not self.likelihood.segments_suffice(best, 0):
            return ()
        return tuple(
            tile
            for tile, count in agree.items()
            if not self.likelihood.segments_suffice(best, count)
        )

    def _votes(self, found: list[Candidate]) -> dict[Tile, int]:
        """Return the tiles of the poses with most votes in the thin map, best first."""
        if not found:
            return {}
        index = self.tiles.index
        sees_m = index.margin_m - self.config.local_cloud.radius_m  # beside a square
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
        mapped, matcher = self.tiles.tile(tile).centroids, self._pieces.matcher(tile)
        matches = matcher.prune(query.descriptors, matcher.match(query.descriptors))
        centroids = query.scene.segments.centroids
        found = within(near, self.estimator.estimate(centroids, mapped, matches))
        return max((candidate.inliers for candidate in found), default=0)

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
                    likelihood=tiled_likelihood(self._pieces, chosen, ground=part.has_ground),
                    clock=self.clock,
                )

        return self.tiles.recent.get(key, build, _bytes)

    def _nowhere(self, matches: Matches, found: list[Candidate], near: Prior | None) -> Search:
        """Return the result if no tile has enough votes."""
        reason, most = Reason.NO_CONSISTENT_MATCHES, max((c.inliers for c in found), default=0)
        message = f"{reason} (of the segments {most} agree on a place, as by chance)"
        return Search(
            self.prior_map, len(matches), matches, found, Posterior(), reason, message, near=near
        )


_NONE = Matches(
    np.empty(0, np.int64), np.empty(0, np.int64), np.empty(0, np.float32), np.empty(0, np.float32)
)


def _bytes(localizer: Localizer) -> int:
    """Estimate a localizer's memory: its segments and their index."""
    return localizer.prior_map.memory_bytes + SEGMENT_BYTES * len(localizer.prior_map)


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
