"""Two submaps -> their relative pose, its covariance, and whether they fit at all."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from .. import _native, geometry
from ..registration import Aligner
from ..types import Float64, Pose
from .config import AlignConfig
from .submaps import Submap

_LEAST_POINTS = 100
_SAMPLE = 2000
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

    def __init__(self, submaps: list[Submap], config: AlignConfig, threads: int = 0) -> None:
        self._submaps, self._config = submaps, config
        self._aligner = Aligner(config.icp_voxel, config.icp_reach, threads)
        self._surface = lru_cache(maxsize=_PREPARED)(self._make_surface)
        self._index = lru_cache(maxsize=_PREPARED)(self._make_index)

    def fit(self, target: int, source: int, T_target_source: Pose) -> Fit | None:
        """Align two submaps, by number, from a first guess; None where ICP cannot."""
        clouds = self._surface(target), self._surface(source)
        if min(map(len, clouds)) < _LEAST_POINTS:
            return None
        aligned = self._aligner.align(*clouds, T_target_source)
        if aligned is None:
            return None
        T = aligned.T_target_source
        there, back = (
            self._shared(target, source, T),
            self._shared(source, target, geometry.inverse(T)),
        )
        shift = float(np.linalg.norm(T[:3, 3] - T_target_source[:3, 3]))
        # No loop is believed to be more exact than this.
        least = np.repeat([np.radians(self._config.loop_deg), self._config.loop_m], 3) ** 2
        return Fit(T, aligned.covariance + np.diag(least), max(there, back), shift)

    def _make_surface(self, k: int) -> _native.Surface:
        return self._aligner.surface(self._submaps[k].surface)

    def _make_index(self, k: int) -> _native.PointIndex:
        return _native.PointIndex(self._submaps[k].structure, self._config.near_m)

    def _shared(self, target: int, source: int, T: Pose) -> float:
        points = self._submaps[source].structure
        if len(points) < _LEAST_POINTS or len(self._submaps[target].structure) < _LEAST_POINTS:
            return 0.0
        sample = np.ascontiguousarray(points[:: max(1, len(points) // _SAMPLE)])
        overlap, _ = self._index(target).overlap(sample, T[None], self._config.near_m)
        return float(overlap[0])
