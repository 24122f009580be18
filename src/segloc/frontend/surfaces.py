"""Flat surfaces of a cloud."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from .. import _native
from ..types import Float32, Float64

_NEAR_M, _VOXEL_M = 25.0, 0.4
_MIN_PLACES = 50
_NEIGHBOURS, _SUPPORT_M = 12, 2.5
_FLAT = 0.05  # variance across a flat place, as a share of that along its narrower direction
_BROAD = 0.1  # variance of its narrower direction as a share of the other; one beam is a line


@dataclass(frozen=True)
class Surfaces:
    """Flat places of a cloud near its sensor, in the frame of the cloud.

    Attributes
    ----------
    seen : (N, 3) float64
        All places near the sensor, one per voxel.
    places, normals : (M, 3) float64
        Flat places, and their normals, of either sign.
    """

    seen: Float64
    places: Float64
    normals: Float64

    @classmethod
    def of(cls, points: Float32) -> Surfaces | None:
        """Find the flat places of points (N, 3) around a sensor at the origin; None if too few."""
        near = points[np.einsum("ij,ij->i", points, points) < _NEAR_M**2]
        seen = _native.voxel_grid(np.ascontiguousarray(near), _VOXEL_M).astype(np.float64)
        if len(seen) < _MIN_PLACES:
            return None
        normals, flat = _normals(seen)
        return None if flat.sum() < _MIN_PLACES else cls(seen, seen[flat], normals[flat])


def _normals(places: Float64) -> tuple[Float64, NDArray[np.bool_]]:
    """Return the normal of the surface at each place (N, 3), and whether it is flat."""
    found = cKDTree(places).query(places, k=_NEIGHBOURS)
    distances, rows = np.asarray(found[0]), np.asarray(found[1])
    spread = places[rows] - places[rows].mean(axis=1, keepdims=True)
    values, axes = np.linalg.eigh(np.einsum("nki,nkj->nij", spread, spread))
    flat = (values[:, 0] < _FLAT * values[:, 1]) & (values[:, 1] > _BROAD * values[:, 2])
    flat &= distances[:, -1] < _SUPPORT_M
    return axes[:, :, 0], flat
