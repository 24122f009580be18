"""Two submaps -> their relative pose, its covariance, and whether they fit at all."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
import small_gicp

from .. import _native, geometry
from ..types import Float64, Pose
from .config import AlignConfig
from .submaps import Submap

_LEAST_POINTS = 100
_SAMPLE = 2000
_COVARIANCE_SCALE = 20.0  # neighbouring correspondences err together
_PREPARED = 64


@dataclass(frozen=True)
class Fit:
    """How one submap lies on another.

    Attributes
    ----------
    T_target_source : (4, 4) float64
    covariance : (6, 6) float64
        Of rotation and translation, frame of the source.
    shared : float
        Share of the source's structure that meets the target's, and the other way round: the
        larger of the two, since submaps reach differently far.
    shift_m : float
        How far registration moved the source.
    """

    T_target_source: Pose
    covariance: Float64
    shared: float
    shift_m: float


class Register:
    """Generalised ICP between submaps (A. Segal, D. Haehnel, S. Thrun, RSS 2009)."""

    def __init__(self, submaps: list[Submap], config: AlignConfig) -> None:
        self._submaps, self._config = submaps, config
        self._prepared = lru_cache(maxsize=_PREPARED)(self._prepare)
        self._index = lru_cache(maxsize=_PREPARED)(self._make_index)

    def fit(self, target: int, source: int, T_target_source: Pose) -> Fit | None:
        """Align two submaps, by number, from a first guess; None where ICP cannot."""
        clouds = self._prepared(target), self._prepared(source)
        if clouds[0] is None or clouds[1] is None:
            return None
        result: Any = small_gicp.align(
            clouds[0][0],
            clouds[1][0],
            clouds[0][1],
            T_target_source,
            "GICP",
            max_correspondence_distance=self._config.icp_reach,
            num_threads=1,
        )
        T = np.array(result.T_target_source)
        covariance = self._covariance(result)
        if not np.isfinite(T).all() or covariance is None:
            return None
        T = geometry.orthonormal(T)
        there, back = (
            self._shared(target, source, T),
            self._shared(source, target, geometry.inverse(T)),
        )
        shift = float(np.linalg.norm(T[:3, 3] - T_target_source[:3, 3]))
        return Fit(T, covariance, max(there, back), shift)

    def _prepare(self, k: int) -> tuple[Any, Any] | None:
        surface = self._submaps[k].surface
        if len(surface) < _LEAST_POINTS:
            return None
        prepared: tuple[Any, Any] = small_gicp.preprocess_points(
            surface.astype(np.float64), self._config.icp_voxel, num_threads=1
        )
        return prepared

    def _make_index(self, k: int) -> _native.PointIndex:
        return _native.PointIndex(self._submaps[k].structure, self._config.near_m)

    def _shared(self, target: int, source: int, T: Pose) -> float:
        points = self._submaps[source].structure
        if len(points) < _LEAST_POINTS or len(self._submaps[target].structure) < _LEAST_POINTS:
            return 0.0
        sample = np.ascontiguousarray(points[:: max(1, len(points) // _SAMPLE)])
        overlap, _ = self._index(target).overlap(sample, T[None], self._config.near_m)
        return float(overlap[0])

    def _covariance(self, result: Any) -> Float64 | None:
        """From the curvature of the cost, and no smaller than loops are believed to be exact."""
        degrees = 3 * result.num_inliers - 6
        H = np.array(result.H)
        if degrees <= 0 or not np.isfinite(H).all() or np.linalg.cond(H) > 1e12:
            return None
        scaled = np.linalg.inv(H) * (_COVARIANCE_SCALE * 2.0 * result.error / degrees)
        least = np.repeat([np.radians(self._config.loop_deg), self._config.loop_m], 3) ** 2
        covariance: Float64 = (scaled + scaled.T) / 2 + np.diag(least)
        return covariance
