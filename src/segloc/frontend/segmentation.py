"""Local cloud -> segments: voxel grid, ground removal, exact Euclidean clusters."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Annotated

import numpy as np
from pydantic import Field

from .. import _native, geometry
from ..system.section import Section
from ..types import Float32, LocalCloud, Segments

MAX_TOLERANCE_M = 50.0
"""Largest gap between points of a segment, however far apart those of a scan are."""
MIN_TOLERANCE_TO_SPACING = 1.25
"""Tolerance over point spacing from which nearly all points of an object link."""
TOLERANCE_TO_SPACING = 1.7
"""Tolerance over point spacing in sparser clouds."""
MIN_POINTS = 8
"""Points of the smallest segment of a sparse cloud: fewer have no shape."""
SPACING_SAMPLE = 128
"""Points of which the spacing is measured."""

HeightAboveGround = Annotated[float, Field(ge=-100, le=100)]


class ClusterConfig(Section):
    """Parameters that depend on the density of the cloud.

    They fit clouds with a point spacing below ``tolerance / MIN_TOLERANCE_TO_SPACING``;
    :meth:`widened` adapts them to sparser ones.
    """

    voxel_size: float = Field(ge=0.01, le=10, description="edge of the voxel grid, metres")
    tolerance: float = Field(
        ge=0.01, le=MAX_TOLERANCE_M, description="largest gap between points of a segment, metres"
    )
    min_points: int = Field(ge=1, le=10**9, description="points of the smallest segment")
    max_points: int = Field(15_000, ge=1, le=10**9, description="points of the largest segment")
    height_cuts: tuple[HeightAboveGround, ...] = Field(
        (0.6, 1.2),
        min_length=1,
        max_length=16,
        description="clusters are formed above each of these heights over ground, metres",
    )

    def adapt(self, points: Float32) -> ClusterConfig:
        """Return these settings, adapted if the points are too far apart to link.

        Parameters
        ----------
        points : (N, 3) float32
            Points above ground, in the order of a voxel grid.
        """
        max_spacing = self.tolerance / MIN_TOLERANCE_TO_SPACING
        spacing = _native.point_spacing(points, max_spacing, SPACING_SAMPLE)
        if spacing <= max_spacing:
            return self
        fewer = self.min_points * (max_spacing / spacing) ** 2  # points lie on surfaces
        changes = {
            "tolerance": min(max(self.tolerance, TOLERANCE_TO_SPACING * spacing), MAX_TOLERANCE_M),
            "min_points": min(self.min_points, max(MIN_POINTS, round(fewer))),
        }
        return self.model_copy(update=changes)


class SegmentationConfig(Section):
    """Segmentation of accumulated clouds and of single scans."""

    accumulated: ClusterConfig = ClusterConfig(voxel_size=0.2, tolerance=0.4, min_points=30)
    single: ClusterConfig = ClusterConfig(voxel_size=0.1, tolerance=0.7, min_points=10)
    ground_cell: float = Field(
        1.0, ge=0.05, le=100, description="edge of a cell of the ground grid, metres"
    )
    ground_slope: float = Field(0.2, gt=0, le=10, description="steepest ground, rise over run")
    ground_step: float = Field(
        0.3, gt=0, le=100, description="largest step between neighbouring cells of ground, metres"
    )
    structure_height: float = Field(
        0.4,
        ge=-100,
        le=100,
        description="height above ground of points that verification uses, metres",
    )
    ground_voxel: float = Field(
        1.0, ge=0.01, le=100, description="voxel size of the other points, metres"
    )


_BLOCK_CELLS = 4096
"""Width of a block with its own ground grid: 64 MB."""


def heights_above_ground(points: Float32, config: SegmentationConfig) -> Float32:
    """Return the height of each of (N, 3) points above the ground below it [m], (N,).

    In a cloud kilometres wide, the ground of each block of ``_BLOCK_CELLS`` cells is found alone.
    """
    ground = config.ground_cell, config.ground_slope, config.ground_step
    wide = _BLOCK_CELLS * config.ground_cell
    # All values at once, which bounds both extents, or column by column: along the other axis NumPy
    # takes thirty times as long.
    if (
        not len(points)
        or np.ptp(points) <= wide
        or max(np.ptp(points[:, 0]), np.ptp(points[:, 1])) <= wide
    ):
        return _native.heights_above_ground(points, *ground)
    blocks = geometry.cells_of(points[:, :2].astype(np.float64), wide)
    _, number = np.unique(geometry.keys_of(blocks), return_inverse=True)
    heights = np.empty(len(points), np.float32)
    for k in range(number.max() + 1):
        here = number == k
        heights[here] = _native.heights_above_ground(np.ascontiguousarray(points[here]), *ground)
    return heights


class Segmentation:
    """Segments, structure and ground of a local cloud.

    Parameters
    ----------
    segments : Segments or callable
        The segments; or computes them when they are needed.
    structure : (N, 3) float32
        Voxelised points above ground, local frame. Verification compares them with the map.
    ground : (M, 3) float32
        The other points, thinned. They fix the height and the tilt of a pose.
    """

    def __init__(
        self, segments: Segments | Callable[[], Segments], structure: Float32, ground: Float32
    ) -> None:
        self._segments, self.structure, self.ground = segments, structure, ground

    def __reduce__(self) -> tuple[type[Segmentation], tuple[Segments, Float32, Float32]]:
        """Pickle what was computed, not how."""
        return Segmentation, (self.segments, self.structure, self.ground)

    @property
    def segments(self) -> Segments:
        """The segments; computed once."""
        found = self._segments
        if callable(found):  # concurrent callers compute them twice, harmlessly
            self._segments = found = found()
        return found

    @property
    def num_segments(self) -> int:
        """Number of segments; 0 before they are computed."""
        found = self._segments
        return 0 if callable(found) else len(found)

    @property
    def surface(self) -> Float32:
        """Structure and ground, (N + M, 3)."""
        return np.concatenate([self.structure, self.ground])


class Segmenter:
    """Divides a local cloud into segments (arXiv 2301.13583: Euclidean segmentation)."""

    def __init__(self, config: SegmentationConfig | None = None) -> None:
        self.config = config or SegmentationConfig()

    def segment(self, cloud: LocalCloud) -> Segmentation:
        """Voxelise, remove the ground; cluster above each height cut, when segments are needed.

        An object may have a segment at each cut: two cars joined by a hedge are separate above it.
        """
        config = self.config
        cluster = config.single if cloud.num_scans == 1 else config.accumulated
        points = cloud.points
        if cloud.voxel_size != cluster.voxel_size:
            points = _native.voxel_grid(points, cluster.voxel_size)
        heights = heights_above_ground(points, config)
        structure, low = _native.split_by_height(points, heights, config.structure_height)
        ground = _native.voxel_grid(low, config.ground_voxel)
        clusters = partial(_clusters, points, heights, cluster, structure)
        return Segmentation(clusters, structure, ground)


def _clusters(
    points: Float32, heights: Float32, cluster: ClusterConfig, structure: Float32
) -> Segments:
    """Cluster points above each height cut, by parameters for the density of the structure."""
    cluster = cluster.adapt(structure)
    found = _native.segments_above(
        points,
        heights,
        cluster.height_cuts,
        cluster.tolerance,
        cluster.min_points,
        cluster.max_points,
    )
    return Segments(*found)
