"""Tiled maps, read and checked on demand."""

from __future__ import annotations

import hashlib
import os
import time
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from threading import Lock
from typing import Any, TypeVar

from ..errors import MapMismatch
from ..map.coding import Stored
from ..map.info import MapInfo
from ..map.segment_map import SegmentMap, concatenate_maps, part_where, with_parts
from ..system.stage_times import Clock
from ..types import Float32
from .cut import owned_rows
from .index import INDEX, MAX_INDEX_BYTES, Tile, TileFile, TileIndex
from .store import Folder, Reader, store_of

CACHE_BYTES = 1 << 30
TIMEOUT_S = 30.0
MEMORY_BYTES = 1 << 29

Value = TypeVar("Value")


class TiledMap:
    """A map in tiles, as written by :func:`cut_tiles`.

    Parameters
    ----------
    where : path or URL
        Folder of ``tiles.json``.
    cache : path, optional
        Folder for copies of tiles behind a URL; by default in the user's cache. Local tiles are
        read in place.
    cache_bytes : int
        Maximum size of the copies, apart from one tile.
    memory_bytes : int
        Approximate memory of tiles and their localizers, apart from the latest one.
    timeout_s : float
        Maximum time for a file [s].

    Attributes
    ----------
    index : TileIndex
    where : str
    recent : Recent
        Tiles and localizers used last.

    Raises
    ------
    MapFormatError
        If there are no tiles, or their index is damaged.
    MissingDependency
        If it is a URL, and fsspec is not installed.

    Notes
    -----
    Thread-safe.
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
        index = self._reader.fetch(INDEX, MAX_INDEX_BYTES)
        self.index = TileIndex.parse(index, f"{store.where}/{INDEX}")
        self.recent = Recent(memory_bytes)
        self._reopen = partial(
            TiledMap,
            where,
            cache=cache,
            cache_bytes=cache_bytes,
            memory_bytes=memory_bytes,
            timeout_s=timeout_s,
        )

    def __reduce__(self) -> tuple[Callable[[], TiledMap], tuple[()]]:
        """Pickle the location, to be reopened in another process."""
        return self._reopen, ()

    def __len__(self) -> int:
        return len(self.index.tiles)

    def __repr__(self) -> str:
        return f"TiledMap({self.where!r}, {len(self)} tiles)"

    def info(self) -> MapInfo:
        """Return facts about the map, as :meth:`SegmentMap.info`; tiles repeat what is in several.

        Raises
        ------
        MapFormatError
            If the thin map of all tiles is missing or damaged.
        """
        found = MapInfo(self.coarse().info(), tiles=len(self), tile_m=self.index.size_m)
        for thin in ("segments", "cloud_points", "memory_bytes"):
            del found[thin]
        return found

    def coarse(self) -> SegmentMap:
        """Return the thin map of all tiles, with the whole trajectory and no cloud."""
        return self._load(self.index.coarse)

    def tile(self, tile: Tile) -> SegmentMap:
        """Return one tile.

        Raises
        ------
        MapFormatError
            If it is missing, damaged, or takes too long; names its file.
        """
        return self.recent.get(tile.file, lambda: self._load(tile), lambda m: m.memory_bytes)

    def together(self, tiles: Sequence[Tile], *, cloud_later: bool = False) -> SegmentMap:
        """Return some tiles as one map, without repetitions.

        cloud_later: True to read the cloud anew whenever it is used.

        Raises
        ------
        MapFormatError
            If a tile is unavailable; names its file.
        """
        if len(tiles) == 1:
            return self.tile(tiles[0])
        parts = []
        for tile in tiles:
            others = [other for other in tiles if other.cell != tile.cell]
            owned = partial(owned_rows, tile=tile, others=others, index=self.index)
            parts.append(part_where(self.tile(tile), owned, cloud=not cloud_later))
        joined = concatenate_maps(parts, apart=True)
        if cloud_later:
            return with_parts(joined, points=_Later(partial(self._cloud_of, tiles)))
        return joined

    def _cloud_of(self, tiles: Sequence[Tile]) -> Float32:
        return self.together(tiles).cloud

    def _load(self, file: TileFile) -> SegmentMap:
        where = f"{self.where}/{file.file}"
        loaded = SegmentMap.from_bytes(self._reader.tile(file), where)
        index = self.index
        if (loaded.descriptor, loaded.fingerprint) != (index.descriptor, index.fingerprint):
            raise MapMismatch(f"{where}: its descriptor differs from the index")
        return loaded


class Recent:
    """Thread-safe cache that drops what takes least time to make again, by its size and last use.

    GreedyDual-Size (P. Cao, S. Irani, "Cost-Aware WWW Proxy Caching Algorithms", USITS 1997): each
    entry is worth its seconds a byte, and as much more as what was dropped before its last use.

    Parameters
    ----------
    most_bytes : int
        Maximum size, apart from the latest entry.
    clock : callable
        Clock of the time that entries take; returns seconds.
    """

    def __init__(self, most_bytes: int, clock: Clock = time.perf_counter) -> None:
        self._most_bytes, self._clock, self._floor = most_bytes, clock, 0.0
        self._kept: dict[Hashable, _Kept] = {}
        self._lock = Lock()

    def __len__(self) -> int:
        return len(self._kept)

    @property
    def bytes(self) -> int:
        """Total size of the entries."""
        with self._lock:
            return sum(kept.size for kept in self._kept.values())

    def get(self, key: Hashable, make: Callable[[], Value], size: Callable[[Value], int]) -> Value:
        """Return the entry of a key, or create it."""
        with self._lock:
            if key in self._kept:
                kept = self._kept[key] = self._kept.pop(key)  # of like worth, the latest goes last
                kept.worth = self._floor + kept.seconds / kept.size
                found: Value = kept.value
                return found
        start = self._clock()
        made = make()
        seconds, taken = self._clock() - start, max(1, size(made))
        with self._lock:
            self._kept.pop(key, None)  # another thread may have made it, too
            excess = sum(kept.size for kept in self._kept.values()) + taken - self._most_bytes
            while excess > 0 and self._kept:
                dropped = self._kept.pop(min(self._kept, key=lambda k: self._kept[k].worth))
                self._floor, excess = dropped.worth, excess - dropped.size
            self._kept[key] = _Kept(made, taken, seconds, self._floor + seconds / taken)
        return made


@dataclass
class _Kept:
    """An entry of a cache, with its size in bytes and the time that it took."""

    value: Any
    size: int
    seconds: float
    worth: float


class _Later(Stored):
    """An array that is made on use."""

    def __init__(self, make: Callable[[], Float32]) -> None:
        super().__init__(0, 0, make)

    def __len__(self) -> int:
        return len(self.array())


def _users_cache(where: str) -> Path:
    """Return the default folder for copies of a URL's files."""
    base = os.environ.get("XDG_CACHE_HOME") or str(Path.home() / ".cache")
    digest = hashlib.blake2b(where.encode(), digest_size=8).hexdigest()
    return Path(base) / "segloc" / "tiles" / digest
