"""Landmarks of one query or one view: where upright things stand, how they lean, how thick."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from ... import geometry
from ...errors import InvalidScan
from ...system.checks import MOST_LOCAL_METRES, check_finite, checked_rows, checked_stamp
from ...types import Float64, Int64, Pose

MOST_DIAMETER_M = 100.0


@dataclass(frozen=True)
class Landmarks:
    """Upright things that a detector of one's own has found: stems, poles, columns.

    Attributes
    ----------
    positions : (N, 3) float64
        Where each stands on the ground, sensor frame, metres.
    axes : (N, 3) float64
        Its direction upwards, of any length; all (0, 0, 1) by default, which says that the sensor
        is level. Stored with length 1.
    diameters : (N,) float64
        Metres; all 0 by default, which says that they are not known.
    stamp : float or None
        Time of the scan they were found in, seconds.

    Raises
    ------
    InvalidScan
        If shapes do not fit, or a value is not finite or beyond all reason; names the field and
        the row.
    """

    positions: Float64
    axes: Float64 | None = None
    diameters: Float64 | None = None
    stamp: float | None = None

    def __post_init__(self) -> None:
        positions = checked_rows(self.positions, "positions", (-1, 3), np.float64)
        check_finite(positions, "positions", MOST_LOCAL_METRES)
        count = len(positions)
        diameters = np.zeros(count) if self.diameters is None else self.diameters
        diameters = checked_rows(diameters, "diameters", (count,), np.float64)
        bad = np.flatnonzero((diameters < 0) | (diameters > MOST_DIAMETER_M))
        if len(bad):
            raise InvalidScan(f"diameters: row {bad[0]} is not from 0 to {MOST_DIAMETER_M:g} m")
        object.__setattr__(self, "positions", positions)
        object.__setattr__(self, "axes", _directions(self.axes, count))
        object.__setattr__(self, "diameters", diameters)
        object.__setattr__(self, "stamp", checked_stamp(self.stamp))

    def __len__(self) -> int:
        return len(self.positions)

    def moved(self, T: Pose) -> Float64:
        """Positions, axes and diameters in the frame that T leads to, (N, 7) float64."""
        turned = self.directions @ T[:3, :3].T
        assert self.diameters is not None  # set at the door
        return np.column_stack([geometry.transform(T, self.positions), turned, self.diameters])

    @property
    def directions(self) -> Float64:
        """The axes; those that were left out point up. (N, 3) float64."""
        assert self.axes is not None  # set at the door
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
    """T_local_sensor: the turn after which the median of the axes points up.

    The sensor's heading stays the x axis's. Without axes the sensor counts as level.

    Parameters
    ----------
    axes : (N, 3) float64
        Sensor frame.
    """
    if not len(axes):
        return np.eye(4)
    up = np.median(axes, axis=0)
    length = float(np.linalg.norm(up))
    if length < _LEAST_UP or up[2] < _LEAST_UP * length:
        return np.eye(4)  # they point all ways, or lie: nothing is known of gravity
    return geometry.upright(up)


_LEAST_UP = 0.2
"""Of the length of the median, and of its vertical part: 78 degrees off level."""


def nearest(
    tree: cKDTree, points: Float64, count: int = 1, within: float = np.inf
) -> tuple[Float64, Int64]:
    """Distances of points to their nearest ones in a tree, and which those are.

    Parameters
    ----------
    tree : cKDTree
        Of D-dimensional points.
    points : (..., D) float64
    count : int
        How many for each.
    within : float
        Farther ones are at infinity.

    Returns
    -------
    (..., count) float64, (..., count) int64
        Without the last axis where ``count`` is 1.
    """
    distances, which = tree.query(points, count, distance_upper_bound=within)
    return np.asarray(distances, np.float64), np.asarray(which, np.int64)
