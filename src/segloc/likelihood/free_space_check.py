"""How much of the map in view a query sees, and how much its rays pass through.

A map point violates free space where the sensor measured something well behind it, in its direction
and in all directions about it. G. Kim, A. Kim, "Remove, then Revert: Static Point Cloud Map
Construction using Multiresolution Range Images", IROS 2020, compares range images in the same way.
"""

from __future__ import annotations

import numpy as np

from .. import _native, geometry
from ..frontend.segmentation import Segmentation
from ..types import Float32, Pose
from .config import VerificationConfig

_NEARLY_ALL, _MOST = (1.0, 99.0), 4000
"""Percentiles of the heights of what is seen, and how many points they are taken of."""
_BESIDE_M = 1.0
"""Map points that are so far above or below these are still on the storey of the query."""


class QueryView:
    """What a sensor saw, as a range image about the local frame's origin.

    Attributes
    ----------
    low, high : float
        Nearly all that it saw is between these heights, metres.
    """

    def __init__(self, scene: Segmentation, config: VerificationConfig) -> None:
        radius = max(config.seen_radius, config.coarse_radius)
        self._margin = config.visibility_margin
        self.low, self.high = _heights(scene)
        self._image = _native.VisibilityCheck(
            scene.structure, scene.ground, config.visibility_range, config.visibility_bin, radius
        )

    def judged(self, points: Float32, T_local_map: Pose, radius: float) -> tuple[int, int]:
        """How many of (N, 3) map points are seen, and how many violate free space."""
        seen, violations = self._image.count(points, T_local_map, radius, self._margin)
        return seen, violations


def judged(
    index: _native.PointIndex,
    view: QueryView,
    T: Pose,
    radius: float,
    range_m: float,
    sample: int,
    storeyed: bool,
) -> tuple[int, int]:
    """How many map points the query sees, too, and how many were judged.

    Parameters
    ----------
    index : PointIndex
        Of the map's cloud.
    view : QueryView
    T : (4, 4) float64
        From the local frame to that of the cloud.
    radius : float
        A map point with a query point so near is seen, metres.
    range_m : float
        Map points this near are judged, metres.
    sample : int
        So many of them at most.
    storeyed : bool
        Whether the map has several storeys. Those of others than the query's cannot be seen, and
        are left out: they would take the place of what can be judged.
    """
    x, y = float(T[0, 3]), float(T[1, 3])
    low, high = (view.low - _BESIDE_M, view.high + _BESIDE_M) if storeyed else (-np.inf, np.inf)
    points = index.sample(x, y, range_m, sample, low + T[2, 3], high + T[2, 3])
    T_local_map = np.ascontiguousarray(geometry.inverse(T))
    seen, violations = view.judged(points, T_local_map, radius)
    return seen, seen + violations


def _heights(scene: Segmentation) -> tuple[float, float]:
    z = np.concatenate([scene.structure[:, 2], scene.ground[:, 2]])
    if not len(z):
        return -np.inf, np.inf
    low, high = np.percentile(z[:: -(-len(z) // _MOST)], _NEARLY_ALL)
    return float(low), float(high)
