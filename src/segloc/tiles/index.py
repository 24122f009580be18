"""``tiles.json``: the tiles with their positions and digests."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from typing import Annotated

import numpy as np
from pydantic import Field, ValidationError

from ..errors import MapFormatError
from ..geometry import cells_of
from ..prior import Prior
from ..system.checks import MAX_METRES
from ..system.section import Section
from ..types import Float64

INDEX = "tiles.json"
FORMAT_VERSION = 1
"""To be increased when older readers would misread newer files."""

MAX_INDEX_BYTES = 64_000_000
_MAX_FILE_BYTES = 1 << 36
_DIGEST = r"^[0-9a-f]{32}$"
_NAME = r"^[a-z0-9_.-]{1,100}$"  # restricts untrusted indices to files beside them

_Cell = Annotated[int, Field(ge=-(1 << 31), le=1 << 31)]


class TileFile(Section):
    """File beside the index."""

    file: str = Field(
        pattern=_NAME,
        description="name of the file, with its digest: files are never overwritten",
    )
    bytes: int = Field(ge=0, le=_MAX_FILE_BYTES, description="size of the file")
    digest: str = Field(pattern=_DIGEST, description="BLAKE2b-128 of the file")
    segments: int = Field(ge=0, description="number of segments")


class Tile(TileFile):
    """Map of one square."""

    cell: tuple[_Cell, _Cell] = Field(
        description="(i, j): owns x from i to i + 1 times `size_m`, and y likewise"
    )
    poses: int = Field(ge=0, description="poses of the trajectory in the square")


class TileIndex(Section):
    """Content of ``tiles.json``."""

    version: int = Field(ge=1, description="format version")
    size_m: float = Field(gt=0, le=MAX_METRES, description="edge of a square [m]")
    margin_m: float = Field(
        ge=0, le=MAX_METRES, description="margin around its square that a tile also holds [m]"
    )
    descriptor: str = Field(max_length=1000, description="name of the descriptor")
    fingerprint: str = Field(max_length=1000, description="hash of its weights and preprocessing")
    coarse: TileFile = Field(description="thin map of all tiles, without clouds")
    tiles: tuple[Tile, ...] = Field(description="tiles, each a file with a square")

    @classmethod
    def parse(cls, data: bytes, where: str) -> TileIndex:
        """Parse an index.

        Raises
        ------
        MapFormatError
            If it is invalid or of a newer version; names ``where``.
        """
        try:
            index = cls.model_validate_json(data)
        except (ValidationError, RecursionError) as error:
            first = error.errors()[0] if isinstance(error, ValidationError) else None
            key = ".".join(str(part) for part in first["loc"])[:80] if first else ""
            raise MapFormatError(f"{where}: not an index of tiles ({key or 'no JSON'})") from error
        if index.version > FORMAT_VERSION:
            raise MapFormatError(f"{where}: written by a newer segloc (tiles {index.version})")
        if len({tile.cell for tile in index.tiles}) < len(index.tiles):
            raise MapFormatError(f"{where}: damaged: two tiles of one square")
        return index

    def near(self, prior: Prior) -> tuple[Tile, ...]:
        """Return the tiles whose squares may hold a sensor near a prior."""
        distances = self._distances(self.tiles, np.asarray(prior.position)[None])[0]
        return tuple(self.tiles[k] for k in np.flatnonzero(distances <= prior.radius_m).tolist())

    def owners(self, positions: Float64) -> list[Tile | None]:
        """Return the tile that owns each of (N, 2 or 3) positions.

        Off the trajectory there may be none; then it is the nearest whose margin reaches there.
        """
        by_cell, places = {tile.cell: tile for tile in self.tiles}, positions[:, :2]
        return [
            by_cell.get((int(cell[0]), int(cell[1]))) or self._reaching(x, y)
            for (x, y), cell in zip(places, cells_of(places, self.size_m), strict=True)
        ]

    def nearest(self, positions: Float64, tiles: Sequence[Tile]) -> list[Tile]:
        """Return that one of some tiles whose square has, or is nearest to, each of (N, 2 or 3)
        positions."""
        return [tiles[k] for k in self._distances(tiles, positions).argmin(axis=1).tolist()]

    def _reaching(self, x: float, y: float) -> Tile | None:
        """Return the nearest tile whose margin contains a position."""
        nearest = min(self.tiles, key=lambda tile: self.distance(tile, x, y), default=None)
        if nearest is None or self.distance(nearest, x, y) > self.margin_m:
            return None
        return nearest

    def distance(self, tile: Tile, x: float, y: float) -> float:
        """Return the distance from a position to a tile's square [m]; 0 inside."""
        return float(self._distances([tile], np.array([[x, y]]))[0, 0])

    def _distances(self, tiles: Sequence[Tile], positions: Float64) -> Float64:
        """Return the distances from (N, 2 or 3) positions to the squares of M tiles, (N, M) [m]."""
        low = np.array([tile.cell for tile in tiles]).reshape(-1, 2) * self.size_m
        at = positions[:, None, :2]
        beyond = np.maximum(np.maximum(low - at, at - low - self.size_m), 0.0)
        distances: Float64 = np.hypot(beyond[..., 0], beyond[..., 1])
        return distances


def digest_of(data: bytes) -> str:
    """Return BLAKE2b-128 as hexadecimal digits."""
    return hashlib.blake2b(data, digest_size=16).hexdigest()
