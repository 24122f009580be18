"""What is measured at a refined pose when the verdict first asks for it: most are never asked."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from .. import _native
from ..registration import Target
from ..types import Float32, Pose
from .config import VerificationConfig
from .walls import SurfaceFit, surface_fit

_SECTORS, _FEWEST = 12, 40
"""Directions that are compared by themselves, and the points that each must have."""


class Query(Protocol):
    """What is compared with the map: a surface, and a sample of the cloud by direction."""

    @property
    def surface(self) -> _native.Surface: ...
    @property
    def sectors(self) -> list[Float32]: ...


class MeasuredDetails:
    """How walls and directions fit at a pose; each is measured once, when it is needed.

    Parameters
    ----------
    target : Target
        The map's cloud.
    query : Query
    T : (4, 4) float64
        Takes the query to the frame of the map's cloud.
    config : VerificationConfig
    """

    def __init__(self, target: Target, query: Query, T: Pose, config: VerificationConfig) -> None:
        self._target, self._query, self._T, self._config = target, query, T, config
        self._fit: SurfaceFit | None = None
        self._sectors: tuple[float, ...] | None = None

    @property
    def fit(self) -> SurfaceFit:
        """How well walls and ground fit."""
        if self._fit is None:
            surface, offset = self._query.surface, self._config.wall_offset
            self._fit = surface_fit(self._target.surface, surface, self._T, offset)
        return self._fit

    @property
    def sectors(self) -> tuple[float, ...]:
        """The overlap of each direction by itself; NaN where there is too little."""
        if self._sectors is None:
            radius = self._config.overlap_radius
            self._sectors = tuple(
                self._target.overlap(part, self._T, radius)[0] if len(part) else np.nan
                for part in self._query.sectors
            )
        return self._sectors


def by_sector(points: Float32) -> list[Float32]:
    """(N, 3) points in each direction about the sensor; none where there are too few."""
    azimuth = np.arctan2(points[:, 1], points[:, 0])
    which = np.floor((azimuth / (2.0 * np.pi) + 0.5) * _SECTORS).astype(np.int64) % _SECTORS
    parts = [np.ascontiguousarray(points[which == k]) for k in range(_SECTORS)]
    return [part if len(part) >= _FEWEST else part[:0] for part in parts]
