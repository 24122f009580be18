"""How well the walls of a query lie on those of the map, direction by direction.

Where one wall fits, a pose may still be wrong along it. So each direction that walls face is judged
by itself, and the worst one counts.
"""

from __future__ import annotations

import numpy as np

from .. import _native
from ..types import Pose

_STEEP = 0.3  # the most that a wall's normal points up or down
_EVERY_DEG, _HALF_WIDTH_DEG = 30.0, 30.0  # six sectors of 60 degrees, which overlap
_FEWEST = 30  # points of a sector that is judged


def worst_wall(
    target: _native.Surface, source: _native.Surface, T: Pose, within_m: float
) -> float | None:
    """The least share of wall points of one direction that lie on a surface of the map.

    Parameters
    ----------
    target, source : Surface
        Of the map and of the query.
    T : (4, 4) float64
        Takes the source to the target.
    within_m : float
        Across the surface, metres.

    Returns
    -------
    float or None
        In [0, 1]; None where no direction has enough of them.
    """
    offsets, normals = target.offsets(source, T)
    wall = (np.abs(normals[:, 2]) < _STEEP) & normals.any(axis=1) & ~np.isnan(offsets)
    azimuth = np.degrees(np.arctan2(normals[wall, 1], normals[wall, 0]))
    fits = offsets[wall] < within_m
    shares = []
    for centre in np.arange(0.0, 180.0, _EVERY_DEG):
        sector = np.abs((azimuth - centre + 90.0) % 180.0 - 90.0) < _HALF_WIDTH_DEG
        if sector.sum() >= _FEWEST:
            shares.append(float(fits[sector].mean()))
    return min(shares, default=None)
