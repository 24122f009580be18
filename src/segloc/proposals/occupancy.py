"""Local cloud -> candidate poses, by occupancy: for queries whose segments say too little.

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
from scipy.ndimage import distance_transform_cdt
from scipy.spatial import cKDTree

from .. import _native, geometry
from ..frontend.segmentation import Segmentation, SegmentationConfig, heights_above_ground
from ..prior import Prior
from ..system.section import Section
from ..types import Candidate, Float32, Float64, Int64
from .proposer import Proposals, Query

LEVELS = (4, 5, 6)
"""Levels of windows: the widest are 4, 8 or 16 m with cells of 0.5 m."""
MIN_COLUMNS = 64
"""Columns of a query in a large map: with fewer, wider windows tell more."""
MIN_OCCUPIED = 20
"""Occupied cells of a query, below which nothing is proposed."""
SEPARATION_M, SEPARATION_DEG = 2.0, 9.0
"""Separation of candidates: nearer ones are refined to the same pose."""

HEIGHTS_M = (0.4, 0.8, 1.3, 1.9, 2.6, 3.5, 5.0, 8.0)
"""Lower edge of each slice, over ground; the last slice is open. Set by hand."""
FREE_RADIUS_M, MAX_FREE = 30.0, 256
"""Radius within which a query's free cells are used, and how many of them at most."""
_NEAREST_TO_SENSOR = 16  # ground points

_GROUND_CELL_M, _GROUND_NEIGHBOURS = 4.0, 4  # the cells in which the map's ground is kept
_MAX_FLOOR_GAP_M, _MAX_FLOOR_SLOPE = 0.5, 0.15  # of the ground from the floor below the path
_FLOOR_RADIUS_M, _FLOOR_BINS, _FLOOR_COLUMN_M = 5.0, 40, 0.5  # of the floor's histogram; bins 0.1 m

_STOREY_CELL_M, _MIN_STOREY_HEIGHT_M = 4.0, 2.0  # a cell that the path passes on two storeys
_MIN_STOREYED_SHARE = 0.2  # of such cells in a building of storeys
_LEVEL_M, _MIN_LEVEL_SHARE = 1.0, 0.05  # height range of the path on a storey, share of the path
_DROP_RADIUS_M, _DROP_STEP_M, _DROP_BINS = 1.2, 0.1, 40  # of the histogram of the floor below
_STOREY_MARGIN_M = 0.1  # below a floor

Bytes = NDArray[np.uint8]


class OccupancyConfig(Section):
    """The search for poses by occupancy."""

    enabled: bool = Field(True, description="search by occupancy if segments are inconclusive")
    cell: float = Field(0.5, ge=0.1, le=5, description="edge of a cell, metres")
    reach_m: float = Field(
        20.0, ge=1, le=200, description="search radius around the mapped trajectory"
    )
    range_m: float = Field(40.0, ge=5, le=100, description="range of the query's cells")
    yaws: int = Field(120, ge=8, le=720, description="number of headings")
    columns: int = Field(400, ge=64, le=4096, description="most occupied cells of a query")
    width: int = Field(4000, ge=16, le=10**6, description="windows divided at each level")
    work: int = Field(
        1_200_000,
        ge=1000,
        le=10**8,
        description="most columns of the query times widest windows; bounds the time",
    )
    max_candidates: int = Field(48, ge=1, le=1000, description="candidates per storey")


