"""Tiles in a folder or bucket, opened: read when they are needed, and checked."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from ..errors import MapFormatError, MapMismatch
from ..localizer import Localizer
from ..map.segment_map import SegmentMap, along, concatenated
from .cut import chosen_rows
from .index import INDEX, Tile, TileFile, TileIndex
from .search import Recent, TileSearch
from .store import Folder, Reader, store_of

CACHE_BYTES = 1 << 30
TIMEOUT_S = 30.0
MEMORY_BYTES = 1 << 27


class TiledMap:
    """A map in tiles, which :func:`cut_tiles` wrote.

    Parameters
    ----------
    where : path or URL
        Of the folder of ``tiles.json``.
    cache : path, optional
        A folder for copies of tiles behind a URL; by default below the user's cache. Tiles in a
        folder are read where they lie.
    cache_bytes : int
        The copies take so many bytes at most, and one tile.
    memory_bytes : int
        Tiles, and what searches several of them, take about so many in memory, and the last one.
    timeout_s : float
        A file that takes longer to come has failed.

    Attributes
    ----------
    index : TileIndex
    where : str
    recent : Recent
        Tiles, and what searches them, that were used last.

    Raises
    ------
    MapFormatError
        If there are no tiles, or their index is damaged.
    MissingDependency
        If it is a URL, and fsspec is not installed.

    Notes
    -----
    Any number of threads may use it at once.
    """

    def __init__(
        self,
        where: str | Path,
        *,
        cache: str | Path | None = None,
        cache_bytes: int = CACHE_BYTES,
        memory_bytes: int = MEMORY_BYTES,
        timeout_s: float = TIMEOUT_S,
    ) -> None:
        store = store_of(where)
        copies = None if isinstance(store, Folder) else Path(cache or _users_cache(store.where))
        self.where = store.where
        self._reader = Reader(store, copies, cache_bytes, timeout_s)
        self.index = TileIndex.parsed(self._reader.index(INDEX), f"{store.where}/{INDEX}")
        self.recent = Recent(memory_bytes)
        self._opened_by = where, cache, cache_bytes, memory_bytes, timeout_s

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickled by where it lies, and opened anew: so it goes to other processes."""
        return _reopened, self._opened_by

    def __len__(self) -> int:
        return len(self.index.tiles)

    def __repr__(self) -> str:
        return f"TiledMap({self.where!r}, {len(self)} tiles)"

    def coarse(self) -> SegmentMap:
        """The thin map of all tiles: no cloud, and the whole path."""
        return self._loaded(self.index.coarse)

    def tile(self, tile: Tile) -> SegmentMap:
        """One tile.

        Raises
        ------
        MapFormatError
            If it is missing, damaged, or takes too long; names its file.
        """
        return self.recent.get(
            tile.file, SegmentMap, lambda: self._loaded(tile), lambda part: part.memory_bytes
        )

    def search(self, coarse: Localizer) -> TileSearch:
        """The search in tiles, for :class:`segloc.Localizer`."""
        return TileSearch(self, coarse)

    def together(self, tiles: Sequence[Tile]) -> SegmentMap:
        """Some tiles as one map; what several of them hold is in it once.

        Raises
        ------
        MapFormatError
            If one of them cannot be had; names its file.
        """
        if len(tiles) == 1:
            return self.tile(tiles[0])
        parts = []
        for tile in tiles:
            part = self.tile(tile)
            others = [other for other in tiles if other.cell != tile.cell]
            points = part.cloud[:, :2] + part.origin[:2]
            rows = chosen_rows(part.centroids, tile, others, self.index)
            kept = part.kept(rows, chosen_rows(points, tile, others, self.index))
            path = part.trajectory
            own = chosen_rows(path[:, :3, 3], tile, others, self.index)
            parts.append(along(kept, path[own]))
        return concatenated(parts, apart=True)

    def _loaded(self, file: TileFile) -> SegmentMap:
        data = self._reader.tile(file)
        where = f"{self.where}/{file.file}"
        with TemporaryDirectory() as folder:
            path = Path(folder) / file.file
            path.write_bytes(data)
            try:
                loaded = SegmentMap.load(path)
            except MapFormatError as error:
                raise MapFormatError(str(error).replace(str(path), where)) from error
        if (loaded.descriptor, loaded.fingerprint) != (
            self.index.descriptor,
            self.index.fingerprint,
        ):
            raise MapMismatch(f"{where}: made by another descriptor than the index says")
        return loaded


def _reopened(
    where: str | Path,
    cache: str | Path | None,
    cache_bytes: int,
    memory_bytes: int,
    timeout_s: float,
) -> TiledMap:
    return TiledMap(
        where,
        cache=cache,
        cache_bytes=cache_bytes,
        memory_bytes=memory_bytes,
        timeout_s=timeout_s,
    )


def _users_cache(where: str) -> Path:
    """A folder for copies of what a URL names."""
    base = os.environ.get("XDG_CACHE_HOME") or str(Path.home() / ".cache")
    digest = hashlib.blake2b(where.encode(), digest_size=8).hexdigest()
    return Path(base) / "segloc" / "tiles" / digest
