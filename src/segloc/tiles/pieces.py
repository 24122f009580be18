"""What queries need of tiles: each made on first use, and kept by memory."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import TypeVar

import numpy as np

from ..config import Config
from ..frontend.segmentation import Segmentation
from ..geometry import cells_of
from ..likelihood.observation import Aligned, MapCloud, Observation, QueryCloud, Walls, aligner
from ..localization import NextView
from ..localizer import cloud_of
from ..map.segment_map import SegmentMap
from ..prior import Prior
from ..proposals.occupancy import OccupancyProposer
from ..proposals.proposer import Query
from ..types import Bools, Candidate, Float64, Pose
from .index import Tile, TileIndex
from .tiled_map import TiledMap

MAX_ALL = 10
"""Maximum number of tiles that are all searched. Set by hand."""

_POINT_BYTES = 50
"""Memory of a cloud's structures by point."""

Piece = TypeVar("Piece")


class Pieces:
    """The parts of tiles that are compared with queries.

    Parameters
    ----------
    tiles : TiledMap
        Its memory is shared by all pieces.
    config : Config
    """

    def __init__(self, tiles: TiledMap, config: Config) -> None:
        self.index, self.config = tiles.index, config
        self._tiles, self._settings = tiles, config.to_yaml()

    def cloud(self, tile: Tile) -> MapCloud:
        """Return the cloud of a tile, for comparison.

        Raises
        ------
        MapFormatError
            Here and below, if the tile cannot be read; names its file.
        """

        def make(part: SegmentMap) -> MapCloud:
            return cloud_of(part, self.config)

        return self._recent(tile, make, lambda part, _: _POINT_BYTES * len(part.voxel_cloud))

    def occupancy(self, tile: Tile) -> OccupancyProposer:
        """Return the search by occupancy of the positions that are not in other tiles."""

        def make(part: SegmentMap) -> OccupancyProposer:
            proposer = OccupancyProposer(
                part.voxel_cloud,
                part.trajectory,
                self.config.occupancy,
                self.config.segmentation,
                own=partial(_in_no_other, tile=tile, index=self.index),
                parts=min(len(self.index.tiles), MAX_ALL),
            )
            proposer.prepare()
            return proposer

        return self._recent(tile, make, lambda _, proposer: proposer.nbytes)

    def _recent(
        self,
        tile: Tile,
        make: Callable[[SegmentMap], Piece],
        size: Callable[[SegmentMap, Piece], int],
    ) -> Piece:
        """Return a piece of a tile from memory, or make it of the tile's map."""
        key = make.__qualname__, self._settings, tile.file

        def build() -> tuple[Piece, int]:
            part = self._tiles.tile(tile)
            piece = make(part)
            return piece, size(part, piece)

        return self._tiles.recent.get(key, build, lambda pair: pair[1])[0]


class TiledQuery(QueryCloud):
    """A query's cloud, and the clouds of the tiles with which it was compared."""

    def __init__(self, scene: Segmentation, config: Config) -> None:
        super().__init__(scene, aligner(config.threads))
        self.clouds: dict[Tile, MapCloud] = {}  # kept for the query, whatever the memory


