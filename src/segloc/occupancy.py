"""Local cloud -> candidate poses, by what stands where: for queries whose segments say too little.

The map and the query are looked at from above: which cells are occupied, at which heights over
ground. Poses are searched by branch and bound over windows that hold all that their cells do. W.
Hess, D. Kohler, H. Rapp, D. Andor, "Real-time loop closure in 2D LIDAR SLAM", ICRA 2016, search
maps of one floor so; here a cell has several heights, and the work is bounded.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from scipy.spatial import cKDTree

from . import _native, geometry
from .section import Section
from .segmentation import Segmentation, SegmentationConfig
from .types import Candidate, Float32, Float64, Int64

HEIGHTS_M = (0.4, 0.8, 1.3, 1.9, 2.6, 3.5, 5.0, 8.0)
"""Where each slice begins, over ground; the last one has no end. Set by hand."""
LEVELS = (4, 5, 6)
"""Of windows: the widest are 4, 8 or 16 m with cells of half a metre."""
FEWEST_COLUMNS = 64
"""Of a query in a large map: with fewer, wider windows tell more."""
FEWEST_OCCUPIED = 20
"""A query that shows less standing says nothing."""
SEPARATION_M, SEPARATION_DEG = 2.0, 9.0
"""Of candidates: nearer ones are refined to the same pose."""
_GROUND_M = 4.0  # edge of the cells in which the map's ground is kept
_NEAREST_GROUND = 4
_FLOOR_M, _FLOOR_SLOPE = 0.5, 0.15  # by which the ground may differ from that below the path
_FLOOR_RADIUS_M, _FLOOR_BINS = 5.0, 40  # where the floor is looked for: so near, so many decimetres
_FLOOR_SAMPLE = 100_000
_NEAREST_TO_SENSOR = 16

Bytes = NDArray[np.uint8]


class OccupancyConfig(Section):
    """The search for poses by what stands where."""

    enabled: bool = Field(
        True, description="where segments decide nothing, search by what stands where"
    )
    cell: float = Field(0.5, ge=0.1, le=5, description="edge of a cell, metres")
    reach_m: float = Field(
        20.0, ge=1, le=200, description="a sensor is searched for this near the mapped path"
    )
    range_m: float = Field(
        40.0, ge=5, le=100, description="what a query shows farther away is left out"
    )
    yaws: int = Field(120, ge=8, le=720, description="headings that are tried")
    columns: int = Field(200, ge=64, le=4096, description="occupied cells of a query at most")
    width: int = Field(2000, ge=16, le=10**6, description="windows that are divided at each level")
    work: int = Field(
        600_000,
        ge=1000,
        le=10**8,
        description="columns of the query times widest windows at most; bounds the time",
    )
    max_candidates: int = Field(16, ge=1, le=1000, description="candidates for verification")


class OccupancySearch:
    """Finds poses at which what a query shows standing stands in the map, too.

    Parameters
    ----------
    cloud : (N, 3) float32
        The map's, relative to ``origin``; with its ground.
    origin : (3,) float64
    trajectory : (V, 4, 4) float64
        Along which the map was recorded. Without one the sensor may be wherever the cloud is.
    config : OccupancyConfig, optional
    segmentation : SegmentationConfig, optional
        What ground is.

    Notes
    -----
    What it needs of the map is made when it is first asked, in 0.1 to 1 s: about 3 MB for a
    kilometre of street. A map too wide for it has no candidates.
    """

    def __init__(
        self,
        cloud: Float32,
        origin: Float64,
        trajectory: Float64,
        config: OccupancyConfig | None = None,
        segmentation: SegmentationConfig | None = None,
    ) -> None:
        self.config = config or OccupancyConfig()
        self._cloud, self._origin = cloud, origin
        self._path = trajectory[:, :3, 3] - origin
        self._segmentation = segmentation or SegmentationConfig()
        self._map: _OccupancyMap | None = None

    def candidates(self, scene: Segmentation) -> list[Candidate]:
        """Candidate poses T_map_local, best first, each with its ``fit``; none if it shows little.

        Parameters
        ----------
        scene : Segmentation
            Of a local cloud.
        """
        if self._map is None:  # threads that ask at once make the same
            self._map = _OccupancyMap(self._cloud, self._path, self.config, self._segmentation)
        view = _view(scene, self.config, self._segmentation)
        return [
            Candidate(geometry.yaw_transform(yaw, (x, y, z)), 0, fit)
            for x, y, z, yaw, fit in self._map.search(view, self._origin)
        ]


@dataclass(frozen=True)
class _View:
    """What a query shows: (M, 2) occupied cells about the sensor, their slices, the ground."""

    columns: Float32
    slices: Bytes
    below: float


class _Ground:
    """The ground of a map: below its points, and wherever a sensor may stand.

    Returns from below the floor (mirrors, stairs) pull it down, and where no floor was seen it is
    too high. So it is only believed where it differs from the floor that the mapping sensor stood
    on by no more than its distance from the path allows for; elsewhere the floor stands in for it.

    Attributes
    ----------
    below_cloud : (N,) float32
        The height of the ground below each point of the cloud.
    """

    def __init__(self, cloud: Float32, path: Float64, segmentation: SegmentationConfig) -> None:
        ground = cloud[:, 2] - _heights(cloud, segmentation)
        cells = _cells(cloud[:, :2], _GROUND_M)
        keys = cells[:, 0] * (1 << 32) + cells[:, 1]
        _, first, which = np.unique(keys, return_index=True, return_inverse=True)
        self._places = (cells[first] + 0.5) * _GROUND_M
        if len(path) and len(cloud):
            distance, station = cKDTree(path[:, :2]).query(self._places)
            floor = path[station, 2] - _mounted(cloud, path)
            ground = _believed(ground, floor[which], distance[which])
        self.below_cloud: Float32 = ground.astype(np.float32)
        sums = np.bincount(which, weights=ground, minlength=len(first))
        self._heights = sums / np.maximum(np.bincount(which, minlength=len(first)), 1)

    def below(self, places: Float64) -> Float64:
        """Its height at (N, 2) places."""
        count = min(_NEAREST_GROUND, len(self._places))
        _, nearest = cKDTree(self._places).query(places, k=[*range(1, count + 1)])
        heights: Float64 = np.median(self._heights[nearest], axis=1)
        return heights


def _mounted(cloud: Float32, path: Float64) -> float:
    """How high above its floor the mapping sensor was: most that lies below it lies there."""
    cloud = cloud[:: len(cloud) // _FLOOR_SAMPLE + 1]
    gap, station = cKDTree(path[:, :2]).query(cloud[:, :2], distance_upper_bound=_FLOOR_RADIUS_M)
    near = np.isfinite(gap)
    drop = path[station[near], 2] - cloud[near, 2]
    counts, edges = np.histogram(drop, bins=_FLOOR_BINS, range=(0.0, 0.1 * _FLOOR_BINS))
    return float(edges[counts.argmax()] + 0.05)


def _believed(
    ground: NDArray[Any], floor: NDArray[Any], distance: NDArray[Any]
) -> NDArray[np.floating[Any]]:
    """The ground where it is near the floor, and the floor elsewhere."""
    near = np.abs(ground - floor) < _FLOOR_M + _FLOOR_SLOPE * distance
    return np.where(near, ground, floor)


class _OccupancyMap:
    """A map, made ready to be searched."""

    def __init__(
        self,
        cloud: Float32,
        path: Float64,
        config: OccupancyConfig,
        segmentation: SegmentationConfig,
    ) -> None:
        self._config = config
        self._windows = 0
        self._native: _native.PoseSearch | None = None
        self._ground = _Ground(cloud, path, segmentation)
        heights = cloud[:, 2] - self._ground.below_cloud
        standing = heights > HEIGHTS_M[0]
        if not standing.any():
            return
        points, slices = cloud[standing], _slices(heights[standing])
        for levels in LEVELS:
            width = config.cell * 2 ** (levels - 1)
            near = path[:, :2]
            roots = _along(near, width, config.reach_m) if len(path) else _under(cloud, width)
            self._windows = len(roots)
            if self._windows * FEWEST_COLUMNS <= config.work:
                farthest = config.range_m + config.cell
                with suppress(ValueError):  # wider than the kernel's tables
                    self._native = _native.PoseSearch(
                        points, slices, roots, config.cell, levels, farthest
                    )
                return

    def search(
        self, view: _View, origin: Float64
    ) -> Iterator[tuple[float, float, float, float, float]]:
        """Position in the map, yaw and fit of the best poses."""
        config, columns, slices = self._config, view.columns, view.slices
        if self._native is None or len(columns) < FEWEST_OCCUPIED:
            return
        most = min(config.columns, config.work // self._windows)
        if len(columns) > most:
            chosen = np.arange(most) * len(columns) // most
            columns, slices = columns[chosen], slices[chosen]
        poses, scores = self._native.search(
            columns,
            slices,
            yaws=config.yaws,
            leaf_level=1,
            width=config.width,
            count=config.max_candidates,
            separation=SEPARATION_M,
            separation_deg=SEPARATION_DEG,
        )
        heights = self._ground.below(poses[:, :2]) - view.below
        total = int(np.unpackbits(slices).sum())
        for (x, y, yaw), z, score in zip(poses, heights, scores, strict=True):
            yield x + origin[0], y + origin[1], z + origin[2], yaw, float(score) / total


def _view(scene: Segmentation, config: OccupancyConfig, segmentation: SegmentationConfig) -> _View:
    surface = _native.voxel_grid(scene.surface, config.cell)
    distance = np.hypot(surface[:, 0], surface[:, 1])
    around = np.argsort(np.hypot(scene.ground[:, 0], scene.ground[:, 1]), kind="stable")
    floor = scene.ground[around[:_NEAREST_TO_SENSOR], 2]
    below = float(np.median(floor)) if len(floor) else 0.0
    ground = surface[:, 2] - _heights(surface, segmentation)
    if len(floor):
        ground = _believed(ground, np.full(len(surface), below), distance)
    heights = surface[:, 2] - ground
    standing = (heights > HEIGHTS_M[0]) & (distance < config.range_m - config.cell)
    cells, which = np.unique(
        _cells(surface[standing, :2], config.cell), axis=0, return_inverse=True
    )
    slices = np.zeros(len(cells), np.uint8)
    np.bitwise_or.at(slices, which.reshape(-1), _slices(heights[standing]))
    columns = ((cells + 0.5) * config.cell).astype(np.float32)
    return _View(columns, slices, below)


def _heights(points: Float32, config: SegmentationConfig) -> Float32:
    return _native.heights_above_ground(
        points, config.ground_cell, config.ground_slope, config.ground_step
    )


def _slices(heights: Float32) -> Bytes:
    """The bit of the slice that each point lies in, (N,) uint8."""
    slices: Bytes = (1 << (np.searchsorted(HEIGHTS_M, heights) - 1)).astype(np.uint8)
    return slices


def _along(path: Float64, width: float, reach: float) -> NDArray[np.int32]:
    """Windows of that width within reach of a path of (V, 2) places."""
    steps = int(np.ceil(reach / width))
    around = np.mgrid[-steps : steps + 1, -steps : steps + 1].reshape(2, -1).T
    stations = np.unique(_cells(path, width), axis=0)
    windows = np.unique((stations[:, None] + around).reshape(-1, 2), axis=0)
    gap = cKDTree(path).query((windows + 0.5) * width)[0]
    return _int32(windows[gap < reach + 0.71 * width])


def _under(cloud: Float32, width: float) -> NDArray[np.int32]:
    """Windows of that width that any point lies in."""
    return _int32(np.unique(_cells(cloud[:, :2], width), axis=0))


def _cells(points: NDArray[np.floating[Any]], width: float) -> Int64:
    cells: Int64 = np.floor(points / width).astype(np.int64)
    return cells


def _int32(cells: Int64) -> NDArray[np.int32]:
    return np.ascontiguousarray(cells, dtype=np.int32)
