"""Occupancy grids for Nav2: ``map.pgm`` and ``map.yaml`` of a map's cloud, one pair per storey.

As in nav2_map_server, the first row of the image has the highest y, the origin is the lower left
corner, and values from 0 to 255 mean occupied, unknown or free by thresholds.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation

from ...errors import ConfigError, SeglocError
from ...frontend.segmentation import SegmentationConfig
from ...geometry import cells_of
from ...map.segment_map import SegmentMap
from ...proposals.occupancy import ground_of, storeys
from ...system.files import make_folder, write_bytes, write_text
from ...types import Float32, Float64

FREE, UNKNOWN, OCCUPIED = 254, 205, 0
"""Grey values of nav2_map_saver."""
_MAX_CELLS = 200_000_000
_GROUND_REACH_M = 0.5  # the map keeps one point of ground per metre
_MAX_GROUND_M = 0.1  # height of ground points above the ground itself
_MAX_STEP_M = 5.0  # between poses of one drive
_MAX_WIDTH_M = 10.0
Grid = NDArray[np.uint8]


@dataclass(frozen=True)
class GridOptions:
    """Parameters of a grid."""

    resolution_m: float = 0.05  # edge of a cell
    low_m: float = 0.4  # height range of obstacles above ground
    high_m: float = 1.8
    robot_width_m: float = 0.6  # width of the free lane along the trajectory; 0: none

    def __post_init__(self) -> None:
        if not 0.0 <= self.robot_width_m <= _MAX_WIDTH_M:
            raise ConfigError(
                f"the robot's width must be 0 to {_MAX_WIDTH_M:g} m, not {self.robot_width_m:g}"
            )
        if not (0.01 <= self.resolution_m <= 5.0 and 0.0 < self.low_m < self.high_m):
            raise ConfigError(
                "a grid needs cells of 0.01 to 5 m and heights LOW below HIGH, not "
                f"{self.resolution_m:g} m and {self.low_m:g} to {self.high_m:g} m"
            )


def write_nav2(prior_map: SegmentMap, out: Path, options: GridOptions) -> list[str]:
    """Write ``map.pgm`` and ``map.yaml``; ``map_0``, ``map_1``, ... for several storeys."""
    if not len(prior_map.cloud):
        raise SeglocError("nothing to export: the map has no cloud")
    path = prior_map.trajectory[:, :3, 3] - prior_map.origin
    parts = list(storeys(prior_map.cloud, path))
    drives = _by_storey(_drives(prior_map, options.robot_width_m), [each for _, each in parts])
    notes = []
    make_folder(out)
    for k, (cloud, stations) in enumerate(parts):
        name = "map" if len(parts) == 1 else f"map_{k}"
        grid, corner = _occupancy_grid(cloud, stations, prior_map.cloud_voxel, options)
        _clear(grid, drives[k][..., :2] - corner, options)
        _write(out, name, grid, corner + prior_map.origin[:2], options)
        if len(parts) > 1 and len(stations):
            z = float(np.median(stations[:, 2]) + prior_map.origin[2])
            notes.append(f"{name}: storey with viewpoints at z = {z:.1f} m")
    return notes


def _occupancy_grid(
    cloud: Float32, path: Float64, voxel: float, options: GridOptions
) -> tuple[Grid, Float64]:
    """Return the grid of a cloud, rows rising with y, and its lower left corner.

    Visible ground is free; points above it within the height range are occupied.

    path: (V, 3) viewpoints of the map, in the cloud's frame
    voxel: spacing of the cloud's points [m]
    """
    edge = options.resolution_m
    heights = cloud[:, 2] - ground_of(cloud, path, SegmentationConfig())[1]
    cells = cells_of(cloud[:, :2].astype(np.float64), edge)
    lowest = cells.min(axis=0)
    corner = lowest * edge
    cells -= lowest
    shape = cells[:, 1].max() + 1, cells[:, 0].max() + 1
    if shape[0] * shape[1] > _MAX_CELLS:
        raise ConfigError(
            f"a grid of {shape[1]} x {shape[0]} cells is too large: increase --resolution"
        )
    obstacle = (heights >= options.low_m) & (heights <= options.high_m)
    floor = heights < min(options.low_m, _MAX_GROUND_M + voxel)
    free = _mark(cells[floor], shape, _GROUND_REACH_M / edge)
    occupied = _mark(cells[obstacle], shape, 0.5 * voxel / edge)
    grid = np.full(shape, UNKNOWN, np.uint8)
    grid[free] = FREE
    grid[occupied] = OCCUPIED
    return grid, corner


def _drives(prior_map: SegmentMap, width_m: float) -> Float64:
    """Return the lines that the sensor drove along, relative to the map's origin, (L, 2, 3).

    Each pose is a line of no length. Consecutive poses are connected if they are near and turned so
    little that an arc between them stays within half the width of the straight line.
    """
    poses, driven = prior_map.trajectory, prior_map.is_driven
    at = poses[:, :3, 3] - prior_map.origin
    steps = np.linalg.norm(np.diff(at, axis=0), axis=1)
    trace = np.einsum("nij,nij->n", poses[:-1, :3, :3], poses[1:, :3, :3])
    turns = np.arccos(np.clip((trace - 1.0) / 2.0, -1.0, 1.0))
    near = (steps <= _MAX_STEP_M) & (steps * turns / 8.0 <= width_m / 2.0)
    near &= driven[:-1] & driven[1:]
    lines = np.stack([at[:-1][near], at[1:][near]], axis=1)
    return np.concatenate([np.stack([at[driven], at[driven]], axis=1), lines])


def _by_storey(lines: Float64, stations: list[Float64]) -> list[Float64]:
    """Divide lines by the storey whose trajectory is at their height."""
    if len(stations) == 1:
        return [lines]
    levels = np.array([np.median(each[:, 2]) for each in stations])
    nearest = np.abs(lines[:, :, 2].mean(axis=1)[:, None] - levels).argmin(axis=1)
    return [lines[nearest == k] for k in range(len(stations))]


def _clear(grid: Grid, lines: Float64, options: GridOptions) -> None:
    """Mark as free the cells that a robot of the given width drove over along lines (L, 2, 2)."""
    if not options.robot_width_m:
        return
    edge = options.resolution_m
    reach = options.robot_width_m / 2.0 + edge / 2.0  # cells that are touched
    for begin, end in lines:
        low = np.maximum(np.floor((np.minimum(begin, end) - reach) / edge).astype(np.int64), 0)
        high = np.ceil((np.maximum(begin, end) + reach) / edge).astype(np.int64)
        window = grid[low[1] : max(high[1], 0), low[0] : max(high[0], 0)]
        rows, columns = np.indices(window.shape)
        cells = (np.stack([columns, rows], axis=-1) + low + 0.5) * edge - begin
        along = end - begin
        share = np.clip(cells @ along / max(float(along @ along), 1e-12), 0.0, 1.0)
        off = cells - share[..., None] * along
        window[np.einsum("ijk,ijk->ij", off, off) <= reach**2] = FREE


def _mark(cells: NDArray[np.int64], shape: tuple[int, int], reach: float) -> NDArray[np.bool_]:
    """Mark cells, and those within reach of them."""
    marked = np.zeros(shape, bool)
    marked[cells[:, 1], cells[:, 0]] = True
    for _ in range(round(reach)):
        marked = binary_dilation(marked, np.ones((3, 3), bool))
    return marked


def _write(out: Path, name: str, grid: Grid, corner: Float64, options: GridOptions) -> None:
    height, width = grid.shape
    head = f"P5\n{width} {height}\n255\n".encode("ascii")
    write_bytes(out / f"{name}.pgm", head + grid[::-1].tobytes())
    text = (  # unknown is 205: 1 - 205 / 255 is not below 0.196
        f"image: {name}.pgm\nmode: trinary\nresolution: {options.resolution_m:g}\n"
        f"origin: [{corner[0]:.4f}, {corner[1]:.4f}, 0.0]\n"
        "negate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n"
    )
    write_text(out / f"{name}.yaml", text)
