"""Nearest neighbours as arrays, whatever the shape of the query points."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from ...types import Float64, Int64


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
