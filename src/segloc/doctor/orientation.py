"""Which axis of a scan points up, by the flat ground that it shows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from .. import _native
from ..types import Float32, Float64

_NEAR_M, _VOXEL_M = 25.0, 0.4
_FEWEST_PLACES = 50
_NEIGHBOURS, _SUPPORT_M = 12, 2.5
_FLAT = 0.05  # variance across a flat place, as a share of that along its narrower direction
_BROAD = 0.1  # likewise of its two directions: the points of one beam are a line
_ALONG = 0.94  # cosine of 20 degrees, between a normal and its axis
_BESIDE_M = 0.3  # what lies at the sensor's own height is on neither side


@dataclass(frozen=True)
class Floors:
    """What is flat on each side of the sensor, across each axis.

    Attributes
    ----------
    shares : (3, 2) float64
        Of the flat places, those with normals along x, y or z on the negative and on the positive
        side, in [0, 1].
    metres : (3, 2) float64
        How far off they lie along the axis, median; NaN where there are none.
    """

    shares: Float64
    metres: Float64


def floors(points: Float32) -> Floors | None:
    """What is flat in a scan, (N, 3), sensor frame; None where that is too little."""
    near = points[np.einsum("ij,ij->i", points, points) < _NEAR_M**2]
    places = _native.voxel_grid(np.ascontiguousarray(near), _VOXEL_M).astype(np.float64)
    if len(places) < _FEWEST_PLACES:
        return None
    normals, flat = _normals(places)
    places, normals = places[flat], normals[flat]
    if len(places) < _FEWEST_PLACES:
        return None
    shares, metres = np.zeros((3, 2)), np.full((3, 2), np.nan)
    for axis, side in np.ndindex(3, 2):
        off = places[:, axis] * (-1.0, 1.0)[side]
        chosen = (np.abs(normals[:, axis]) > _ALONG) & (off > _BESIDE_M)
        shares[axis, side] = chosen.mean()
        metres[axis, side] = np.median(off[chosen]) if chosen.any() else np.nan
    return Floors(shares, metres)


def _normals(places: Float64) -> tuple[Float64, NDArray[np.bool_]]:
    """Normals of the surface at each place, (N, 3), and where it is flat."""
    found = cKDTree(places).query(places, k=_NEIGHBOURS)
    distances, rows = np.asarray(found[0]), np.asarray(found[1])
    spread = places[rows] - places[rows].mean(axis=1, keepdims=True)
    values, axes = np.linalg.eigh(np.einsum("nki,nkj->nij", spread, spread))
    flat = (values[:, 0] < _FLAT * values[:, 1]) & (values[:, 1] > _BROAD * values[:, 2])
    flat &= distances[:, -1] < _SUPPORT_M
    return axes[:, :, 0], flat
