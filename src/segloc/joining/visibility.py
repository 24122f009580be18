"""Find map points in the free space of a later session, and those it saw again.

A point violates free space if the sensor measured something well behind it, in the point's
direction and in all directions about it. G. Kim, A. Kim, "Remove, then Revert: Static Point Cloud
Map Construction using Multiresolution Range Images", IROS 2020, compares range images in the same
way.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from scipy.ndimage import minimum_filter
from scipy.spatial import cKDTree

from .. import geometry
from ..errors import DatasetError
from ..map.voxel_cloud import VoxelCloud
from ..system.section import Section
from ..types import Float32, Float64, Int64, Pose, Recording


class VisibilityConfig(Section):
    """Criteria of free-space violations."""

    every_m: float = Field(1.0, gt=0, description="travel between the scans used, metres")
    range_m: float = Field(30.0, gt=0, description="maximum range of the rays used, metres")
    bin_deg: float = Field(1.0, gt=0, le=10, description="width of a pixel of the range images")
    margin_m: float = Field(0.7, gt=0, description="minimum distance behind a point, metres")
    near_m: float = Field(0.4, gt=0, description="maximum distance of a point seen again, metres")
    min_passes: int = Field(3, ge=1, description="scans that must look through a point")


@dataclass(frozen=True)
class Visibility:
    """Visibility of N points in a session.

    Attributes
    ----------
    gone : (N,) bool
        Looked through in several scans, and not seen again.
    seen : (N,) bool
        Seen again. Points that are neither were not in view.
    """

    gone: NDArray[np.bool_]
    seen: NDArray[np.bool_]


def visibility(
    points: Float32,
    origin: Float64,
    recording: Recording,
    config: VisibilityConfig | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Visibility:
    """Classify the points of a map by a later session.

    Parameters
    ----------
    points : (N, 3) float32
        Relative to ``origin``.
    origin : (3,) float64
        In the map frame.
    recording : Recording
        With poses T_map_sensor.

    Raises
    ------
    DatasetError
        If there are no poses, or a scan cannot be read.
    """
    config = config or VisibilityConfig()
    poses = recording.poses
    if poses is None or not len(poses):
        raise DatasetError(
            f"{recording.name}: every scan needs a pose in the map frame: see segloc.align_to_map"
        )
    travelled = geometry.distance_travelled(poses)
    chosen = geometry.stations(travelled, config.every_m)
    passes = np.zeros(len(points), np.int32)
    cloud = VoxelCloud(np.empty((0, 3), np.float32), origin, config.near_m / 2)
    for done, i in enumerate(map(int, chosen)):
        scan = recording.scan(i).points
        scan = scan[(scan**2).sum(axis=1) < (2 * config.range_m) ** 2]
        T = geometry.rigid(poses[i, :3, :3], poses[i, :3, 3] - origin)
        rows = _free_space_violations(points, T, scan, config)
        passes[rows] += 1
        cloud.add_relative(geometry.transform(T, scan).astype(np.float32))
        if progress:
            progress(done + 1, len(chosen))
    seen = _near(points, cloud.points, config.near_m)
    return Visibility((passes >= config.min_passes) & ~seen, seen)


def _near(points: Float32, others: Float32, radius: float) -> NDArray[np.bool_]:
    if not len(points) or not len(others):
        return np.zeros(len(points), dtype=bool)
    distances, _ = cKDTree(others).query(points, distance_upper_bound=radius)
    return np.isfinite(distances)


def _free_space_violations(
    points: Float32, T_map_sensor: Pose, scan: Float32, config: VisibilityConfig
) -> Int64:
    """Return the rows of points that violate free space in one scan."""
    offsets = points - T_map_sensor[:3, 3].astype(np.float32)
    near = np.flatnonzero((offsets**2).sum(axis=1) < config.range_m**2)
    local = (offsets[near].astype(np.float64)) @ T_map_sensor[:3, :3]
    pixels, ranges = _pixels(local, config.bin_deg)
    measured, nearest = _range_images(scan, config.bin_deg)
    through = np.isfinite(measured[pixels]) & (nearest[pixels] > ranges + config.margin_m)
    return near[through]


def _range_images(scan: Float32, bin_deg: float) -> tuple[Float64, Float64]:
    """Return the minimum range in each pixel, infinite if empty, and in its neighbourhood."""
    shape = round(360 / bin_deg), round(180 / bin_deg) + 1
    measured = np.full(shape, np.inf)
    pixels, ranges = _pixels(scan.astype(np.float64), bin_deg)
    np.minimum.at(measured, pixels, ranges)
    return measured, minimum_filter(measured, 3, mode=("wrap", "nearest"))


def _pixels(points: Float64, bin_deg: float) -> tuple[tuple[Int64, Int64], Float64]:
    """Return column and row of each point in a range image, and its range."""
    x, y, z = points.T
    ranges = np.sqrt(x * x + y * y + z * z)
    azimuth = np.degrees(np.arctan2(y, x)) + 180.0
    elevation = np.degrees(np.arctan2(z, np.hypot(x, y))) + 90.0
    columns = (azimuth / bin_deg).astype(np.int64) % round(360 / bin_deg)
    return (columns, (elevation / bin_deg).astype(np.int64)), ranges
