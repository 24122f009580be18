"""The ground of a map and of a query, where some of what lies lowest is no ground."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from ...frontend.segmentation import SegmentationConfig, heights_above_ground
from ...types import Float32, Float64, Int64

_GROUND_M = 4.0  # edge of the cells in which the map's ground is kept
_NEAREST_GROUND = 4
_FLOOR_M, _FLOOR_SLOPE = 0.5, 0.15  # by which the ground may differ from that below the path
_FLOOR_RADIUS_M, _FLOOR_BINS = 5.0, 40  # where the floor is looked for: so near, so many decimetres
_FLOOR_COLUMN_M = 0.5


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
        cells = cells_of(cloud[:, :2], _GROUND_M)
        _, first, which = np.unique(keys_of(cells), return_index=True, return_inverse=True)
        where = (cells[first] + 0.5) * _GROUND_M
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
        count = min(_NEAREST_GROUND, len(self._heights))
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
    near = np.abs(ground - floor) < _FLOOR_M + _FLOOR_SLOPE * distance
    return np.where(near, ground, floor)


def nearest_of(
    places: NDArray[Any], asked: NDArray[Any], count: int = 1, within: float = np.inf
) -> tuple[NDArray[Any], NDArray[Any]]:
    """Distances to the nearest of (N, 2) places, and which they are; infinite, and N, beyond."""
    distance, index = cKDTree(places).query(asked, k=count, distance_upper_bound=within)
    return np.asarray(distance), np.asarray(index)


def keys_of(cells: Int64) -> Int64:
    """One number for each of (N, 2) cells, in the order of x and y."""
    keys: Int64 = cells[:, 0] * (1 << 32) + cells[:, 1]
    return keys


def cells_of(points: NDArray[np.floating[Any]], width: float) -> Int64:
    """The square cells of (N, 2) points, (N, 2)."""
    cells: Int64 = np.floor(points / width).astype(np.int64)
    return cells