class TiledCloud:
    """Clouds of tiles as one: each pose is compared with the cloud of its tile.

    Parameters
    ----------
    pieces : Pieces
    tiles : sequence of Tile
        Those of the poses.
    """

    def __init__(self, pieces: Pieces, tiles: Sequence[Tile]) -> None:
        self._pieces, self._tiles = pieces, tiles

    def query(self, scene: Segmentation) -> TiledQuery:
        """Preprocess a query cloud for comparison with these."""
        return TiledQuery(scene, self._pieces.config)

    def rough_overlap(self, poses: Sequence[Pose], query: QueryCloud) -> list[float]:
        """Return the overlap at poses T_map_local before alignment, of some of the points."""
        of_tile: dict[Tile, list[int]] = {}
        for k, tile in enumerate(self._owners(poses)):
            of_tile.setdefault(tile, []).append(k)
        overlaps = np.zeros(len(poses))
        for tile, rows in of_tile.items():
            cloud = self._cloud(tile, query)
            overlaps[rows] = cloud.rough_overlap([poses[k] for k in rows], query)
        found: list[float] = overlaps.tolist()
        return found

    def next_view(self, T_one: Pose, T_other: Pose) -> NextView | None:
        """Return the shortest step that separates two poses T_map_sensor."""
        return self._pieces.cloud(self._owners([T_one])[0]).next_view(T_one, T_other)

    def around(self, T_map_local: Pose, query: QueryCloud) -> list[Pose]:
        """Return the poses at other places around one, as in one map."""
        return self._at(T_map_local, query).around(T_map_local, query)

    def aligned(self, T_map_local: Pose, query: QueryCloud, known: Pose | None = None) -> Aligned:
        """Align some of a query's points from a pose, as in one map."""
        return self._at(T_map_local, query).aligned(T_map_local, query, known)

    def measured(
        self,
        T_map_local: Pose,
        query: QueryCloud,
        known: Pose | None = None,
        *,
        align: bool = True,
    ) -> Observation:
        """Align a query from a pose, and compare it, as in one map."""
        return self._at(T_map_local, query).measured(T_map_local, query, known, align=align)

    def walls(self, T_map_local: Pose, query: QueryCloud) -> Walls:
        """Compare the walls of a query at a pose, as in one map."""
        return self._at(T_map_local, query).walls(T_map_local, query)

    def finest(self, fit: Observation, query: QueryCloud) -> Observation:
        """Return a fit, aligned as dense as the map where that tells more."""
        return self._at(fit.T_map_local, query).finest(fit, query)

    def _at(self, T_map_local: Pose, query: QueryCloud) -> MapCloud:
        return self._cloud(self._owners([T_map_local])[0], query)

    def _cloud(self, tile: Tile, query: QueryCloud) -> MapCloud:
        assert isinstance(query, TiledQuery)
        if tile not in query.clouds:
            query.clouds[tile] = self._pieces.cloud(tile)
        return query.clouds[tile]

    def _owners(self, poses: Sequence[Pose]) -> list[Tile]:
        return self._pieces.index.nearest(np.stack([T[:3, 3] for T in poses]), self._tiles)


class TiledOccupancy:
    """Proposes poses at which the query's occupied cells are occupied in one of the tiles.

    Parameters
    ----------
    pieces : Pieces
    tiles : sequence of Tile
    """

    name = OccupancyProposer.name

    def __init__(self, pieces: Pieces, tiles: Sequence[Tile]) -> None:
        self._pieces, self._tiles = pieces, tiles

    def propose(self, query: Query, prior: Prior | None = None) -> list[Candidate]:
        """Propose poses, best first; those of a tile in its own square, or beside all."""
        config = self._pieces.config
        view = query.view(config.occupancy.cell, config.occupancy.range_m, config.segmentation)
        parts = [(tile, self._pieces.occupancy(tile)) for tile in self._tiles]
        windows = max(1, sum(part.windows for _, part in parts))
        found, most = list[Candidate](), 0
        for tile, part in parts:  # by its share of windows: as many columns of the query in each
            fresh = part.propose_in_view(view, prior, part.windows / windows)
            most = max(most, len(fresh))
            if fresh:
                positions = np.stack([c.T_map_local[:3, 3] for c in fresh])
                owners = self._pieces.index.nearest(positions, self._tiles)
                found += [c for c, own in zip(fresh, owners, strict=True) if own is tile]
        return sorted(found, key=lambda c: -(c.fit or 0.0))[:most]


def _in_no_other(positions: Float64, tile: Tile, index: TileIndex) -> Bools:
    """Return which of (N, 2) positions are in the square of a tile, or in that of none."""
    others = np.array([other.cell for other in index.tiles if other.cell != tile.cell])
    cells = cells_of(positions, index.size_m)
    taken: Bools = (cells[:, None] == others.reshape(-1, 2)).all(axis=2).any(axis=1)
    return ~taken
