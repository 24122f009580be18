"""What stands around the sensor of a query, and where only ground is: cells seen from above."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_cdt

from .. import _native
from ..frontend.segmentation import Segmentation, SegmentationConfig, heights_above_ground
from ..geometry import cells_of, distinct, keys_of
from ..system.once import once
from ..types import Float32, Int64

HEIGHTS_M = (0.4, 0.8, 1.3, 1.9, 2.6, 3.5, 5.0, 8.0)
"""Lower edge of each slice above ground; the last slice is open. Set by hand."""
FREE_RADIUS_M, MAX_FREE = 30.0, 256
"""Radius of a query's free cells, and their largest number."""
_NEAREST_TO_SENSOR = 16  # ground points
_MAX_FLOOR_GAP_M, _MAX_FLOOR_SLOPE = 0.5, 0.15  # from the floor below the sensor

_HERE = np.eye(4)

Bytes = NDArray[np.uint8]


class View:
    """Occupancy of a query around its sensor.

    Parameters
    ----------
    scene : Segmentation
    cell_m : float
        Edge of a cell [m].
    range_m : float
        Range of the cells [m].
    segmentation : SegmentationConfig
        Definition of ground.

    Attributes
    ----------
    columns : (M, 2) float32
        Centres of occupied cells [m].
    slices : (M,) uint8
        Occupied height slices of each, as bits.
    below : float
        Height of the ground below the sensor [m].
    """

    def __init__(
        self,
        scene: Segmentation,
        cell_m: float,
        range_m: float,
        segmentation: SegmentationConfig,
    ) -> None:
        self._cell_m, self._within_m, self._ground = cell_m, range_m - cell_m, scene.ground
        surface = _native.voxel_grid(_native.moved_crop(scene.surface, _HERE, range_m), cell_m)
        distance = np.hypot(surface[:, 0], surface[:, 1])
        around = np.argsort(np.hypot(scene.ground[:, 0], scene.ground[:, 1]), kind="stable")
        floor = scene.ground[around[:_NEAREST_TO_SENSOR], 2]
        self.below = float(np.median(floor)) if len(floor) else 0.0
        ground = surface[:, 2] - heights_above_ground(surface, segmentation)
        if len(floor):
            ground = plausible_ground(ground, np.full(len(surface), self.below), distance)
        heights = surface[:, 2] - ground
        above = (heights > HEIGHTS_M[0]) & (distance < self._within_m)
        cells = cells_of(surface[above, :2], cell_m)
        _, first, which = np.unique(keys_of(cells), return_index=True, return_inverse=True)
        self._occupied, self.slices = cells[first], np.zeros(len(first), np.uint8)
        np.bitwise_or.at(self.slices, which, slices_of(heights[above]))
        self.columns = self._centres(self._occupied)

    @once
    def free(self) -> tuple[Float32, Bytes]:
        """Centres (F, 2) of cells with ground alone, the clearest first [m], and the number of
        cells around each without an occupied one, (F,)."""
        cells, clearance = free_cells(self._ground, self._occupied, self._cell_m, self._within_m)
        return self._centres(cells), clearance

    def _centres(self, cells: Int64) -> Float32:
        centres: Float32 = ((cells + 0.5) * self._cell_m).astype(np.float32)
        return centres


def free_cells(
    ground: Float32, occupied: Int64, cell_m: float, within_m: float
) -> tuple[Int64, Bytes]:
    """Return the cells of ground that are not occupied, nor beside occupied ones, clearest first.

    Parameters
    ----------
    ground : (N, 3) float32
    occupied : (M, 2) int64
        Occupied cells.
    cell_m, within_m : float
        Edge of a cell, and the largest distance of an occupied one [m].

    Returns
    -------
    (F, 2) int64
    (F,) uint8
        Number of cells around each without an occupied one.
    """
    near = ground[np.hypot(ground[:, 0], ground[:, 1]) < min(FREE_RADIUS_M, within_m), :2]
    cells = distinct(cells_of(near, cell_m))
    reach = int(np.ceil(within_m / cell_m)) + 1
    empty = np.ones((2 * reach + 1, 2 * reach + 1), bool)
    empty[tuple((occupied + reach).T)] = False
    clearance = distance_transform_cdt(empty)[tuple((cells + reach).T)] - 1
    free = clearance > 0
    cells, clearance = cells[free], clearance[free]
    clearest = np.argsort(-clearance, kind="stable")
    chosen = clearest[evenly(len(cells), MAX_FREE)]
    return cells[chosen], np.minimum(clearance[chosen], 255).astype(np.uint8)


def evenly(count: int, most: int) -> Int64:
    """Return at most ``most`` of ``count`` rows, evenly spread, (min(count, most),)."""
    kept = min(count, most)
    chosen: Int64 = np.arange(kept) * count // max(kept, 1)
    return chosen


def slices_of(heights: Float32) -> Bytes:
    """Return the slice of each point as a bit, (N,) uint8."""
    slices: Bytes = (1 << (np.searchsorted(HEIGHTS_M, heights) - 1)).astype(np.uint8)
    return slices


def plausible_ground(
    ground: NDArray[Any], floor: NDArray[Any], distance: NDArray[Any]
) -> NDArray[np.floating[Any]]:
    """Return the ground where it is near the floor, and the floor elsewhere."""
    near = np.abs(ground - floor) < _MAX_FLOOR_GAP_M + _MAX_FLOOR_SLOPE * distance
    return np.where(near, ground, floor)
