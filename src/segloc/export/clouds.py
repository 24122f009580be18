"""A map's cloud as PCD, PLY or LAZ, whole or in Autoware's tiles."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from ..errors import SeglocError
from ..io.las import format_laz
from ..io.pcd import format_pcd
from ..io.ply import format_ply
from ..map.segment_map import SegmentMap
from ..system.files import replacing, write_text
from ..types import Float32, Float64

FLOAT32_M = 16_384.0
"""Farther from the origin, float32 coordinates are in steps of more than a millimetre."""
AUTOWARE_FOLDER, AUTOWARE_METADATA = "pointcloud_map.pcd", "pointcloud_map_metadata.yaml"


def write_pcd(prior_map: SegmentMap, out: Path) -> list[str]:
    """Binary PCD, x y z as float32."""
    return _written(prior_map, out, format_pcd)


def write_ply(prior_map: SegmentMap, out: Path) -> list[str]:
    """Binary PLY, x y z as float."""
    return _written(prior_map, out, format_ply)


def write_laz(prior_map: SegmentMap, out: Path) -> list[str]:
    """LAZ in steps of a millimetre, wherever the map lies."""
    data = format_laz(_points(prior_map), offset=np.round(prior_map.origin))
    with replacing(out) as stream:
        stream.write(data)
    return []


def write_autoware(prior_map: SegmentMap, out: Path, tile_m: float) -> list[str]:
    """A folder as Autoware's map loader takes it: square tiles along x and y, and their list.

    Each tile is named by its lower corner, which is a multiple of ``tile_m``.
    """
    points, notes = _near_origin(prior_map)
    folder = out / AUTOWARE_FOLDER
    folder.mkdir(parents=True, exist_ok=True)
    if leftover := next(folder.iterdir(), None):
        raise SeglocError(f"{folder}: holds {leftover.name} already: name a new folder")
    corners = np.floor(points[:, :2].astype(np.float64) / tile_m).astype(np.int64)
    order = np.lexsort((corners[:, 0], corners[:, 1]))
    starts = np.flatnonzero(np.diff(corners[order], axis=0, prepend=np.nan).any(axis=1))
    lines = [f"x_resolution: {tile_m:g}\n", f"y_resolution: {tile_m:g}\n"]
    for rows in np.split(order, starts[1:]):
        x, y = (float(v) * tile_m for v in corners[rows[0]])
        name = f"{x:g}_{y:g}.pcd"
        with replacing(folder / name, sweep=False) as stream:
            stream.write(format_pcd(points[rows]))
        lines.append(f"{name}: [{x:g}, {y:g}]\n")
    write_text(out / AUTOWARE_METADATA, "".join(lines))
    return notes


def _written(prior_map: SegmentMap, out: Path, form: Callable[[Float32], bytes]) -> list[str]:
    points, notes = _near_origin(prior_map)
    with replacing(out) as stream:
        stream.write(form(points))
    return notes


def _points(prior_map: SegmentMap) -> Float64:
    if not len(prior_map.cloud):
        raise SeglocError("the map has no cloud: there is nothing to write")
    return prior_map.cloud.astype(np.float64) + prior_map.origin


def _near_origin(prior_map: SegmentMap) -> tuple[Float32, list[str]]:
    """The points as float32, less the map's origin where they lie too far off for that."""
    points = _points(prior_map)
    if np.abs(points).max() <= FLOAT32_M:
        return points.astype(np.float32), []
    origin = np.round(prior_map.origin)
    x, y, z = (f"{value:.0f}" for value in origin)
    said = f"coordinates are less ({x}, {y}, {z}): as they are, float32 would not tell them apart"
    return (points - origin).astype(np.float32), [said]
