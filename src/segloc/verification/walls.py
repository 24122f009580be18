"""How well the walls and the ground of a query lie on those of the map.

Where one wall fits, a pose may still be wrong along it. So each direction that walls face is judged
by itself, and the worst one counts. Hedges and rows of trees may fit where they do not stand, but
not on ground that rises and falls otherwise.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .. import _native
from ..types import Pose

_STEEP = 0.3  # the most that a wall's normal points up or down
_LEVEL = 0.9  # the least that the ground's does
_EVERY_DEG, _HALF_WIDTH_DEG = 30.0, 30.0  # six sectors of 60 degrees, which overlap
_FEWEST = 30  # points of a sector, or of the ground, that is judged
_MOST = 2000  # points that are compared
_GROUND_M = 0.2  # ground that is off by less fits


@dataclass(frozen=True)
class SurfaceFit:
    """How well two surfaces fit, by the direction that they face.

    Attributes
    ----------
    walls : float or None
        The least share of wall points of one direction that lie on a surface of the map, in [0, 1];
        None where no direction has enough of them.
    ground : float or None
        The share of level points that do, of those that the map has a surface near; None where
        there are too few.
    """

    walls: float | None = None
    ground: float | None = None


def surface_fit(
    target: _native.Surface, source: _native.Surface, T: Pose, wall_offset: float
) -> SurfaceFit:
    """How well walls and ground fit at a pose.

    Parameters
    ----------
    target, source : Surface
        Of the map and of the query.
    T : (4, 4) float64
        Takes the source to the target.
    wall_offset : float
        A wall that is off by less, across, fits, metres.
    """
    offsets, normals = target.offsets(source, T, _MOST)
    level = (np.abs(normals[:, 2]) > _LEVEL) & np.isfinite(offsets)
    ground = float((offsets[level] < _GROUND_M).mean()) if level.sum() >= _FEWEST else None
    wall = (np.abs(normals[:, 2]) < _STEEP) & normals.any(axis=1) & ~np.isnan(offsets)
    azimuth = np.degrees(np.arctan2(normals[wall, 1], normals[wall, 0]))
    fits = offsets[wall] < wall_offset
    shares = []
    for centre in np.arange(0.0, 180.0, _EVERY_DEG):
        sector = np.abs((azimuth - centre + 90.0) % 180.0 - 90.0) < _HALF_WIDTH_DEG
        if sector.sum() >= _FEWEST:
            shares.append(float(fits[sector].mean()))
    return SurfaceFit(min(shares, default=None), ground)
