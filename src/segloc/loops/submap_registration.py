"""Two submaps -> their relative pose, its covariance, and whether they fit at all."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Protocol

import numpy as np

from .. import _native, geometry
from ..likelihood.registration import Aligner, Target
from ..types import Float32, Float64, Pose
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


class Submaps(Protocol):
    """By their numbers."""

    def __getitem__(self, number: int, /) -> Submap: ...


class SubmapRegistration:
    """Generalised ICP between submaps (A. Segal, D. Haehnel, S. Thrun, RSS 2009)."""

    def __init__(self, submaps: Submaps, config: AlignConfig, threads: int = 0) -> None:
        self._submaps, self._config = submaps, config
        self._aligner = Aligner(config.icp_voxel, config.icp_max_correspondence, threads)
        self._prepared = lru_cache(maxsize=_PREPARED)(self._prepare)

    def fit(self, target: int, source: int, T_target_source: Pose) -> Fit | None:
        """Align two submaps, by number, from a first guess; None where ICP cannot."""
        there, back = self._prepared(target), self._prepared(source)
        if min(len(there.surface), len(back.surface)) < _LEAST_POINTS:
            return None
        radius = self._config.near_m
        found = self._aligner.register(there.target, back, T_target_source, radius)
        if found is None:
            return None
        T, shared = found.T_target_source, 0.0
        if min(there.count, back.count) >= _LEAST_POINTS:
            other, _ = back.target.overlap(there.sample, geometry.inverse(T), radius)
            shared = max(found.overlap, other)
        # No loop is believed to be more exact than this.
        least = np.repeat([np.radians(self._config.loop_deg), self._config.loop_m], 3) ** 2
        return Fit(T, found.covariance + np.diag(least), shared, found.shift_m)

    def _prepare(self, k: int) -> _Prepared:
        submap = self._submaps[k]
        index = _native.PointIndex(submap.structure, self._config.near_m)
        step = max(1, len(submap.structure) // _SAMPLE)
        sample = np.ascontiguousarray(submap.structure[::step])
        target = Target(self._aligner.surface(submap.surface), index)
        return _Prepared(target, sample, len(submap.structure))


@dataclass(frozen=True)
class _Prepared:
    """A submap as target and as source."""

    target: Target
    sample: Float32
    count: int

    @property
    def surface(self) -> _native.Surface:
        return self.target.surface
