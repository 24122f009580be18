"""Cut a map into tiles in a folder or bucket."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from concurrent.futures import Executor
from contextlib import suppress
from functools import partial
from itertools import islice
from pathlib import Path

import numpy as np

from ..errors import ConfigError, MapFormatError, SeglocError
from ..geometry import cells_of, distinct
from ..map.compact import CompactConfig, compacted
from ..map.segment_map import SegmentMap, along, concatenate_maps, part_where, with_parts
from ..system.processes import all_of
from ..types import Bools, Float64
from .index import (
    FORMAT_VERSION,
    INDEX,
    MAX_INDEX_BYTES,
    Tile,
    TileFile,
    TileIndex,
    digest_of,
)
from .store import Store, store_of

SIZE_M, MARGIN_M = 500.0, 60.0
"""Edge of a square, and margin around it, beyond the range of a local cloud [m]."""
COARSE_A_KM2, COARSE_AT_LEAST = 24_000, 500
"""Segments in the thin map of all tiles: per square kilometre, and at least per tile."""
COARSE = CompactConfig(bits=4, max_views=1, cloud_bits=0)
"""Settings of the thin map of all tiles."""

AT_ONCE = 64
"""Tiles in memory at a time."""

_OURS = re.compile(r"(?:coarse|tile_-?\d+_-?\d+)-[0-9a-f]{32}\.segmap")
"""Names of files that :func:`write_tile` gives; other maps in the folder are kept."""

Cell = tuple[int, int]


def cut_tiles(
    prior_map: SegmentMap,
    out: str | Path,
    *,
    size_m: float = SIZE_M,
    margin_m: float = MARGIN_M,
    progress: Callable[[int, int], None] | None = None,
    executor: Executor | None = None,
) -> TileIndex:
    """Write a map as tiles, and their index last.

    Existing tiles with the same content are kept, and readers see either the old tiles or the new
    ones: file names contain a digest. Files that the index no longer lists are removed at the end.

    Parameters
    ----------
    prior_map : SegmentMap
    out : path or URL
    size_m, margin_m : float
        Edge of a square, and margin of the tiles around it [m].
    progress : callable, optional
        Called with (tiles done, total).
    executor : Executor, optional
        Writes the tiles to ``out``, which all its workers must share; by default this process
        does. The result is the same.

    Raises
    ------
    ConfigError
        If a length is out of range.
    SeglocError
        If writing fails; the old tiles are then unchanged.
    """
    if not (50 <= size_m <= 1e6 and 0 <= margin_m <= 1e3):
        raise ConfigError(
            f"tiles must be 50 m to 1000 km wide with a margin of at most 1 km, not {size_m:g} m "
            f"and {margin_m:g} m"
        )
    path = prior_map.trajectory[:, :3, 3]
    cells = squares_of(path if len(path) else prior_map.centroids, size_m)
    if not cells:
        raise SeglocError("a map without trajectory and segments has no tiles")
    store, parts = store_of(out), _parts(prior_map, cells, size_m, margin_m)
    with store.alone():
        found: list[tuple[Tile, SegmentMap]] = []
        while some := list(islice(parts, AT_ONCE)):
            found += all_of(partial(_cut, out, size_m), some, executor)
            if progress:
                progress(len(found), len(cells))
        found.sort(key=lambda made: made[0].cell)
        tiles, thin = [tile for tile, _ in found], [part for _, part in found]
        joined = along(concatenate_maps(thin), prior_map.trajectory)
        coarse = write_tile(store, compacted(joined, COARSE), "coarse")
        index = TileIndex(
            version=FORMAT_VERSION,
            size_m=size_m,
            margin_m=margin_m,
            descriptor=prior_map.descriptor,
            fingerprint=prior_map.fingerprint,
            coarse=coarse,
            tiles=tuple(tiles),
        )
        publish(store, index)
    return index


def _cut(out: str | Path, size_m: float, task: tuple[Cell, SegmentMap]) -> tuple[Tile, SegmentMap]:
    """Write the tile of a square in any process; return it with its thin map."""
    cell, part = task
    tile = write_square(store_of(out), part, cell, size_m)
    return tile, thin_of(part_of(part, cell, size_m, 0.0), size_m)


def _parts(
    prior_map: SegmentMap, cells: list[Cell], size_m: float, margin_m: float
) -> Iterator[tuple[Cell, SegmentMap]]:
    """Yield the content of each square with its margin, by recursive bisection."""
    if len(cells) == 1:
        yield cells[0], part_of(prior_map, cells[0], size_m, margin_m)
        return
    spans = np.ptp(np.array(cells), axis=0)
    ordered = sorted(cells, key=lambda cell: cell[int(spans.argmax())])
    half, around_m = len(ordered) // 2, margin_m + 1.0  # exact bounds apply at the leaves
    for some in (ordered[:half], ordered[half:]):
        low, high = np.min(some, axis=0) * size_m, (np.max(some, axis=0) + 1) * size_m
        near = _within(prior_map, low - around_m, high + around_m)
        yield from _parts(near, some, size_m, margin_m)


def publish(store: Store, index: TileIndex) -> None:
    """Write an index whose files exist, and remove files no longer needed.

    Files of the previous index are kept, since readers may still use it.
    """
    named = set(_file_names(index))
    with suppress(OSError, MapFormatError):
        named.update(_file_names(TileIndex.parse(store.read(INDEX, MAX_INDEX_BYTES), store.where)))
    store.write(INDEX, index.model_dump_json(indent=1).encode())
    for name in store.names():
        if _OURS.fullmatch(name) and name not in named:
            store.remove(name)


def _file_names(index: TileIndex) -> list[str]:
    return [index.coarse.file, *(tile.file for tile in index.tiles)]


def part_of(prior_map: SegmentMap, cell: Cell, size_m: float, margin_m: float) -> SegmentMap:
    """Return the part of a map in a square and a margin around it."""
    return _within(prior_map, *_box(cell, size_m, margin_m))


def _within(prior_map: SegmentMap, low: Float64, high: Float64) -> SegmentMap:
    """Return the part of a map in a box, seen from above."""
    return part_where(prior_map, partial(_inside, low=low, high=high))


def squares_of(positions: Float64, size_m: float) -> list[Cell]:
    """Return the squares that contain some of (N, 2 or 3) positions, sorted."""
    return [(int(i), int(j)) for i, j in distinct(cells_of(positions[:, :2], size_m))]


def write_square(store: Store, part: SegmentMap, cell: Cell, size_m: float) -> Tile:
    """Write the tile of a square."""
    file = write_tile(store, part, f"tile_{cell[0]}_{cell[1]}")
    own = in_square(part.trajectory[:, :3, 3], cell, size_m)
    return Tile(**file.model_dump(), cell=cell, poses=int(own.sum()))


def write_tile(store: Store, part: SegmentMap, name: str) -> TileFile:
    """Write a map to a file named by its content, unless it is there, and whole."""
    data = part.to_bytes()
    digest = digest_of(data)
    file = f"{name}-{digest}.segmap"
    if file not in store.names() or store.read(file, len(data)) != data:
        store.write(file, data)
    return TileFile(file=file, bytes=len(data), digest=digest, segments=len(part))


def thin_of(part: SegmentMap, size_m: float) -> SegmentMap:
    """Return a tile's best view of each object, up to a number, without the cloud."""
    most = max(COARSE_AT_LEAST, round(COARSE_A_KM2 * (size_m / 1e3) ** 2))
    thin = compacted(with_parts(part, points=part.cloud[:0]), COARSE)
    if len(thin) <= most:
        return thin
    rank = thin.sizes if thin.quality is None else thin.quality
    chosen = np.zeros(len(thin), dtype=bool)
    chosen[np.argsort(-rank, kind="stable")[:most]] = True
    return thin.kept(chosen, np.zeros(0, dtype=bool))


