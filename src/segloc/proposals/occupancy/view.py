"""What a query shows, seen from above: where things stand, how high, and where nothing does."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_cdt

from ... import _native
from ...frontend.segmentation import Segmentation, SegmentationConfig, heights_above_ground
from ...types import Float32, Int64
from .config import OccupancyConfig
from .ground import believed, cells_of, keys_of

HEIGHTS_M = (0.4, 0.8, 1.3, 1.9, 2.6, 3.5, 5.0, 8.0)
"""Where each slice begins, over ground; the last one has no end. Set by hand."""
FREE_M, MOST_FREE = 30.0, 256
"""Where a query sees the ground, so near, nothing stands; so many such places are looked at."""
_NEAREST_TO_SENSOR = 16

Bytes = NDArray[np.uint8]


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
    near = ground[np.hypot(ground[:, 0], ground[:, 1]) < min(FREE_M, within), :2]
    cells = np.unique(cells_of(near, config.cell), axis=0)
    if not len(cells):
        return cells, np.empty(0, np.uint8)
    reach = int(np.ceil(within / config.cell)) + 1
    empty = np.ones((2 * reach + 1, 2 * reach + 1), bool)
    empty[tuple((standing + reach).T)] = False
    clearance = distance_transform_cdt(empty)[tuple((cells + reach).T)] - 1
    free = clearance > 0
    cells, clearance = cells[free], clearance[free]
    clearest = np.argsort(-clearance, kind="stable")
    chosen = clearest[evenly(len(cells), MOST_FREE)]
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