class OccupancyProposer:
    """Proposes poses at which what a query shows standing stands in the map, too.

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
    What it needs of the map is made when it is first asked, in 0.1 to 1 s: about 7 MB for a
    kilometre of street. A map too wide for it has no candidates. Each storey of a building is
    searched by itself.
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
        self._maps: list[_OccupancyMap] | None = None

    name = "occupancy"
    exhaustive = True

    def propose(self, query: Query, prior: Prior | None = None) -> Proposals:
        """Propose poses by the cells that are occupied or free."""
        return Proposals(self.candidates(query.scene, prior))

    def candidates(self, scene: Segmentation, near: Prior | None = None) -> list[Candidate]:
        """Candidate poses T_map_local, best first, each with its ``fit``; none if it shows little.

        Parameters
        ----------
        scene : Segmentation
            Of a local cloud.
        near : Prior, optional
            Where poses are looked for.
        """
        if self._maps is None:  # threads that ask at once make the same
            self._maps = self._prepared()
        view = view_of(scene, self.config, self._segmentation)
        found = [pose for each in self._maps for pose in each.search(view, self._origin, near)]
        found.sort(key=lambda pose: -pose[4])
        poses = [(geometry.yaw_transform(yaw, (x, y, z)), fit) for x, y, z, yaw, fit in found]
        return [Candidate(T, 0, fit) for T, fit in poses if near is None or near.holds(T)]

    def _prepared(self) -> list[_OccupancyMap]:
        """A map of each storey; all storeys together are as much work as one would be."""
        parts = list(storeys(self._cloud, self._path))
        config = self.config.model_copy(update={"work": self.config.work // len(parts)})
        return [_OccupancyMap(*part, config, self._segmentation) for part in parts]


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
        with suppress(ValueError):  # wider than the kernels' tables: nothing is found
            self._prepare(cloud, path, segmentation)

    def _prepare(self, cloud: Float32, path: Float64, segmentation: SegmentationConfig) -> None:
        """With the narrowest of the widest windows that the work allows for."""
        config = self._config
        self._ground = Ground(cloud, path, segmentation)
        heights = cloud[:, 2] - self._ground.below_cloud
        standing = heights > HEIGHTS_M[0]
        if not standing.any():
            return
        points, slices = cloud[standing], slices_of(heights[standing])
        for levels in LEVELS:
            width = config.cell * 2 ** (levels - 1)
            near = path[:, :2]
            roots = _along(near, width, config.reach_m) if len(path) else _under(cloud, width)
            self._windows = len(roots)
            if self._windows * MIN_COLUMNS <= config.work:
                farthest = config.range_m + config.cell
                self._native = _native.PoseSearch(
                    points, slices, roots, config.cell, levels, farthest
                )
                return

    def search(
        self, view: View, origin: Float64, near: Prior | None
    ) -> Iterator[tuple[float, float, float, float, float]]:
        """Position in the map, yaw and fit of the best poses."""
        config, columns, slices = self._config, view.columns, view.slices
        if self._native is None or len(columns) < MIN_OCCUPIED:
            return
        most = min(config.columns, config.work // self._windows)
        chosen = evenly(len(columns), most)
        columns, slices = columns[chosen], slices[chosen]
        poses, scores = self._native.search(
            columns,
            slices,
            view.free,
            view.clearance,
            yaws=config.yaws,
            leaf_level=1,
            width=config.width,
            count=config.max_candidates,
            separation=SEPARATION_M,
            separation_deg=SEPARATION_DEG,
            **_circle(near, origin),
        )
        if not len(poses):
            return
        heights = self._ground.below(poses[:, :2]) - view.below
        total = int(np.unpackbits(slices).sum())
        for (x, y, yaw), z, score in zip(poses, heights, scores, strict=True):
            fit = max(0.0, float(score) / total)
            yield x + origin[0], y + origin[1], z + origin[2], yaw, fit


def _circle(near: Prior | None, origin: Float64) -> dict[str, float]:
    """Where poses are looked for, seen from above and from the origin."""
    if near is None:
        return {}
    x, y = np.asarray(near.position)[:2] - origin[:2]
    return {"x": float(x), "y": float(y), "radius": near.radius_m}


def _along(path: Float64, width: float, reach: float) -> NDArray[np.int32]:
    """Windows of that width within reach of a path of (V, 2) places."""
    steps = int(np.ceil(reach / width))
    around = np.mgrid[-steps : steps + 1, -steps : steps + 1].reshape(2, -1).T
    stations = distinct(cells_of(path, width))
    windows = distinct((stations[:, None] + around).reshape(-1, 2))
    gap, _ = nearest_of(path, (windows + 0.5) * width)
    return _int32(windows[gap < reach + 0.71 * width])


def _under(cloud: Float32, width: float) -> NDArray[np.int32]:
    """Windows of that width that any point lies in."""
    return _int32(distinct(cells_of(cloud[:, :2], width)))


def _int32(cells: Int64) -> NDArray[np.int32]:
    return np.ascontiguousarray(cells, dtype=np.int32)


def storeys(cloud: Float32, path: Float64) -> Iterator[tuple[Float32, Float64]]:
    """The cloud and the path of each storey; as they are where the path is on one level.

    Parameters
    ----------
    cloud : (N, 3) float32
    path : (V, 3) float64
        Along which the cloud was recorded, in the same frame.
    """
    levels = _levels(path[:, 2]) if len(cloud) and is_storeyed(path) else np.empty(0)
    if len(levels) < 2:
        yield cloud, path
        return
    nearest = np.abs(path[:, 2, None] - levels).argmin(axis=1)
    paths = [path[nearest == k] for k in range(len(levels))]
    edges = [
        level - _drop(cloud, part) - _STOREY_MARGIN_M
        for level, part in zip(levels, paths, strict=True)
    ]
    for low, high, part in zip(edges, [*edges[1:], np.inf], paths, strict=True):
        inside = (cloud[:, 2] > low) & (cloud[:, 2] < high)
        yield np.ascontiguousarray(cloud[inside]), part


def _drop(cloud: Float32, path: Float64) -> float:
    """How far below a path its floor is: the first flat thing there, above the ceiling below."""
    gap, station = nearest_of(path[:, :2], cloud[:, :2])
    drop = (path[station, 2] - cloud[:, 2])[gap < _DROP_RADIUS_M]
    counts, edges = np.histogram(drop, bins=_DROP_BINS, range=(0.0, _DROP_STEP_M * _DROP_BINS))
    return float(edges[np.argmax(counts >= 0.5 * counts.max()) + 1])


def is_storeyed(path: Float64) -> bool:
    """Whether a path comes back well above itself, not just here and there as at a bridge.

    Parameters
    ----------
    path : (V, 3) float64
    """
    if not len(path) or np.ptp(path[:, 2]) < _MIN_STOREY_HEIGHT_M:
        return False
    _, which = np.unique(cells_of(path[:, :2], _STOREY_CELL_M), axis=0, return_inverse=True)
    which = which.reshape(-1)
    low, high = np.full(which.max() + 1, np.inf), np.full(which.max() + 1, -np.inf)
    np.minimum.at(low, which, path[:, 2])
    np.maximum.at(high, which, path[:, 2])
    return bool((high - low > _MIN_STOREY_HEIGHT_M).mean() >= _MIN_STOREYED_SHARE)


def _levels(heights: NDArray[np.float64]) -> Float64:
    """Heights at which much of the path is, rising."""
    left, levels = np.sort(heights), list[float]()
    fewest = max(1.0, _MIN_LEVEL_SHARE * len(heights))
    while len(left):
        ends = np.searchsorted(left, left + _LEVEL_M, side="right")
        counts = ends - np.arange(len(left))
        first = int(counts.argmax())
        if counts[first] < fewest:
            break
        level = float(np.median(left[first : ends[first]]))
        levels.append(level)
        left = left[np.abs(left - level) >= _MIN_STOREY_HEIGHT_M]
    return np.sort(np.array(levels))


@dataclass(frozen=True)
class View:
    """A query seen from above, about its sensor.

    Attributes
    ----------
    columns : (M, 2) float32
        Cells in which something stands, metres.
    slices : (M,) uint8
        In which slices of height.
    free : (F, 2) float32
        Cells in which the ground alone is seen, the clearest first.
    clearance : (F,) uint8
        How many cells about each nothing stands.
    below : float
        Height of the ground below the sensor, metres.
    """

    columns: Float32
    slices: Bytes
    free: Float32
    clearance: Bytes
    below: float


def view_of(scene: Segmentation, config: OccupancyConfig, segmentation: SegmentationConfig) -> View:
    """What a segmented local cloud shows."""
    near = np.hypot(scene.surface[:, 0], scene.surface[:, 1]) < config.range_m
    surface = _native.voxel_grid(scene.surface[near], config.cell)
    distance = np.hypot(surface[:, 0], surface[:, 1])
    around = np.argsort(np.hypot(scene.ground[:, 0], scene.ground[:, 1]), kind="stable")
    floor = scene.ground[around[:_NEAREST_TO_SENSOR], 2]
    below = float(np.median(floor)) if len(floor) else 0.0
    ground = surface[:, 2] - heights_above_ground(surface, segmentation)
    if len(floor):
        ground = believed(ground, np.full(len(surface), below), distance)
    heights = surface[:, 2] - ground
    standing = (heights > HEIGHTS_M[0]) & (distance < config.range_m - config.cell)
    cells = cells_of(surface[standing, :2], config.cell)
    _, first, which = np.unique(keys_of(cells), return_index=True, return_inverse=True)
    cells, slices = cells[first], np.zeros(len(first), np.uint8)
    np.bitwise_or.at(slices, which, slices_of(heights[standing]))
    free, clearance = free_cells(scene.ground, cells, config)
    return View(_middles(cells, config), slices, _middles(free, config), clearance, below)


def free_cells(
    ground: Float32, standing: Int64, config: OccupancyConfig
) -> tuple[Int64, NDArray[np.uint8]]:
    """Cells in which the ground is seen and nothing stands, nor beside them; the clearest first.

    Parameters
    ----------
    ground : (N, 3) float32
    standing : (M, 2) int64
        Cells in which something stands.
    config : OccupancyConfig

    Returns
    -------
    (F, 2) int64
    (F,) uint8
        How many cells about each nothing stands.
    """
    within = config.range_m - config.cell
    near = ground[np.hypot(ground[:, 0], ground[:, 1]) < min(FREE_RADIUS_M, within), :2]
    cells = distinct(cells_of(near, config.cell))
    if not len(cells):
        return cells, np.empty(0, np.uint8)
    reach = int(np.ceil(within / config.cell)) + 1
    empty = np.ones((2 * reach + 1, 2 * reach + 1), bool)
    empty[tuple((standing + reach).T)] = False
    clearance = distance_transform_cdt(empty)[tuple((cells + reach).T)] - 1
    free = clearance > 0
    cells, clearance = cells[free], clearance[free]
    clearest = np.argsort(-clearance, kind="stable")
    chosen = clearest[evenly(len(cells), MAX_FREE)]
    return cells[chosen], np.minimum(clearance[chosen], 255).astype(np.uint8)


def _middles(cells: Int64, config: OccupancyConfig) -> Float32:
    middles: Float32 = ((cells + 0.5) * config.cell).astype(np.float32)
    return middles


def evenly(count: int, most: int) -> Int64:
    """Which of so many rows are kept, (min(count, most),), spread over all."""
    kept = min(count, most)
    chosen: Int64 = np.arange(kept) * count // max(kept, 1)
    return chosen


def slices_of(heights: Float32) -> Bytes:
    """The bit of the slice that each point lies in, (N,) uint8."""
    slices: Bytes = (1 << (np.searchsorted(HEIGHTS_M, heights) - 1)).astype(np.uint8)
    return slices


class Ground:
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
        ground = cloud[:, 2] - heights_above_ground(cloud, segmentation)
        cells = cells_of(cloud[:, :2], _GROUND_CELL_M)
        _, first, which = np.unique(keys_of(cells), return_index=True, return_inverse=True)
        where = (cells[first] + 0.5) * _GROUND_CELL_M
        self._tree = cKDTree(where)
        if len(path) and len(cloud):
            distance, station = nearest_of(path[:, :2], where)
            floor = path[station, 2] - _mounted(cloud, path)
            ground = believed(ground, floor[which], distance[which])
        self.below_cloud: Float32 = ground.astype(np.float32)
        sums = np.bincount(which, weights=ground, minlength=len(first))
        self._heights = sums / np.maximum(np.bincount(which, minlength=len(first)), 1)

    def below(self, places: Float64) -> Float64:
        """Its height at (N, 2) places."""
        count = min(_GROUND_NEIGHBOURS, len(self._heights))
        nearest = np.asarray(self._tree.query(places, k=count)[1]).reshape(len(places), -1)
        heights: Float64 = np.median(self._heights[nearest], axis=1)
        return heights


def _mounted(cloud: Float32, path: Float64) -> float:
    """How high above its floor the mapping sensor was: most columns near it end there below."""
    gap, station = nearest_of(path[:, :2], cloud[:, :2], within=_FLOOR_RADIUS_M)
    rising = np.argsort(cloud[:, 2], kind="stable")
    rising = rising[gap[rising] < _FLOOR_RADIUS_M]
    columns = cells_of(cloud[rising, :2], _FLOOR_COLUMN_M)
    lowest = rising[np.unique(keys_of(columns), return_index=True)[1]]
    drop = path[station[lowest], 2] - cloud[lowest, 2]
    counts, edges = np.histogram(drop, bins=_FLOOR_BINS, range=(0.0, 0.1 * _FLOOR_BINS))
    return float(edges[counts.argmax()] + 0.05)


def believed(
    ground: NDArray[Any], floor: NDArray[Any], distance: NDArray[Any]
) -> NDArray[np.floating[Any]]:
    """The ground where it is near the floor, and the floor elsewhere."""
    near = np.abs(ground - floor) < _MAX_FLOOR_GAP_M + _MAX_FLOOR_SLOPE * distance
    return np.where(near, ground, floor)


def nearest_of(
    places: NDArray[Any], asked: NDArray[Any], within: float = np.inf
) -> tuple[NDArray[Any], NDArray[Any]]:
    """Distances to the nearest of (N, 2) places, and their rows; infinite, and N, beyond."""
    distance, index = cKDTree(places).query(asked, distance_upper_bound=within)
    return np.asarray(distance), np.asarray(index)


def keys_of(cells: Int64) -> Int64:
    """One number for each of (N, 2) cells, in the order of x and y."""
    keys: Int64 = cells[:, 0] * (1 << 32) + cells[:, 1]
    return keys


def distinct(cells: Int64) -> Int64:
    """Each of (N, 2) cells once, in the order of x and y."""
    return cells[np.unique(keys_of(cells), return_index=True)[1]]


def cells_of(points: NDArray[np.floating[Any]], width: float) -> Int64:
    """The square cells of (N, 2) points, (N, 2)."""
    cells: Int64 = np.floor(points / width).astype(np.int64)
    return cells
