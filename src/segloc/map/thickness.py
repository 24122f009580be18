"""How thick the walls of a cloud are: scans err, drift, and are bent against each other."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from ..types import Float32

_PLACES = 20_000
"""Most places of a cloud that are looked at."""
_RADIUS_M, _LEAST, _MOST = 0.75, 8, 64
"""Radius of a plane, that of the planes which queries are compared with; its fewest and its most
points."""
_UPRIGHT = 0.3
"""Largest vertical part of the normals of walls."""
_FLATTEST = 10.0
"""Percentile of the walls by their thickness: many are hedges, corners, and trunks."""


def thickness_m(points: Float32) -> float:
    """Return how far points (N, 3) lie off the planes of the flattest walls, as a deviation [m].

    It is 0 if there are no walls.
    """
    if len(points) < _MOST:
        return 0.0
    chosen = points[np.random.default_rng(0).permutation(len(points))[:_PLACES]]
    distances, rows = cKDTree(points).query(chosen, k=_MOST, distance_upper_bound=_RADIUS_M)
    near = np.isfinite(distances)
    full = near.sum(axis=1) >= _LEAST
    near, rows, chosen = near[full], np.where(near, rows, 0)[full], chosen[full]
    offsets = (points[rows] - chosen[:, None]) * near[..., None]
    counts = near.sum(axis=1)[:, None, None]
    means = offsets.sum(axis=1, keepdims=True) / counts
    spread = np.einsum("nki,nkj->nij", offsets, offsets) / counts - means.swapaxes(1, 2) @ means
    variances, axes = np.linalg.eigh(spread.astype(np.float64))
    walls = variances[np.abs(axes[:, 2, 0]) < _UPRIGHT, 0]
    return float(np.sqrt(max(np.percentile(walls, _FLATTEST), 0.0))) if len(walls) else 0.0
