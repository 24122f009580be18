"""Register sessions of one place with drifting poses."""

from __future__ import annotations

import math
from dataclasses import dataclass

from pydantic import Field

from segloc import geometry
from segloc.likelihood import Aligner, Alignment, Target, thinned
from segloc.system import kernels
from segloc.system.section import Section
from segloc.types import Float32, Pose

_MIN_POINTS = 200
_SAMPLE = 2000
MIN_OVERLAP = 0.2
"""Local clouds that overlap the structure less are of a place new to earlier sessions."""


class RegisterConfig(Section):
    """Settings of the registration of local clouds with earlier sessions."""

    radius_m: float = Field(40.0, gt=0, description="range of points around the sensor")
    voxel_m: float = Field(0.5, gt=0)
    max_correspondence_m: float = Field(2.5, gt=0, description="longest correspondence")
    near_m: float = Field(0.6, gt=0, description="maximum distance of overlapping points")
    max_shift_m: float = Field(4.0, gt=0, description="maximum correction")
    max_turn_deg: float = Field(4.0, gt=0)
    min_shared: float = Field(0.5, gt=0, le=1, description="minimum share of overlapping points")


class Registration:
    """Correct poses by the structure of earlier sessions.

    Parameters
    ----------
    structure : (N, 3) float32
        World frame.

    Attributes
    ----------
    accepted, rejected, alone : int
        Local clouds that were aligned, that did not match, and without earlier structure.
    """

    def __init__(self, structure: Float32) -> None:
        self.config = RegisterConfig()
        self._aligner = Aligner(self.config.voxel_m, self.config.max_correspondence_m, threads=1)
        index = kernels.PointIndex(structure, 2 * self.config.near_m)
        self._target = Target(self._aligner.surface(structure), index)
        self._seen = len(structure) > 0
        self._last: Pose | None = None  # the last accepted correction, world frame
        self.accepted = self.rejected = self.alone = 0
        self.shifts_m: list[float] = []

    def corrected(self, T_world_local: Pose, surface: Float32) -> Pose:
        """Return the pose that aligns a local cloud's surface (N, 3); unchanged if it is new."""
        start = T_world_local if self._last is None else self._last @ T_world_local
        near = surface[(surface[:, :2] ** 2).sum(axis=1) < self.config.radius_m**2]
        source = _Source(self._aligner.surface(near), thinned(near, _SAMPLE))
        if not self._seen or self._met(start, source, 2 * self.config.near_m) < MIN_OVERLAP:
            self.alone += 1
            self._last = None
            return T_world_local
        found = self._registered(start, source)
        if found is None or not self._believed(T_world_local, found, source):
            self.rejected += 1
            return start
        T = found.T_target_source
        self.accepted += 1
        self._last = T @ geometry.inverse(T_world_local)
        self.shifts_m.append(found.shift_m(T_world_local))
        return T

    def _met(self, T: Pose, source: _Source, radius: float) -> float:
        """Return the share of points with structure within a radius."""
        if len(source.sample) < _MIN_POINTS:
            return 0.0
        return self._target.overlap(source.sample, T, radius)

    def _registered(self, T: Pose, source: _Source) -> Alignment | None:
        if min(len(self._target.surface), len(source.surface)) < _MIN_POINTS:
            return None
        return self._aligner.align(self._target.surface, source.surface, T)

    def _believed(self, before: Pose, found: Alignment, source: _Source) -> bool:
        delta = geometry.inverse(before) @ found.T_target_source
        turn = math.degrees(geometry.rotation_angle(delta))
        if found.shift_m(before) > self.config.max_shift_m or turn > self.config.max_turn_deg:
            return False
        met = self._met(found.T_target_source, source, self.config.near_m)
        earlier = self._met(before, source, self.config.near_m)
        return met >= self.config.min_shared and met >= earlier - 0.02


@dataclass(frozen=True)
class _Source:
    surface: kernels.Surface
    sample: Float32
