"""A map -> tiles in a folder or bucket, replaced one by one."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import Executor
from contextlib import suppress
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from numpy.typing import NDArray

from ..errors import ConfigError, MapFormatError, SeglocError
from ..map.compact import CompactConfig, compacted
from ..map.segment_map import SegmentMap, along, concatenated
from ..system.processes import all_of
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
COARSE_A_KM2, COARSE_AT_LEAST = 24_000, 500
"""Segments in the thin map of all tiles: of a square kilometre, and of a tile at least."""
COARSE = CompactConfig(bits=4, max_views=1, cloud_bits=0)
"""What the thin map of all tiles keeps."""

AT_ONCE = 64
"""Tiles that are in memory together."""

Bools = NDArray[np.bool_]
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
    executor : Executor, optional
        Writes the tiles, where all its workers see ``out``; by default this process does. What
        comes of it is the same.

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
    tasks = (
        _Task(part, cell, size_m, out) for cell, part in _parts(prior_map, cells, size_m, margin_m)
    )
    with store.alone():
        found: list[tuple[Tile, SegmentMap]] = []
        while some := list(islice(tasks, AT_ONCE)):
            found += all_of(_cut, some, executor)
            if progress:
                progress(len(found), len(cells))
        found.sort(key=lambda made: made[0].cell)
        tiles, thin = [tile for tile, _ in found], [part for _, part in found]
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


@dataclass(frozen=True)
class _Task:
    """A tile to be written: what it holds, and where."""

    part: SegmentMap
    cell: Cell
    size_m: float
    out: str | Path


def _cut(task: _Task) -> tuple[Tile, SegmentMap]:
    """Write a tile; the best of what it owns."""
    cell, owned = task.cell, part_of(task.part, task.cell, task.size_m, 0.0)
    file = written(store_of(task.out), task.part, f"tile_{cell[0]}_{cell[1]}")
    return Tile(**file.model_dump(), cell=cell, poses=len(owned.trajectory)), thin_of(
        owned, task.size_m
    )


def _parts(
    prior_map: SegmentMap, cells: list[Cell], size_m: float, margin_m: float
) -> Iterator[tuple[Cell, SegmentMap]]:
    """What each square and its margin hold; by halves, so that none is looked for in the whole."""
    if len(cells) == 1:
        yield cells[0], part_of(prior_map, cells[0], size_m, margin_m)
        return
    spans = np.ptp(np.array(cells), axis=0)
    ordered = sorted(cells, key=lambda cell: cell[int(spans.argmax())])
    half, around_m = len(ordered) // 2, margin_m + 1.0  # of each square it is decided at the end
    for some in (ordered[:half], ordered[half:]):
        low, high = np.min(some, axis=0) * size_m, (np.max(some, axis=0) + 1) * size_m
        near = _within(prior_map, low - around_m, high + around_m)
        yield from _parts(near, some, size_m, margin_m)


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


def part_of(prior_map: SegmentMap, cell: Cell, size_m: float, margin_m: float) -> SegmentMap:
    """What lies in a square, or no farther from it than a margin along either axis."""
    return _within(prior_map, *_box(cell, size_m, margin_m))


def _within(prior_map: SegmentMap, low: Float64, high: Float64) -> SegmentMap:
    """What lies in a box, seen from above."""
    points = prior_map.cloud[:, :2] + prior_map.origin[:2]
    path = prior_map.trajectory
    kept = prior_map.kept(_inside(prior_map.centroids, low, high), _inside(points, low, high))
    return along(kept, path[_inside(path[:, :3, 3], low, high)])


def _cells(prior_map: SegmentMap, size_m: float) -> list[Cell]:
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


def thin_of(part: SegmentMap, size_m: float) -> SegmentMap:
    """The best view of each object of a tile, and only so many, without the cloud."""
    most = max(COARSE_AT_LEAST, round(COARSE_A_KM2 * (size_m / 1e3) ** 2))
    none = np.zeros(len(part.cloud), dtype=bool)
    thin = compacted(part.kept(np.ones(len(part), dtype=bool), none), COARSE)
    if len(thin) <= most:
        return thin
    rank = thin.sizes if thin.quality is None else thin.quality
    order = np.argsort(-rank, kind="stable")[:most]
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
    return _inside(positions, *_box(cell, size_m, margin_m))


def _box(cell: Cell, size_m: float, margin_m: float) -> tuple[Float64, Float64]:
    low = np.array(cell) * size_m
    return low - margin_m, low + size_m + margin_m


def _inside(positions: Float64, low: Float64, high: Float64) -> Bools:
    x, y = positions[:, 0], positions[:, 1]
    return np.asarray((x >= low[0]) & (x < high[0]) & (y >= low[1]) & (y < high[1]), dtype=bool)
