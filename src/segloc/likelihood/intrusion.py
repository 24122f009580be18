"""What a query shows standing where the map is known to be free.

The free-space check judges points of the map by what the query sees. This is the other way round:
a map was made along a path, and what its sensor looked through there was free. At a place that is
only like the right one, other racks and cars stand in that space.
"""

from __future__ import annotations

import numpy as np

from .. import _native
from ..types import Float32, Float64, Pose
from .config import VerificationConfig

_NEAR_M, _APART_M, _MOST = 12.0, 3.0, 8
"""It is looked from poses of the path so near, so far apart, and so many at most, nearest first."""
_STOREY_M = 1.5
"""Those that are farther up or down than this are on another storey."""
_HALF_WIDTH_M = 0.2
"""What a point of the map's cloud stands for: near the path its walls would have holes."""


def viewpoints(path: Float64, at: Float64) -> Float64:
    """The poses of a path, (M, 3), that free space about a position is known from, (V, 3)."""
    off = path - at
    near = (np.hypot(off[:, 0], off[:, 1]) < _NEAR_M) & (np.abs(off[:, 2]) < _STOREY_M)
    chosen: list[Float64] = []
    for p in path[near][np.argsort(np.hypot(*off[near, :2].T), kind="stable")]:
        if len(chosen) == _MOST:
            break
        if all(np.linalg.norm(p - other) > _APART_M for other in chosen):
            chosen.append(p)
    return np.array(chosen).reshape(-1, 3)


def intruding_share(
    index: _native.PointIndex, sample: Float32, T: Pose, path: Float64, config: VerificationConfig
) -> float:
    """How much of what a query shows standing stands in free space of the map.

    Parameters
    ----------
    index : PointIndex
        Of the map's cloud.
    sample : (N, 3) float32
        What stands, about the sensor.
    T : (4, 4) float64
        Takes it to the frame of the map's cloud.
    path : (M, 3) float64
        Where the sensor was when the map was made, in the same frame.
    config : VerificationConfig

    Returns
    -------
    float
        A share, in [0, 1].
    """
    used, intruding = index.intrusion(
        sample,
        T,
        viewpoints(path, T[:3, 3]),
        config.visibility_range,
        config.visibility_bin,
        config.coarse_radius,
        config.visibility_margin,
        _HALF_WIDTH_M,
    )
    return intruding / used if used else 0.0
