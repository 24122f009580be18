"""Local cloud -> candidate poses, by occupancy: if segments are inconclusive.

Map and query become 2D grids whose cells hold the occupied heights above ground. Poses are searched
by branch and bound over windows that hold the union of their cells, as in W. Hess, D. Kohler, H.
Rapp, D. Andor, "Real-time loop closure in 2D LIDAR SLAM", ICRA 2016. In addition a cell has several
heights, and the work is bounded.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import suppress
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from scipy.spatial import cKDTree

from .. import _native, geometry
from ..frontend.segmentation import SegmentationConfig, heights_above_ground
from ..geometry import cells_of, distinct, keys_of
from ..map.voxel_cloud import VoxelCloud
from ..prior import Prior, within
from ..system.section import Section
from ..types import Bools, Candidate, Float32, Float64, Int64
from .proposer import Query
from .view import HEIGHTS_M, View, evenly, plausible_ground, slices_of

EXTENTS = ((4, 2), (4, 1), (5, 1), (6, 1))
"""Levels of windows, of which the widest are 4, 8 or 16 m with cells of 0.5 m, and the factor of
the search radius: the first that leaves enough columns is used."""
MIN_COLUMNS, MIN_WORK = 64, 1000
"""Fewest columns of a query in a large map; wider windows are better than fewer columns."""
MIN_OCCUPIED = 20
"""Fewest occupied cells of a query for a search."""
SEPARATION_M, SEPARATION_DEG = 2.0, 9.0
"""Separation of candidates: nearer ones are refined to the same pose."""

_GROUND_CELL_M, _GROUND_NEIGHBOURS = 4.0, 4  # cells of the map's ground
_FLOOR_RADIUS_M, _FLOOR_COLUMN_M = 5.0, 0.5  # of the floor's histogram

_STOREY_CELL_M, _MIN_STOREY_HEIGHT_M = 4.0, 2.0  # a cell passed on two storeys
_MIN_STOREYED_SHARE = 0.2  # of such cells in a building
_LEVEL_M, _MIN_LEVEL_SHARE = 1.0, 0.05  # height range of a storey, share of the trajectory
_DROP_RADIUS_M = 1.2  # of the floor of a storey
_DROP_STEP_M, _DROP_BINS = 0.1, 40  # of histograms of heights above the floor
_STOREY_MARGIN_M = 0.1  # below a floor


class OccupancyConfig(Section):
    """Search for poses by occupancy."""

    enabled: bool = Field(True, description="search by occupancy if segments are inconclusive")
    cell: float = Field(0.5, ge=0.1, le=5, description="edge of a cell, metres")
    reach_m: float = Field(
        20.0,
        ge=1,
        le=200,
        description="search radius around the mapped trajectory; twice that in maps of up to 4 km",
    )
    range_m: float = Field(40.0, ge=5, le=100, description="range of the query's cells")
    yaws: int = Field(120, ge=8, le=720, description="number of headings")
    columns: int = Field(400, ge=MIN_COLUMNS, le=4096, description="most occupied cells of a query")
    width: int = Field(1000, ge=16, le=10**6, description="windows divided at each level")
    work: int = Field(
        1_200_000,
        ge=MIN_WORK,
        le=10**8,
        description="most query columns times widest windows; bounds the time",
    )
    max_candidates: int = Field(24, ge=1, le=1000, description="candidates per storey")


class OccupancyProposer:
    """Proposes poses at which the query's occupied cells are occupied in the map.

    Parameters
    ----------
    cloud : VoxelCloud
        Cloud of the map with its ground.
    trajectory : (V, 4, 4) float64
        Poses of the mapping sensor. If empty, all of the cloud is searched.
    config : OccupancyConfig, optional
    segmentation : SegmentationConfig, optional
        Definition of ground.
    own : callable, optional
        Tells which of (N, 2) positions are searched, those of a map's part; by default all.
    parts : int
        Number of parts that may be searched for one query: windows are as wide as if they were one.

    Notes
    -----
    The first query builds the grid of the map in 0.1 to 1 s: about 8 MB per kilometre of street. A
    map too wide for the grid has no candidates. Each storey of a building is searched separately.
    """

    def __init__(
        self,
        cloud: VoxelCloud,
        trajectory: Float64,
        config: OccupancyConfig,
        segmentation: SegmentationConfig,
        *,
        own: Callable[[Float64], Bools] = lambda positions: np.ones(len(positions), dtype=bool),
        parts: int = 1,
    ) -> None:
        self.config = config
        self._cloud = cloud
        self._own, self._parts = own, parts
        self._path = trajectory[:, :3, 3] - cloud.origin
        self._segmentation = segmentation
        self._maps: list[_OccupancyMap] | None = None

    name = "occupancy"

    def propose(self, query: Query, prior: Prior | None = None) -> list[Candidate]:
        """Propose poses by occupied and free cells, best first; none for sparse queries."""
        config = self.config
        view = query.view(config.cell, config.range_m, self._segmentation)
        return self.propose_in_view(view, prior)

    def propose_in_view(
        self, view: View, near: Prior | None = None, share: float = 1.0
    ) -> list[Candidate]:
        """Return the candidates of a view, with a share of the work."""
        self.prepare()
        origin = self._cloud.origin
        maps = self._maps or ()
        found = [pose for each in maps for pose in each.search(view, origin, near, share)]
        found.sort(key=lambda pose: -pose[4])
        poses = [(geometry.yaw_transform(yaw, (x, y, z)), fit) for x, y, z, yaw, fit in found]
        return within(near, [Candidate(T, 0, fit) for T, fit in poses])

    def prepare(self) -> None:
        """Build the grid of each storey, once; the bound of work is shared among storeys."""
        if self._maps is None:  # concurrent callers build it twice, harmlessly
            parts = list(storeys(self._cloud.points, self._path))
            work = max(MIN_WORK, self.config.work // len(parts))
            config = self.config.model_copy(update={"work": work})
            more = config, self._segmentation, self._owns, self._parts
            self._maps = [_OccupancyMap(cloud, path, *more) for cloud, path in parts]

    @property
    def windows(self) -> int:
        """Number of the widest windows that are searched; 0 before the grids are built."""
        return sum(each.windows for each in self._maps or ())

    @property
    def nbytes(self) -> int:
        """Size of the grids in memory."""
        return sum(each.nbytes for each in self._maps or ())

    def _owns(self, positions: Float64) -> Bools:
        """Return which of (N, 2) positions, relative to the origin, are searched."""
        return self._own(positions + self._cloud.origin[:2])


class _OccupancyMap:
    """Search structure of one storey of a map."""

    def __init__(
        self,
        cloud: Float32,
        path: Float64,
        config: OccupancyConfig,
        segmentation: SegmentationConfig,
        own: Callable[[Float64], Bools],
        parts: int,
    ) -> None:
        self._config, self._own, self._parts = config, own, parts
        self.windows = 0
        self._native: _native.PoseSearch | None = None
        with suppress(ValueError):  # wider than the kernels' tables
            self._prepare(cloud, path, segmentation)

    def _prepare(self, cloud: Float32, path: Float64, segmentation: SegmentationConfig) -> None:
        """Search as far from the path, by as narrow windows, as the bound of work permits."""
        config, near = self._config, path[:, :2]
        self._ground, below = ground_of(cloud, path, segmentation)
        heights = cloud[:, 2] - below
        above = heights > HEIGHTS_M[0]
        if not above.any():
            return
        points, slices = cloud[above], slices_of(heights[above])
        for levels, farther in EXTENTS:
            width, reach = config.cell * 2 ** (levels - 1), farther * config.reach_m
            roots = (
                _windows_along(near, width, reach) if len(path) else _windows_under(cloud, width)
            )
            roots = roots[_any_corner(self._own, roots, width)]
            self.windows = len(roots)
            if not self.windows:
                return
            if self.windows * self._parts * MIN_COLUMNS <= config.work:
                farthest = config.range_m + config.cell
                self._native = _native.PoseSearch(
                    points, slices, roots, config.cell, levels, farthest
                )
                return

    @property
    def nbytes(self) -> int:
        """Size of the grid in memory."""
        return 0 if self._native is None else self._native.nbytes

    def search(
        self, view: View, origin: Float64, near: Prior | None, share: float
    ) -> Iterator[tuple[float, float, float, float, float]]:
        """Yield x, y, z, yaw and fit of the best poses, found with a share of the work."""
        config, columns, slices = self._config, view.columns, view.slices
        if self._native is None or len(columns) < MIN_OCCUPIED:
            return
        most = min(config.columns, max(1, int(share * config.work) // self.windows))
        chosen = evenly(len(columns), most)
        columns, slices = columns[chosen], slices[chosen]
        free, clearance = view.free
        poses, scores = self._native.search(
            columns,
            slices,
            free,
            clearance,
            yaws=config.yaws,
            leaf_level=1,
            width=max(1, int(share * config.width)),
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
    """Return the search circle of a prior, relative to the origin."""
    if near is None or not near.has_position:
        return {}
    x, y = np.asarray(near.position)[:2] - origin[:2]
    return {"x": float(x), "y": float(y), "radius": near.radius_m}


def _windows_along(path: Float64, width: float, reach: float) -> NDArray[np.int32]:
    """Return the windows within reach of (V, 2) positions."""
    steps = int(np.ceil(reach / width))
    around = np.mgrid[-steps : steps + 1, -steps : steps + 1].reshape(2, -1).T
    stations = distinct(cells_of(path, width))
    windows = distinct((stations[:, None] + around).reshape(-1, 2))
    gap, _ = nearest_of(path, (windows + 0.5) * width)
    return _int32(windows[gap < reach + 0.71 * width])


def _windows_under(cloud: Float32, width: float) -> NDArray[np.int32]:
    """Return the windows that contain a point."""
    return _int32(distinct(cells_of(cloud[:, :2], width)))


def _any_corner(own: Callable[[Float64], Bools], windows: NDArray[np.int32], width: float) -> Bools:
    """Return which of (R, 2) windows have a corner at a position of one's own."""
    owned: Bools = np.any([own((windows + step) * width) for step in np.ndindex(2, 2)], axis=0)
    return owned


