"""Update the tiles within reach of a session or of another map."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from ..config import Config, map_config
from ..errors import DatasetError, MapMismatch
from ..geometry import cells_of
from ..joining.same_place import check_same_place
from ..joining.shift import TO_THE_FRAME, Session, Shift, check_shift
from ..joining.update import UpdateConfig, UpdateCounts, update_map
from ..map.compact import compacted
from ..map.config import BuildConfig
from ..map.segment_map import SegmentMap, along, concatenate_maps, with_sessions
from ..types import Float64, Recording
from .cut import (
    COARSE,
    Cell,
    in_square,
    part_of,
    publish,
    squares_of,
    thin_of,
    write_square,
    write_tile,
)
from .index import TileIndex
from .localizer import localizer_in
from .store import Store, store_of
from .tiled_map import TiledMap

Change = Callable[[SegmentMap], SegmentMap]


@dataclass(frozen=True)
class Changed:
    """Result of a change of tiles.

    Attributes
    ----------
    index : TileIndex
        New index.
    read, written : int
        Numbers of tiles.
    shift : Shift or None
        Of the session or map against the tiles; None if not measured.
    """

    index: TileIndex
    read: int
    written: int
    shift: Shift | None = None


def update_tiles(
    where: str | Path,
    recording: Recording,
    config: Config | None = None,
    update: UpdateConfig | None = None,
    progress: Callable[[int, int], None] | None = None,
    *,
    elsewhere: bool = False,
    unchecked: bool = False,
    shift: Shift | None = None,
) -> tuple[Changed, UpdateCounts]:
    """Add a session to the tiles within its reach, and remove objects that are gone.

    Works as :func:`segloc.joining.update.update_map` does with an untiled map. Writers exclude each
    other; readers see either the old tiles or the new ones.

    Parameters
    ----------
    where : path or URL
        Folder of the tiles.
    recording : Recording
        Session with poses T_map_sensor.
    config : Config, optional
        Configuration of the session; by default the map's.
    update, progress, elsewhere, unchecked, shift
        As for ``update_map``.

    Raises
    ------
    DatasetError, MapMismatch, SeglocError
        As ``update_map`` does; nothing is changed then.
    MapFormatError
        If a required tile is unavailable; names its file.
    """
    poses = recording.poses
    if poses is None or not len(poses):
        raise DatasetError(f"{recording.name}: an update needs a pose for every scan")
    if shift is None and not unchecked:
        shift = check_shift_in(TiledMap(where), recording, config, name=recording.name)
    settings = update or UpdateConfig()
    counts: list[UpdateCounts] = []

    def change(part: SegmentMap) -> SegmentMap:
        updated, counted = update_map(
            part,
            recording,
            config,
            settings,
            progress,
            elsewhere=elsewhere,
            unchecked=unchecked,
            shift=shift,
        )
        counts.append(counted)
        return updated

    own = config or map_config(TiledMap(where).coarse())
    reach_m = max(own.local_cloud.radius_m, settings.visibility.range_m)
    return _change(store_of(where), poses[:, :2, 3], reach_m, change, shift=shift), counts[0]


def check_shift_in(
    prior_map: SegmentMap | TiledMap,
    session: Session,
    config: BuildConfig | None = None,
    *,
    name: str = "the session",
    remedy: str = TO_THE_FRAME,
    progress: Callable[[int, int], None] | None = None,
) -> Shift:
    """Do :func:`segloc.joining.shift.check_shift` in a map of either kind."""
    tiled = isinstance(prior_map, TiledMap)
    thin = prior_map.coarse() if isinstance(prior_map, TiledMap) else prior_map
    localizer = partial(localizer_in, prior_map) if tiled else None
    return check_shift(
        thin, session, config, name=name, remedy=remedy, progress=progress, localizer=localizer
    )


def merge_into_tiles(
    where: str | Path,
    other: SegmentMap,
    *,
    elsewhere: bool = False,
    unchecked: bool = False,
    shift: Shift | None = None,
) -> Changed:
    """Merge a map into the tiles within its reach.

    Parameters
    ----------
    where : path or URL
        Folder of the tiles.
    other : SegmentMap
        In the frame of the tiles.
    elsewhere : bool
        True to allow another place in the frame of the tiles.
    unchecked, shift
        As for :func:`update_tiles`.

    Raises
    ------
    MapMismatch
        If the descriptors differ, the map is off the tiles, or they are not of one place in one
        frame.
    MapFormatError
        If a required tile is unavailable; names its file.
    """
    tiles = TiledMap(where)
    voxel_m = tiles.coarse().cloud_voxel
    if len(other.cloud) and other.cloud_voxel > voxel_m:
        raise MapMismatch(
            f"the map's cloud has voxels of {other.cloud_voxel:g} m, those of the tiles "
            f"{voxel_m:g} m: build it with mapping.cloud_voxel: {voxel_m:g}"
        )
    if shift is None and not unchecked:
        shift = check_shift_in(tiles, other, name="the map")

    def change(part: SegmentMap) -> SegmentMap:
        check_same_place(part, other, elsewhere=elsewhere, unchecked=unchecked)
        return compacted(part.merge(other), map_config(part).mapping.compact)

    path = (other.trajectory[:, :3, 3] if len(other.trajectory) else other.centroids)[:, :2]
    points = other.cloud[:, :2] + other.origin[:2]
    places = np.concatenate([path, other.centroids[:, :2], points])
    return _change(store_of(where), places, 0.0, change, path, shift)


def _change(
    store: Store,
    places: Float64,
    reach_m: float,
    change: Change,
    path: Float64 | None = None,
    shift: Shift | None = None,
) -> Changed:
    """Replace the tiles within reach of places; add new ones along a trajectory."""
    with store.alone():
        tiles = TiledMap(store.where)
        index, size_m = tiles.index, tiles.index.size_m
        have = {tile.cell: tile for tile in index.tiles}
        new = set(squares_of(places if path is None else path, size_m))
        near = _cells_near(places, reach_m + index.margin_m, size_m)
        cells = sorted(new | (near & have.keys()))
        support = [have[cell] for cell in sorted(_around(cells, index) & have.keys())]
        if not support:
            raise MapMismatch(f"{store.where}: no tile is near: merge the untiled maps, then cut")
        before = tiles.together(support)
        after = _number_sessions(change(before), before, tiles.coarse())
        parts = {cell: part_of(after, cell, size_m, index.margin_m) for cell in cells}
        made = [write_square(store, parts[cell], cell, size_m) for cell in cells]
        kept = [tile for cell, tile in have.items() if cell not in parts]
        coarse = write_tile(store, _coarse(tiles, after, cells), "coarse")
        everything = sorted([*kept, *made], key=lambda tile: tile.cell)
        found = index.model_copy(update={"coarse": coarse, "tiles": tuple(everything)})
        publish(store, found)
    same = {tile.file for tile in index.tiles}
    return Changed(found, len(support), sum(tile.file not in same for tile in made), shift)


def _cells_near(places: Float64, reach_m: float, size_m: float) -> set[Cell]:
    """Return the squares within reach of places, by the bounding boxes of occupied squares."""
    cells, square = np.unique(cells_of(places[:, :2], size_m), axis=0, return_inverse=True)
    low, high = np.full((len(cells), 2), np.inf), np.full((len(cells), 2), -np.inf)
    np.minimum.at(low, square.reshape(-1), places[:, :2])
    np.maximum.at(high, square.reshape(-1), places[:, :2])
    first = np.floor((low - reach_m) / size_m).astype(np.int64)
    last = np.floor((high + reach_m) / size_m).astype(np.int64)
    return {
        (i, j)
        for (i0, j0), (i1, j1) in zip(first.tolist(), last.tolist(), strict=True)
        for i in range(i0, i1 + 1)
        for j in range(j0, j1 + 1)
    }


def _around(cells: list[Cell], index: TileIndex) -> set[Cell]:
    """Return the squares that share content with some tiles."""
    most = math.ceil(index.margin_m / index.size_m)
    steps = range(-most, most + 1)
    return {(i + di, j + dj) for i, j in cells for di in steps for dj in steps}


def _number_sessions(after: SegmentMap, before: SegmentMap, coarse: SegmentMap) -> SegmentMap:
    """Return the map with new sessions renumbered to be unique over all tiles."""
    new = np.setdiff1d(after.session, before.session)
    if not len(new):
        return after
    taken = np.concatenate([before.session, coarse.session])
    first = int(taken.max(initial=-1)) + 1
    session = after.session.copy()
    for number, old in enumerate(new, first):
        session[after.session == old] = number
    return with_sessions(after, session)


def _coarse(tiles: TiledMap, after: SegmentMap, cells: list[Cell]) -> SegmentMap:
    """Return the thin map of all tiles, with the content of some squares replaced."""
    old, size_m = tiles.coarse(), tiles.index.size_m
    rows, path = np.ones(len(old), dtype=bool), old.trajectory
    stays = np.ones(len(path), dtype=bool)
    for cell in cells:
        rows &= ~in_square(old.centroids, cell, size_m)
        stays &= ~in_square(path[:, :3, 3], cell, size_m)
    owned = [part_of(after, cell, size_m, 0.0) for cell in cells]
    rest = along(old.kept(rows, np.zeros(len(old.cloud), dtype=bool)), path[stays])
    thin = [along(thin_of(part, size_m), part.trajectory) for part in owned]
    return compacted(concatenate_maps([rest, *thin]), COARSE)
