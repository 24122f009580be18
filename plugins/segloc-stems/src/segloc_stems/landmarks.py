"""Landmarks of a query or view: positions, axes and diameters of upright objects."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from segloc import geometry
from segloc.errors import InvalidScan
from segloc.system.checks import MAX_LOCAL_METRES, check_finite, checked_rows, checked_stamp
from segloc.types import Float64, Int64, Pose

MAX_DIAMETER_M = 100.0


@dataclass(frozen=True)
class Landmarks:
    """Upright objects from any detector: stems, poles, columns.

    Attributes
    ----------
    positions : (N, 3) float64
        Foot of each on the ground, sensor frame [m].
    axes : (N, 3) float64
        Upward direction of each, of any length; (0, 0, 1) by default, for a level sensor. Stored
        with length 1.
    diameters : (N,) float64
        Diameters [m]; 0 by default, for unknown.
    stamp : float or None
        Time of the scan [s].

    Raises
    ------
    InvalidScan
        If shapes do not fit, or a value is not finite or too large; names the field and the row.
    """

    positions: Float64
    axes: Float64 | None = None
    diameters: Float64 | None = None
    stamp: float | None = None

    def __post_init__(self) -> None:
        positions = checked_rows(self.positions, "positions", (-1, 3), np.float64)
        check_finite(positions, "positions", MAX_LOCAL_METRES)
        count = len(positions)
        diameters = np.zeros(count) if self.diameters is None else self.diameters
        diameters = checked_rows(diameters, "diameters", (count,), np.float64)
        bad = np.flatnonzero((diameters < 0) | (diameters > MAX_DIAMETER_M))
        if len(bad):
            raise InvalidScan(f"diameters: row {bad[0]} is not from 0 to {MAX_DIAMETER_M:g} m")
        object.__setattr__(self, "positions", positions)
        object.__setattr__(self, "axes", _directions(self.axes, count))
        object.__setattr__(self, "diameters", diameters)
        object.__setattr__(self, "stamp", checked_stamp(self.stamp))

    def __len__(self) -> int:
        return len(self.positions)

    def transform(self, T: Pose) -> Float64:
        """Return positions, axes and diameters in the target frame of T, (N, 7) float64."""
        turned = self.directions @ T[:3, :3].T
        assert self.diameters is not None  # set by __post_init__
        return np.column_stack([geometry.transform(T, self.positions), turned, self.diameters])

    @property
    def directions(self) -> Float64:
        """The axes, (N, 3) float64; vertical by default."""
        assert self.axes is not None  # set by __post_init__
        return self.axes


def _directions(axes: Float64 | None, count: int) -> Float64:
    if axes is None:
        return np.tile([0.0, 0.0, 1.0], (count, 1))
    rows: Float64 = checked_rows(axes, "axes", (count, 3), np.float64)
    with np.errstate(over="ignore"):
        lengths = np.linalg.norm(rows, axis=1)
    bad = np.flatnonzero((lengths < 1e-6) | (lengths > 1e6))
    if len(bad):
        raise InvalidScan(f"axes: row {bad[0]} is no direction (its length is {lengths[bad[0]]:g})")
    unit: Float64 = rows / lengths[:, None]
    return unit


def levelling(axes: Float64) -> Pose:
    """Return T_local_sensor: the rotation that makes the median of the axes vertical.

    The heading of the x axis is kept. Without axes the sensor counts as level.

    Parameters
    ----------
    axes : (N, 3) float64
        Sensor frame.
    """
    if not len(axes):
        return np.eye(4)
    up = np.median(axes, axis=0)
    length = float(np.linalg.norm(up))
    if length < _MIN_UP or up[2] < _MIN_UP * length:
        return np.eye(4)  # axes in all directions, or lying: gravity is unknown
    return geometry.upright(up)


_MIN_UP = 0.2
"""Least length of the median, and least share of its vertical part: 78 degrees of tilt."""


def nearest(
    tree: cKDTree, points: Float64, count: int = 1, within: float = np.inf
) -> tuple[Float64, Int64]:
    """Return the distances of points to their nearest neighbours in a tree, and their indices.

    Parameters
    ----------
    tree : cKDTree
        Tree of D-dimensional points.
    points : (..., D) float64
    count : int
        Number of neighbours.
    within : float
        Largest distance; farther neighbours are at infinity.

    Returns
    -------
    (..., count) float64, (..., count) int64
        Without the last axis if ``count`` is 1.
    """
    distances, which = tree.query(points, count, distance_upper_bound=within)
    return np.asarray(distances, np.float64), np.asarray(which, np.int64)