def _int32(cells: Int64) -> NDArray[np.int32]:
    return np.ascontiguousarray(cells, dtype=np.int32)


def storeys(cloud: Float32, path: Float64) -> Iterator[tuple[Float32, Float64]]:
    """Yield the cloud and the trajectory of each storey; unchanged if there is one storey.

    Parameters
    ----------
    cloud : (N, 3) float32
    path : (V, 3) float64
        Positions of the mapping sensor, in the same frame.
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
    """Return the height of a trajectory above its floor: the first flat surface below it [m]."""
    gap, station = nearest_of(path[:, :2], cloud[:, :2])
    drop = (path[station, 2] - cloud[:, 2])[gap < _DROP_RADIUS_M]
    counts, edges = _drops(drop)
    return float(edges[np.argmax(counts >= 0.5 * counts.max()) + 1])


def _drops(drop: NDArray[Any]) -> tuple[Int64, Float64]:
    """Return the histogram of heights above the floor: counts, and edges [m]."""
    return np.histogram(drop, bins=_DROP_BINS, range=(0.0, _DROP_STEP_M * _DROP_BINS))


def is_storeyed(path: Float64) -> bool:
    """Return whether a trajectory passes many places on two storeys, unlike at a single bridge.

    Parameters
    ----------
    path : (V, 3) float64
    """
    if not len(path) or np.ptp(path[:, 2]) < _MIN_STOREY_HEIGHT_M:
        return False
    keys = keys_of(cells_of(path[:, :2], _STOREY_CELL_M))
    _, which = np.unique(keys, return_inverse=True)
    low, high = np.full(which.max() + 1, np.inf), np.full(which.max() + 1, -np.inf)
    np.minimum.at(low, which, path[:, 2])
    np.maximum.at(high, which, path[:, 2])
    return bool((high - low > _MIN_STOREY_HEIGHT_M).mean() >= _MIN_STOREYED_SHARE)


def _levels(heights: NDArray[np.float64]) -> Float64:
    """Return the heights with large shares of the trajectory, ascending."""
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


def ground_of(
    cloud: Float32, path: Float64, segmentation: SegmentationConfig
) -> tuple[Ground, Float32]:
    """Return the ground of a map, and its height below each point of the (N, 3) cloud [m].

    Returns from below the floor (mirrors, stairs) lower the estimate; without floor in view it is
    too high. It is therefore used only if it is close enough to the floor below the mapping sensor,
    for its distance from the trajectory. Elsewhere that floor replaces it.
    """
    ground = cloud[:, 2] - heights_above_ground(cloud, segmentation)
    cells = cells_of(cloud[:, :2], _GROUND_CELL_M)
    _, first, which = np.unique(keys_of(cells), return_index=True, return_inverse=True)
    where = (cells[first].astype(np.float64) + 0.5) * _GROUND_CELL_M
    if len(path) and len(cloud):
        distance, station = nearest_of(path[:, :2], where)
        near = distance[which] < _FLOOR_RADIUS_M + _GROUND_CELL_M
        floor = path[station, 2] - _sensor_height(cloud[near], path)
        ground = plausible_ground(ground, floor[which], distance[which])
    sums = np.bincount(which, weights=ground, minlength=len(first))
    counts = np.maximum(np.bincount(which, minlength=len(first)), 1)
    return Ground(where, sums / counts), ground.astype(np.float32)


class Ground:
    """Height of the ground of a map at any position, by (N, 2) places and their heights [m]."""

    def __init__(self, places: Float64, heights: Float64) -> None:
        self._tree, self._heights = cKDTree(places), heights

    def below(self, places: Float64) -> Float64:
        """Return the height of the ground at (N, 2) positions [m]."""
        count = min(_GROUND_NEIGHBOURS, len(self._heights))
        nearest = np.asarray(self._tree.query(places, k=count)[1]).reshape(len(places), -1)
        heights: Float64 = np.median(self._heights[nearest], axis=1)
        return heights


def _sensor_height(cloud: Float32, path: Float64) -> float:
    """Return the height of the mapping sensor above the floor: where most columns end [m]."""
    gap, station = nearest_of(path[:, :2], cloud[:, :2], within=_FLOOR_RADIUS_M)
    rising = np.argsort(cloud[:, 2], kind="stable")
    rising = rising[gap[rising] < _FLOOR_RADIUS_M]
    columns = cells_of(cloud[rising, :2], _FLOOR_COLUMN_M)
    lowest = rising[np.unique(keys_of(columns), return_index=True)[1]]
    drop = path[station[lowest], 2] - cloud[lowest, 2]
    counts, edges = _drops(drop)
    return float(edges[counts.argmax()] + _DROP_STEP_M / 2)


def nearest_of(
    targets: NDArray[Any], positions: NDArray[Any], within: float = np.inf
) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return the distance to the nearest of (N, 2) targets, and its row; beyond: infinity and N."""
    distance, index = cKDTree(targets).query(positions, distance_upper_bound=within)
    return np.asarray(distance), np.asarray(index)
