"""Two clouds and a first guess -> where they fit best, by generalised ICP."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from . import _native, geometry
from .types import Float32, Float64, Pose

MIN_POINTS = 20
COVARIANCE_SCALE = 20.0
"""Neighbouring correspondences err together, so the curvature of the cost alone claims far too
much. With this factor the normalised squared error is about 1 on simulated towns."""


@dataclass(frozen=True)
class Aligned:
    """How one cloud was aligned with another.

    Attributes
    ----------
    T_target_source : (4, 4) float64
    covariance : (6, 6) float64
        Of rotation and translation, in the source's frame.
    """

    T_target_source: Pose
    covariance: Float64


class Aligner:
    """Generalised ICP (A. Segal, D. Haehnel, S. Thrun, RSS 2009) of thinned clouds.

    Parameters
    ----------
    voxel : float
        Clouds are thinned to this, metres.
    max_correspondence : float
        Maximum correspondence distance, metres.
    threads : int
        0: all cores. The result does not depend on it.
    """

    def __init__(self, voxel: float, max_correspondence: float, threads: int = 0) -> None:
        self._voxel, self._threads = voxel, threads
        self._max_correspondence = max_correspondence

    def surface(self, points: Float32) -> _native.Surface:
        """A cloud, (N, 3), made ready to be aligned or aligned with, any number of times."""
        thinned = _native.voxel_grid(np.ascontiguousarray(points), self._voxel)
        return _native.Surface(thinned, self._max_correspondence, 2.0 * self._voxel)

    def align(
        self, target: _native.Surface, source: _native.Surface, T_target_source: Pose
    ) -> Aligned | None:
        """Align from a first guess; None where it is not finite, or the clouds share too little."""
        if not np.isfinite(T_target_source).all():
            return None
        T, H, error, inliers, _ = target.align(
            source, np.ascontiguousarray(T_target_source), threads=self._threads
        )
        degrees = 3 * inliers - 6
        if min(inliers, len(target)) < MIN_POINTS or not np.isfinite(np.append(T, H)).all():
            return None
        if np.linalg.cond(H) > 1e12:
            return None
        inverse = np.linalg.inv(H) * (COVARIANCE_SCALE * 2.0 * error / degrees)
        return Aligned(geometry.orthonormal(T), (inverse + inverse.T) / 2)
