"""How closely the walls of a query lie on those of the map, and how well its ground does.

Hedges and rows of trees may fit where they do not stand, but not on ground that rises and falls
otherwise. Rooms that are alike differ by decimetres: how many points of all walls are flush with
the map's tells them apart, which no neighbourhood of a point does that is as wide as the map's
points lie apart.
"""

from __future__ import annotations

import numpy as np

from .. import _native
from ..types import Float32, Pose

_STEEP = 0.3  # the most that a wall's normal points up or down
_LEVEL = 0.9  # the least that the ground's does
_FEWEST = 30  # points of walls, or of the ground, that are judged
_MOST = 2000  # points that are compared
_GROUND_M = 0.2  # ground that is off by less fits
_CLOSE_M, _SUPPORT_M = 1.0, 0.75  # of close surfaces: the nearest point, and those of its plane


def close_surface(points: Float32) -> _native.Surface:
    """A cloud, (N, 3), as densely as a map has it: its planes are known to centimetres."""
    return _native.Surface(np.ascontiguousarray(points), _CLOSE_M, _SUPPORT_M)


def flush_share(
    target: _native.Surface, source: _native.Surface, T: Pose, offset: float
) -> float | None:
    """How many wall points of a query are flush with a surface of the map, of those near one.

    What has no map point near it may be higher than the map reaches, and counts for the overlap.

    Parameters
    ----------
    target, source : Surface
        Of :func:`close_surface`, of the map and of the query.
    T : (4, 4) float64
        Takes the source to the target.
    offset : float
        Points that are off the map's plane by less are flush with it, metres.

    Returns
    -------
    float or None
        A share, in [0, 1]; None where there are too few.
    """
    offsets, normals = target.offsets(source, T, _MOST)
    wall = (np.abs(normals[:, 2]) < _STEEP) & normals.any(axis=1) & np.isfinite(offsets)
    return float((offsets[wall] < offset).mean()) if wall.sum() >= _FEWEST else None


def ground_share(target: _native.Surface, source: _native.Surface, T: Pose) -> float | None:
    """How much of a query's ground lies on that of the map, of what the map has a surface near.

    Parameters
    ----------
    target, source : Surface
        Of the map and of the query.
    T : (4, 4) float64
        Takes the source to the target.

    Returns
    -------
    float or None
        A share, in [0, 1]; None where there is too little.
    """
    offsets, normals = target.offsets(source, T, _MOST)
    level = (np.abs(normals[:, 2]) > _LEVEL) & np.isfinite(offsets)
    return float((offsets[level] < _GROUND_M).mean()) if level.sum() >= _FEWEST else None
