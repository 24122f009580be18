"""Next best view: a step after which two similar places differ."""

from __future__ import annotations

import math

import numpy as np

from .. import _native, geometry
from ..localization import NextView
from ..types import Float64, Pose

_DISTANCES_M = tuple(range(4, 44, 4))
_BEARINGS_DEG = (0.0, 45.0, -45.0, 90.0, -90.0, 135.0, -135.0, 180.0)
_RANGE_M, _SAMPLE = 25.0, 400
"""Range and number of compared map points around a view."""
_REACHED_M = 5.0
"""Largest distance from the mapped trajectory."""
RADIUS_M = 0.5
"""Radius within which a point has a counterpart."""
_DIFFERS = 0.15
"""Share of differing points that separates places; noise and changes cause less."""


def next_view(
    index: _native.PointIndex, path: Float64, T_one: Pose, T_other: Pose
) -> NextView | None:
    """Return the shortest step after which two places differ; None if there is none.

    Parameters
    ----------
    index : PointIndex
        Of the map's cloud.
    path : (M, 3) float64
        Positions of the mapping sensor, in the frame of the cloud.
    T_one, T_other : (4, 4) float64
        Poses of the sensor at both places, in the same frame.
    """
    alike = _alike(index, T_one, T_other, np.eye(4))
    for metres in _DISTANCES_M:
        for degrees in _BEARINGS_DEG:
            turn = math.radians(degrees)
            step = np.eye(4)
            step[:2, 3] = metres * math.cos(turn), metres * math.sin(turn)
            if not _is_reached(path, T_one @ step) and not _is_reached(path, T_other @ step):
                continue
            if _alike(index, T_one, T_other, step) < alike - _DIFFERS:
                return NextView(float(metres), degrees)
    return None


def _is_reached(path: Float64, T: Pose) -> bool:
    return bool((np.linalg.norm(path - T[:3, 3], axis=1) < _REACHED_M).any())


def _alike(index: _native.PointIndex, T_one: Pose, T_other: Pose, step: Pose) -> float:
    """Return the share of points in view after a step that exist at the other place."""
    shares = [1.0]
    for T, other in ((T_one, T_other), (T_other, T_one)):
        x, y = (T @ step)[:2, 3]
        points = index.sample(float(x), float(y), _RANGE_M, _SAMPLE)
        if len(points):
            moved = np.ascontiguousarray(other @ geometry.inverse(T))
            shares.append(float(index.overlap(points, moved[None], RADIUS_M)[0]))
    return min(shares)
