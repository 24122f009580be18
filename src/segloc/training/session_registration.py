"""Sessions of one place, brought together where their poses drifted apart."""

from __future__ import annotations

import math

import numpy as np
from pydantic import BaseModel, ConfigDict, Field
from scipy.spatial import cKDTree

from .. import geometry
from ..registration import Aligner
from ..types import Float32, Pose

_LEAST_POINTS = 200


class RegisterConfig(BaseModel):
    """How local clouds are aligned with earlier sessions, and what is believed."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    radius_m: float = Field(40.0, gt=0, description="points around the sensor that are aligned")
    voxel_m: float = Field(0.5, gt=0)
    reach_m: float = Field(2.5, gt=0, description="largest distance of corresponding points")
    near_m: float = Field(0.6, gt=0, description="points count as met within this distance")
    max_shift_m: float = Field(4.0, gt=0, description="larger corrections are not believed")
    max_turn_deg: float = Field(4.0, gt=0)
    min_shared: float = Field(0.5, gt=0, le=1, description="share of points that must be met")


class Registration:
    """Corrects poses against the structure that earlier sessions saw.

    Parameters
    ----------
    structure : (N, 3) float32
        World frame.
    config : RegisterConfig

    Attributes
    ----------
    accepted, rejected, alone : int
        Local clouds that were aligned, that did not fit, and that no earlier session saw.
    """

    def __init__(self, structure: Float32, config: RegisterConfig | None = None) -> None:
        self.config = config or RegisterConfig()
        self._aligner = Aligner(self.config.voxel_m, self.config.reach_m, threads=1)
        self._surface = self._aligner.surface(structure)
        self._tree = cKDTree(structure) if len(structure) else None
        self._last: Pose | None = None  # the correction that was believed last, world frame
        self.accepted = self.rejected = self.alone = 0
        self.shifts_m: list[float] = []

    def corrected(self, T_world_local: Pose, surface: Float32) -> Pose:
        """The pose that aligns a local cloud's surface (N, 3); unchanged where none did before."""
        start = T_world_local if self._last is None else self._last @ T_world_local
        near = surface[(surface[:, :2] ** 2).sum(axis=1) < self.config.radius_m**2]
        if self._tree is None or self._met(start, near, 2 * self.config.near_m) < 0.2:
            self.alone += 1
            self._last = None
            return T_world_local
        found = self._aligned(start, near)
        if found is None or not self._believed(T_world_local, found, near):
            self.rejected += 1
            return start
        self.accepted += 1
        self._last = found @ geometry.inverse(T_world_local)
        self.shifts_m.append(float(np.linalg.norm(found[:3, 3] - T_world_local[:3, 3])))
        return found

    def _met(self, T: Pose, points: Float32, reach: float) -> float:
        """Share of the points with some of the structure within ``reach``."""
        if self._tree is None or len(points) < _LEAST_POINTS:
            return 0.0
        moved = geometry.transform(T, points[:: max(1, len(points) // 2000)])
        distances, _ = self._tree.query(moved, distance_upper_bound=reach)
        return float(np.isfinite(distances).mean())

    def _aligned(self, T: Pose, points: Float32) -> Pose | None:
        surface = self._aligner.surface(points)
        if min(len(self._surface), len(surface)) < _LEAST_POINTS:
            return None
        aligned = self._aligner.align(self._surface, surface, T)
        return None if aligned is None else aligned.T_target_source

    def _believed(self, before: Pose, after: Pose, points: Float32) -> bool:
        delta = geometry.inverse(before) @ after
        turn = math.degrees(geometry.rotation_angle(delta))
        if (
            np.linalg.norm(delta[:3, 3]) > self.config.max_shift_m
            or turn > self.config.max_turn_deg
        ):
            return False
        reach = self.config.near_m
        met = self._met(after, points, reach)
        return met >= self.config.min_shared and met >= self._met(before, points, reach) - 0.02
