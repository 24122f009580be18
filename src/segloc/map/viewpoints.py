"""Where a sensor may have stood in a cloud that has no trajectory, and what is visible from there.

A viewpoint stands on free ground: a flat patch with room for the sensor above it, on any storey.
What lies behind a surface is hidden from it: a point is hidden if another lies before it in its
direction, and the point is behind the plane of that one. Points of one wall, seen along it, do not
hide each other.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from ..geometry import cells_of, distinct
from ..types import Bools, Float32, Float64, Int64

CELL_M, STEP_M = 0.5, 0.3
"""Cells of the ground, and the step between two of them that a sensor can take [m]."""
SPACING_M = 8.0
"""Distance between viewpoints in sight of each other [m]."""
HEADROOM_M = 0.4
"""Least free space above a sensor [m]."""
_MIN_AREA_M2, _MAX_MIN_AREA_M2, _MIN_AREA_SHARE = 6.0, 30.0, 0.05  # of connected ground
MAX_CLEARANCE_M = 8.0
"""Room around a viewpoint counts up to this distance [m]."""
_MIN_NEIGHBOURS = 7  # of 8, around a cell of ground that has room
_SAME_M = 2.0  # ground nearer than this needs no viewpoint of its own, even if it is out of sight
STOREY_M = 1.5
"""Ground that is higher or lower by more is of another storey [m]."""
AROUND_M = 8.0
"""Horizontal distance within which walls about a place are counted [m]."""
_BAND_M, _SPARE_CELLS = (1.0, 2.0), 8
_BIN_RAD = np.radians(1.0)
_LEVELS = 5  # of direction bins, each twice as wide
_BEHIND_M, _OFF_PLANE_M = 0.5, 0.3


def tops(points: Float32, sensor_height_m: float) -> Float64:
    """Tops of what stands in each cell with room for a sensor above them.

    Parameters
    ----------
    points : (N, 3) float32
    sensor_height_m : float

    Returns
    -------
    (M, 3) float64
        The middle of each cell, at the height of the top.
    """
    cells = cells_of(points[:, :2], CELL_M)
    order = np.lexsort((points[:, 2], cells[:, 0], cells[:, 1]))
    cells, z = cells[order], points[order, 2].astype(np.float64)
    ends = (np.diff(cells, axis=0, append=cells[-1:] + 1) != 0).any(axis=1)
    room = ends | (np.diff(z, append=np.inf) > sensor_height_m + HEADROOM_M)
    return np.column_stack([(cells[room] + 0.5) * CELL_M, z[room]])


def cells_below(points: Float32) -> int:
    """Return the number of cells of the ground in which there are points (N, 3)."""
    return len(distinct(cells_of(points[:, :2], CELL_M)))


@dataclass(frozen=True)
class Ground:
    """Cells of free ground, the roomiest first.

    Attributes
    ----------
    places : (N, 3) float64
        The middle of each cell, on the ground [m].
    clearance : (N,) float64
        Distance to the nearest edge of the free ground [m].
    """

    places: Float64
    clearance: Float64

    @classmethod
    def of(cls, places: Float64) -> Ground:
        """What of (N, 3) :func:`tops` is connected and level enough."""
        count = len(places)
        pairs = cKDTree(places / [CELL_M, CELL_M, STEP_M]).query_pairs(
            1.001, p=np.inf, output_type="ndarray"
        )
        graph = coo_array((np.ones(len(pairs), bool), tuple(pairs.T)), shape=(count, count))
        _, label = connected_components(graph, directed=False)
        areas = np.bincount(label) * CELL_M**2
        least = np.clip(_MIN_AREA_SHARE * areas.max(), _MIN_AREA_M2, _MAX_MIN_AREA_M2)
        depth, inside = np.zeros(count), areas[label] >= least
        for _ in range(int(MAX_CLEARANCE_M / CELL_M)):
            linked = pairs[inside[pairs].all(axis=1)]
            inside = np.bincount(linked.ravel(), minlength=count) >= _MIN_NEIGHBOURS
            depth += inside
        order = np.lexsort((places[:, 1], places[:, 0], -depth))
        order = order[depth[order] > 0]
        return cls(places[order], depth[order] * CELL_M)


@dataclass(frozen=True)
class Occluders:
    """Surfaces that hide what is behind them: points (N, 3) and their normals, zero if none."""

    points: Float32
    normals: Float32
    spacing_m: float


class Sight:
    """What is visible from one viewpoint, (3,)."""

    def __init__(self, eye: Float64, occluders: Occluders) -> None:
        self._eye = eye
        self._rays = (occluders.points - eye).astype(np.float32)
        self._ranges = _lengths(self._rays)
        self._normals = occluders.normals
        self._has_plane: Bools = np.asarray(occluders.normals.any(axis=1))
        nearest_last = np.argsort(-self._ranges, kind="stable")
        with np.errstate(divide="ignore"):
            widths = occluders.spacing_m / self._ranges[nearest_last] / _BIN_RAD
            levels = np.clip(np.ceil(np.log2(widths)), 0, _LEVELS - 1).astype(np.int64)
        self._images: list[tuple[float, NDArray[np.int64]]] = []
        for level in range(_LEVELS):
            rows = nearest_last[levels == level]
            width = _BIN_RAD * 2**level
            image = np.full(_shape(width), -1, np.int64)
            image[_bins(*_angles(self._rays[rows], self._ranges[rows]), width)] = rows
            self._images.append((width, image))

    def sees(self, points: NDArray[np.floating]) -> Bools:
        """Which of (N, 3) points are not hidden, (N,)."""
        rays = (points - self._eye).astype(np.float32)
        ranges = _lengths(rays)
        azimuth, elevation = _angles(rays, ranges)
        left = np.arange(len(points))
        for width, image in self._images:
            by = image[_bins(azimuth[left], elevation[left], width)]
            before = np.flatnonzero((by >= 0) & (ranges[left] > self._ranges[by] + _BEHIND_M))
            by, rows = by[before], left[before]
            beyond = rays.take(rows, axis=0) - self._rays.take(by, axis=0)
            off = np.abs(np.einsum("ij,ij->i", beyond, self._normals.take(by, axis=0)))
            left = np.delete(left, before[(off > _OFF_PLANE_M) | ~self._has_plane[by]])
        seen = np.zeros(len(points), bool)
        seen[left] = True
        return seen


def _lengths(rays: Float32) -> Float32:
    lengths: Float32 = np.sqrt(np.einsum("ij,ij->i", rays, rays))
    return lengths


def _angles(rays: Float32, ranges: Float32) -> tuple[Float32, Float32]:
    """Azimuth and elevation of each ray, from 0 on [rad]."""
    azimuth = np.arctan2(rays[:, 1], rays[:, 0]) + np.float32(np.pi)
    elevation = np.arcsin(np.clip(rays[:, 2] / np.maximum(ranges, 1e-6), -1, 1))
    return azimuth, elevation + np.float32(np.pi / 2)


def _shape(width: float) -> tuple[int, int]:
    return int(2 * np.pi / width) + 2, int(np.pi / width) + 2


def _bins(azimuth: Float32, elevation: Float32, width: float) -> tuple[Int64, Int64]:
    """The direction bin of each ray."""
    return (azimuth / width).astype(np.int64), (elevation / width).astype(np.int64)


class Uncovered:
    """Ground that no viewpoint covers yet."""

    def __init__(self, ground: Ground, sensor_height_m: float) -> None:
        self._ground, self._eyes = ground, ground.places + [0.0, 0.0, sensor_height_m]
        self._open = np.ones(len(ground.places), bool)
        self._tree = cKDTree(self._eyes) if len(self._eyes) else None
        self._next = 0

    @property
    def left(self) -> int:
        """Number of places left."""
        return int(np.count_nonzero(self._open))

    def next(self) -> int | None:
        """The roomiest place that is left, None if all are covered."""
        while self._next < len(self._open):
            if self._open[self._next]:
                return self._next
            self._next += 1
        return None

    def eye(self, place: int) -> Float64:
        """The viewpoint over a place."""
        eye: Float64 = self._eyes[place]
        return eye

    def is_floor(self, place: int, points: Float32) -> bool:
        """Whether a place is a floor, by the (N, 3) points within AROUND_M of it.

        Walls rise from floors, and end at ceilings.
        """
        at, (low, high) = self._ground.places[place], _BAND_M
        offsets = points - at.astype(np.float32)
        heights = offsets[:, 2] - offsets[:, :2] @ self._slope(place)
        cells = cells_of(offsets[:, :2], CELL_M)

        def count(heights: Float64) -> int:
            return len(distinct(cells[(heights > low) & (heights < high)]))

        return count(-heights) <= count(heights) + _SPARE_CELLS

    def _around(self, place: int, radius: float) -> Int64:
        """Places of the same storey."""
        assert self._tree is not None
        near = np.array(self._tree.query_ball_point(self._eyes[place], radius), np.int64)
        rise = np.abs(self._eyes[near, 2] - self._eyes[place, 2])
        return np.asarray(near[rise < STOREY_M])

    def _slope(self, place: int) -> Float64:
        """How the ground about a place rises along x and y."""
        offsets = self._eyes[self._around(place, AROUND_M)] - self._eyes[place]
        # a ridge keeps the slope of few cells, or across a narrow strip, near zero
        xy, z = offsets[:, :2], offsets[:, 2]
        slope: Float64 = np.linalg.solve(xy.T @ xy + len(xy) * np.eye(2), xy.T @ z)
        return slope

    def cover(self, place: int, sight: Sight) -> None:
        """Take out what a viewpoint at a place shows as well as another would."""
        eye = self._eyes[place]
        reach = max(SPACING_M, float(self._ground.clearance[place]))
        near = self._around(place, reach)
        near = near[self._open[near]]
        close = np.linalg.norm(self._eyes[near] - eye, axis=1) < _SAME_M
        self._open[near[close | sight.sees(self._eyes[near])]] = False