def owned_rows(positions: Float64, tile: Tile, others: list[Tile], index: TileIndex) -> Bools:
    """Return which of a tile's (N, 2 or 3) positions belong to it rather than to another tile.

    A tile owns its square; positions only in margins belong to the first of the tiles.
    """
    own = in_square(positions, tile.cell, index.size_m)
    keep = np.ones(len(positions), dtype=bool)
    for other in others:
        keep &= own | ~in_square(positions, other.cell, index.size_m)
        if other.cell < tile.cell:
            keep &= own | ~in_square(positions, other.cell, index.size_m, index.margin_m)
    return keep


def in_square(positions: Float64, cell: Cell, size_m: float, margin_m: float = 0.0) -> Bools:
    """Return which of (N, 2 or 3) positions lie in a square and a margin around it."""
    return _inside(positions, *_box(cell, size_m, margin_m))


def _box(cell: Cell, size_m: float, margin_m: float) -> tuple[Float64, Float64]:
    low = np.array(cell) * size_m
    return low - margin_m, low + size_m + margin_m


def _inside(positions: Float64, low: Float64, high: Float64) -> Bools:
    x, y = positions[:, 0], positions[:, 1]
    return np.asarray((x >= low[0]) & (x < high[0]) & (y >= low[1]) & (y < high[1]), dtype=bool)
