"""A map -> tiles in a folder or bucket, replaced one by one."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from numpy.typing import NDArray

from ..errors import ConfigError, MapFormatError, SeglocError
from ..map.compact import CompactConfig, compacted
from ..map.parts import along, concatenated
from ..map.segment_map import SegmentMap
from ..types import Float64
from .index import (
    FORMAT_VERSION,
    INDEX,
    MOST_INDEX_BYTES,
    Tile,
    TileFile,
    TileIndex,
    cells_of,
    digest_of,
)
from .store import Store, store_of

SIZE_M, MARGIN_M = 500.0, 60.0
"""Of a square, and around it: farther than a local cloud reaches."""
COARSE_PER_TILE = 3000
"""Segments of a tile in the thin map of all tiles."""
COARSE = CompactConfig(bits=4, max_views=1, cloud_bits=0)
"""What the thin map of all tiles keeps."""

Bools = NDArray[np.bool_]


def cut_tiles(
    prior_map: SegmentMap,
    out: str | Path,
    *,
    size_m: float = SIZE_M,
    margin_m: float = MARGIN_M,
    progress: Callable[[int, int], None] | None = None,
) -> TileIndex:
    """Write a map as tiles, and their index last.

    Where ``out`` has tiles already, those that are the same stay as they are, and readers see
    either the old tiles or the new ones: a file's name has the digest of its bytes in it. Files
    that the index names no more are removed at the end.

    Parameters
    ----------
    prior_map : SegmentMap
    out : path or URL
    size_m, margin_m : float
        Edge of a square, and how far around it a tile reaches.
    progress : callable, optional
        Called with (tiles done, tiles in all).

    Raises
    ------
    ConfigError
        If a length makes no sense.
    SeglocError
        If something cannot be written; the old tiles are then as they were.
    """
    if not (50 <= size_m <= 1e6 and 0 <= margin_m <= 1e3):
        raise ConfigError(
            f"tiles are 50 m to 1000 km wide, with a margin of up to 1 km: not {size_m:g} and "
            f"{margin_m:g} m"
        )
    store, cells = store_of(out), _cells(prior_map, size_m)
    with store.alone():
        tiles, thin = [], []
        for done, cell in enumerate(cells):
            part = part_of(prior_map, cell, size_m, margin_m)
            owned = part_of(prior_map, cell, size_m, 0.0)
            file = written(store, part, f"tile_{cell[0]}_{cell[1]}")
            poses = len(owned.trajectory)
            tiles.append(Tile(**file.model_dump(), cell=cell, poses=poses))
            thin.append(thin_of(owned))
            if progress:
                progress(done + 1, len(cells))
        coarse = written(store, _joined(prior_map, thin), "coarse")
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


def publish(store: Store, index: TileIndex) -> None:
    """Write an index whose files are there, and remove files that nobody needs.

    Those of the index before it stay: who has read that one may still ask for them.
    """
    named = set(_named(index))
    with suppress(OSError, MapFormatError):
        named.update(_named(TileIndex.parsed(store.read(INDEX, MOST_INDEX_BYTES), store.where)))
    store.write(INDEX, index.model_dump_json(indent=1).encode())
    for name in store.names():
        ours = name.endswith(".segmap") and name.startswith(("tile_", "coarse-"))
        if ours and name not in named:
            store.remove(name)


def _named(index: TileIndex) -> list[str]:
    return [index.coarse.file, *(tile.file for tile in index.tiles)]


def part_of(
    prior_map: SegmentMap, cell: tuple[int, int], size_m: float, margin_m: float
) -> SegmentMap:
    """What lies in a square, or no farther from it than a margin along either axis."""

    def inside(positions: Float64) -> Bools:
        return in_square(positions, cell, size_m, margin_m)

    points = prior_map.cloud[:, :2] + prior_map.origin[:2]
    kept = prior_map.kept(inside(prior_map.centroids), inside(points))
    return along(kept, prior_map.trajectory[inside(prior_map.trajectory[:, :3, 3])])


def _cells(prior_map: SegmentMap, size_m: float) -> list[tuple[int, int]]:
    """The squares that a path goes through; those of the segments where there is no path."""
    path = prior_map.trajectory[:, :3, 3]
    where = path if len(path) else prior_map.centroids
    if not len(where):
        raise SeglocError("a map without a path and segments has no tiles")
    return [(int(i), int(j)) for i, j in np.unique(cells_of(where, size_m), axis=0)]


def written(store: Store, part: SegmentMap, name: str) -> TileFile:
    """A map in a file of its own; one that is there already is not written again."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "part.segmap"
        part.save(path)
        data = path.read_bytes()
    digest = digest_of(data)
    file = f"{name}-{digest}.segmap"
    if file not in store.names():
        store.write(file, data)
    return TileFile(file=file, bytes=len(data), digest=digest, segments=len(part))


def thin_of(part: SegmentMap) -> SegmentMap:
    """The best view of each object of a tile, and only so many, without the cloud."""
    none = np.zeros(len(part.cloud), dtype=bool)
    thin = compacted(part.kept(np.ones(len(part), dtype=bool), none), COARSE)
    if len(thin) <= COARSE_PER_TILE:
        return thin
    rank = np.zeros(len(thin)) if thin.quality is None else thin.quality
    order = np.argsort(-rank, kind="stable")[:COARSE_PER_TILE]
    chosen = np.zeros(len(thin), dtype=bool)
    chosen[order] = True
    return thin.kept(chosen, np.zeros(0, dtype=bool))


def _joined(prior_map: SegmentMap, parts: list[SegmentMap]) -> SegmentMap:
    """The thin maps of all tiles as one, with the whole path."""
    return compacted(along(concatenated(parts), prior_map.trajectory), COARSE)


def chosen_rows(positions: Float64, tile: Tile, others: list[Tile], index: TileIndex) -> Bools:
    """Which of a tile's (N, 2 or 3) positions no other tile has a better right to.

    A tile has a right to what lies in its square; of tiles that hold something only in their
    margins, the first does.
    """
    own = in_square(positions, tile.cell, index.size_m)
    keep = np.ones(len(positions), dtype=bool)
    for other in others:
        keep &= own | ~in_square(positions, other.cell, index.size_m)
        if other.cell < tile.cell:
            keep &= own | ~in_square(positions, other.cell, index.size_m, index.margin_m)
    return keep


def in_square(
    positions: Float64, cell: tuple[int, int], size_m: float, margin_m: float = 0.0
) -> Bools:
    """Which of (N, 2 or 3) positions lie in a square, or no farther from it than a margin."""
    low = np.array(cell) * size_m - margin_m
    high = np.array(cell) * size_m + size_m + margin_m
    xy = positions[:, :2]
    return np.asarray(((xy >= low) & (xy < high)).all(axis=1), dtype=bool)
