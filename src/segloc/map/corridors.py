"""Where a sensor can have been in a cloud without ground: in the space between its surfaces.

Seen from above, a corridor is a strip of cells without points up to the height of a sensor, between
walls, hedges, trees or cars. Its middle is the local maximum of the distance to them. Viewpoints
are chosen there, each time the one with most surfaces around it that no other one sees from near.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt, maximum_filter

from ..types import Bools, Float32, Float64, Int64

NEAR_M = 15.0
"""Every surface is seen from within this distance, if there is room for a viewpoint."""
_CELL_M, _MAX_CELLS = 0.5, 30_000_000
_BASE_CELL_M, _BASE_PERCENT = 4.0, 10.0  # of the lowest points around a place
_HEADROOM_M, _BELOW_M = 0.6, 0.5
_MIN_POINTS = 3  # of an occupied cell; fewer are noise
_MIN_CLEARANCE_M = 1.0
_MIDDLE_CELLS = 5  # side of the window in which the middle of a corridor is roomiest
_DIRECTIONS = 64
_PATCH_CELLS = 3  # side of what is seen as one surface
_MIN_NEW = 8
"""Fewest surfaces that a further viewpoint adds."""


@dataclass(frozen=True)
class _Grid:
    """Cells of a cloud seen from above.

    Attributes
    ----------
    low : (2,) float64
        Corner of the grid [m].
    edge_m : float
    occupied : (X, Y) bool
        Whether something is there up to the height of a sensor.
    base : (X', Y') float64
        Lowest surfaces around each wider cell [m].
    """

    low: Float64
    edge_m: float
    occupied: Bools
    base: Float64

    @classmethod
    def of(cls, columns: Sequence[Float32], sensor_height_m: float) -> _Grid:
        """Return the cells of parts (N, 3) of a cloud."""
        corners = np.array([(c[:, :2].min(axis=0), c[:, :2].max(axis=0)) for c in columns])
        low = corners[:, 0].min(axis=0).astype(np.float64)
        extent = corners[:, 1].max(axis=0) - low
        edge = max(_CELL_M, math.sqrt(float(np.prod(extent + NEAR_M)) / _MAX_CELLS))
        base = _base(columns, low, extent)
        shape = tuple((extent / edge).astype(int) + 1)
        counts = np.zeros(shape, np.int32)
        for points in columns:
            wide = base[tuple(_cells(points, low, _BASE_CELL_M).T)]
            above = points[:, 2] - wide
            band = (above > -_BELOW_M) & (above < sensor_height_m + _HEADROOM_M)
            np.add.at(counts, tuple(_cells(points[band], low, edge).T), 1)
        return cls(low, edge, counts >= _MIN_POINTS, base)

    def middles(self) -> Int64:
        """Return the cells (M, 2) in the middle of corridors."""
        clearance = distance_transform_edt(~self.occupied) * self.edge_m
        middle = clearance == maximum_filter(clearance, _MIDDLE_CELLS)
        middle &= (clearance >= _MIN_CLEARANCE_M) & (clearance < NEAR_M)
        return np.argwhere(middle)

    def visible_patches(self, cells: Int64) -> Int64:
        """Return the patches that are seen in each direction from cells, (M, D); -1 of none."""
        angles = np.arange(_DIRECTIONS) * (2 * math.pi / _DIRECTIONS)
        seen = np.full((len(cells), _DIRECTIONS), -1, np.int64)
        shape, columns = np.array(self.occupied.shape), -(-self.occupied.shape[1] // _PATCH_CELLS)
        for k, angle in enumerate(angles):
            step, left = np.array([math.cos(angle), math.sin(angle)]), np.arange(len(cells))
            for far in range(1, int(NEAR_M / self.edge_m) + 1):
                at = cells[left] + np.rint(far * step).astype(np.int64)
                inside = ((at >= 0) & (at < shape)).all(axis=1)
                left, at = left[inside], at[inside]
                hit = self.occupied[tuple(at.T)]
                patch = at[hit] // _PATCH_CELLS
                seen[left[hit], k] = patch[:, 0] * columns + patch[:, 1]
                left = left[~hit]
        return seen

    def places(self, cells: Int64) -> Float64:
        """Return the middle of cells, on the lowest surfaces around, (M, 3)."""
        xy = (cells + 0.5) * self.edge_m
        wide = np.minimum((xy / _BASE_CELL_M).astype(int), np.array(self.base.shape) - 1)
        return np.column_stack([xy + self.low, self.base[tuple(wide.T)]])


def between_surfaces(columns: Sequence[Float32], sensor_height_m: float) -> Float64:
    """Choose viewpoints between the surfaces of a cloud without ground.

    Parameters
    ----------
    columns : sequence of (N, 3) float32
        Parts of the cloud; z is up.
    sensor_height_m : float
        Height of the viewpoints over the lowest surfaces around them.

    Returns
    -------
    (V, 3) float64
        The one from which most is seen first; none if there is no room between surfaces.
    """
    grid = _Grid.of(columns, sensor_height_m)
    cells = grid.middles()
    chosen = _covering(grid.visible_patches(cells))
    return grid.places(cells[chosen]) + [0.0, 0.0, sensor_height_m]


def _covering(seen: Int64) -> list[int]:
    """Choose rows that together see all that any sees, (M, D), most new patches first."""
    covered: set[int] = set()
    patches = [set(row[row >= 0].tolist()) for row in seen]
    left = [(-len(each), k) for k, each in enumerate(patches)]
    heapq.heapify(left)
    chosen: list[int] = []
    while left:
        _, k = heapq.heappop(left)
        new = patches[k] - covered
        if len(new) < _MIN_NEW:
            continue
        if left and len(new) < -left[0][0]:  # others may see more by now
            heapq.heappush(left, (-len(new), k))
            continue
        covered |= new
        chosen.append(k)
    return chosen


def _base(columns: Sequence[Float32], low: Float64, extent: NDArray[np.floating]) -> Float64:
    """Return the height of the lowest surfaces around each wider cell, (X, Y)."""
    shape = tuple((extent / _BASE_CELL_M).astype(int) + 1)
    cells, lows = [], []
    for points in columns:
        fine = np.floor((points[:, :2] - low) / _CELL_M).astype(np.int64)
        order = np.lexsort((points[:, 2], fine[:, 0], fine[:, 1]))
        first = (np.diff(fine[order], axis=0, prepend=fine[order[:1]] - 1) != 0).any(axis=1)
        lowest = points[order[first]]
        cells.append(_cells(lowest, low, _BASE_CELL_M))
        lows.append(lowest[:, 2].astype(np.float64))
    key = np.concatenate(cells)
    at = key[:, 0] * shape[1] + key[:, 1]
    order = np.argsort(at, kind="stable")
    ends = np.searchsorted(at[order], np.arange(shape[0] * shape[1] + 1))
    z = np.concatenate(lows)[order]
    base = np.full(shape, np.nan)
    for i, j in np.unique(key, axis=0):
        rows = range(max(i - 1, 0), min(i + 2, shape[0]))
        span = max(j - 1, 0), min(j + 2, shape[1])
        around = [z[ends[r * shape[1] + span[0]] : ends[r * shape[1] + span[1]]] for r in rows]
        base[i, j] = np.percentile(np.concatenate(around), _BASE_PERCENT)
    nearest = distance_transform_edt(np.isnan(base), return_distances=False, return_indices=True)
    filled: Float64 = base[tuple(nearest)]
    return filled


def _cells(points: Float32, low: Float64, edge_m: float) -> Int64:
    """Return the square cell of each of (N, 3) points, (N, 2)."""
    cells: Int64 = ((points[:, :2] - low) / edge_m).astype(np.int64)
    return cells
