"""Localization in tiles: a prior or a coarse vote says which, and they are searched as one map."""

from __future__ import annotations

import time
from collections import OrderedDict
from collections.abc import Iterator
from threading import Lock

import numpy as np

from ..config import Config
from ..local_cloud import Scans
from ..localization import Localization
from ..localizer import Localizer
from ..map.segment_map import SegmentMap
from ..prior import Near, Prior
from ..search import Query
from ..stage_times import Clock, StageTimes
from ..types import LocalCloud
from .index import Tile
from .tiled_map import TiledMap

FEW, MORE = 4, 10
"""Tiles that are searched at first, and where nothing is found in them. Set by hand."""
COARSE_CANDIDATES = 32
"""Poses that the thin map of all tiles proposes."""
MOST_WORKING = 4
"""Sets of tiles that are kept ready to be searched."""


class TiledLocalizer:
    """Finds the pose of the sensor in a map of tiles.

    With a prior, the tiles are those that a sensor near it may be in. Without one, the query is
    matched to a thin map of all tiles: those of the best poses are searched as one map, so a
    place that fits as well in another of them makes the query ambiguous.

    Parameters
    ----------
    tiles : TiledMap
    config : Config, optional
        By default the one that the map was built with.
    clock : callable
        What the times of the stages are measured by; returns seconds.

    Attributes
    ----------
    prior_map : SegmentMap
        The thin map of all tiles.
    notes, config, clock
        As those of a :class:`~segloc.Localizer`.

    Raises
    ------
    MapFormatError
        If the thin map of all tiles cannot be read.
    MapMismatch
        As a :class:`~segloc.Localizer` does.

    Notes
    -----
    Any number of threads may use one localizer at once.
    """

    def __init__(
        self,
        tiles: TiledMap,
        config: Config | None = None,
        *,
        clock: Clock = time.perf_counter,
    ) -> None:
        self.tiles, self.prior_map = tiles, tiles.coarse()
        self._coarse = Localizer(self.prior_map, config, clock=clock)
        self.config, self.notes, self.clock = self._coarse.config, self._coarse.notes, clock
        pose = self.config.pose.model_copy(update={"max_candidates": COARSE_CANDIDATES})
        self._estimator = type(self._coarse.estimator)(
            pose, threads=self.config.threads, seed=self.config.seed
        )
        self._working: OrderedDict[tuple[str, ...], Localizer] = OrderedDict()
        self._lock = Lock()

    def localize(
        self,
        scans: Scans | LocalCloud,
        *,
        near: Near | None = None,
        deadline_ms: float | None = None,
    ) -> Localization:
        """The pose of the (last) scan, or the reason why there is none.

        Parameters and errors are those of :meth:`segloc.Localizer.localize`.

        Raises
        ------
        MapFormatError
            If a tile that is needed is missing, damaged, or takes too long to come; names its
            file. Nothing is answered from the others alone: they could not tell whether the place
            is ambiguous.
        """
        times, prior = StageTimes(self.clock), Prior.of(near)
        return self.locate(self.describe(scans, times), times, deadline_ms, prior)

    def describe(self, scans: Scans | LocalCloud, times: StageTimes | None = None) -> Query:
        """Scans -> local cloud -> segments -> descriptors."""
        return self._coarse.describe(scans, times)

    def locate(
        self,
        query: Query,
        times: StageTimes | None = None,
        deadline_ms: float | None = None,
        near: Prior | None = None,
    ) -> Localization:
        """The second half of :meth:`localize`."""
        times = times or StageTimes(self.clock)
        result: Localization | None = None
        for tiles in self._named(query, near, times):
            localizer = self._searching(tiles, times)
            only = None if near is None else Prior(near.position, near.radius_m)
            result = localizer.locate(query, times, deadline_ms, only)
            if result.localized or times.beyond(deadline_ms):
                return result
        if near is not None and near.anywhere:
            return self.locate(query, times, deadline_ms)
        return result or self._coarse.locate(query, times, deadline_ms, near)

    def _named(
        self, query: Query, near: Prior | None, times: StageTimes
    ) -> Iterator[tuple[Tile, ...]]:
        """Sets of tiles to search, one after another until the query is localized."""
        index = self.tiles.index
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
        candidates = self._estimator.estimate(centroids, self.prior_map.centroids, matches)
        if not candidates:
            return ()
        return self.tiles.index.at(np.stack([c.T_map_local[:3, 3] for c in candidates]))

    def _searching(self, tiles: tuple[Tile, ...], times: StageTimes) -> Localizer:
        """A localizer in some tiles."""
        chosen = sorted(tiles, key=lambda tile: tile.cell)
        key = tuple(tile.file for tile in chosen)
        with self._lock:
            if key in self._working:
                self._working.move_to_end(key)
                return self._working[key]
        with times("tiles"):
            part: SegmentMap = self.tiles.together(chosen)
            made = Localizer(part, self.config, clock=self.clock)
        with self._lock:
            self._working[key] = made
            while len(self._working) > MOST_WORKING:
                self._working.popitem(last=False)
        return made
