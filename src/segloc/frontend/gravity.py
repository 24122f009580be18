"""The direction of gravity in a scan, estimated from floors, ceilings and walls."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from pydantic import Field

from .. import _native, geometry
from ..system.section import Section
from ..types import Float32, Float64

_Z = np.array([0.0, 0.0, 1.0])
_STEP_DEG = 4.0
_TOLERANCES_RAD = tuple(math.radians(deg) for deg in (10.0, 7.0, 5.0, 4.0, 3.0, 3.0, 3.0))
_CORRELATED = 13.0
"""Neighbouring normals with a common error, as those of one plane have."""
_MIN_NEIGHBOURS = 10
_MAX_THICKNESS_M = 0.05
_MAX_NORMALS = 2000
"""More normals change the attitude by less than its uncertainty."""


class AttitudeConfig(Section):
    """Estimation of roll and pitch of single scans without odometry or gravity."""

    estimate: bool = Field(
        True,
        description="estimate roll and pitch from the scan; otherwise the scan counts as level",
    )
    max_tilt_deg: float = Field(
        40.0,
        ge=0,
        le=80,
        description="largest angle of the vertical to the sensor's z axis, or to that of its mount",
    )
    radius_m: float = Field(
        30.0,
        ge=1,
        le=1000,
        description="range of the points used; more if most points are farther",
    )
    voxel_size: float = Field(
        0.25, ge=0.01, le=10, description="voxel size of these points, metres"
    )
    support_m: float = Field(
        1.0, ge=0.01, le=100, description="radius of the neighbourhood of a normal, metres"
    )
    min_normals: int = Field(60, ge=3, le=10**6, description="normals of flat surfaces needed")
    max_sigma_deg: float = Field(
        3.0, gt=0, le=90, description="largest standard deviation of a used estimate, degrees"
    )


@dataclass(frozen=True)
class Attitude:
    """Direction of gravity in a scan.

    Attributes
    ----------
    up : (3,) float64
        Unit vector against gravity, in the sensor's frame.
    sigma_deg : float
        Standard deviation in the least certain direction [deg].
    """

    up: Float64
    sigma_deg: float

    @property
    def tilt_deg(self) -> float:
        """Angle between the sensor's z axis and the vertical [deg]."""
        return angle_deg(self.up, _Z)


def angle_deg(a: Float64, b: Float64) -> float:
    """Return the angle between two (3,) vectors [deg]; exact for small angles too."""
    return math.degrees(math.atan2(float(np.linalg.norm(np.cross(a, b))), float(a @ b)))


class AttitudeEstimator:
    """Estimates the vertical: normal to floors and ceilings, parallel to walls.

    Normals of flat patches vote for directions on a grid around the expected vertical. The best
    direction is refined by least squares over the normals that agree, with a shrinking tolerance.
    """

    def __init__(self, config: AttitudeConfig | None = None) -> None:
        self.config = config or AttitudeConfig()
        self._grid = _directions(self.config.max_tilt_deg)

    def estimate(self, points: Float32, expected: Float64 = _Z) -> Attitude | None:
        """Estimate the attitude of the sensor; None if too few flat surfaces are in view.

        Parameters
        ----------
        points : (N, 3) float32
            Sensor frame.
        expected : (3,) float64
            Unit vector: the approximate vertical. The estimate lies within ``max_tilt_deg`` of it.
        """
        normals = self.normals(points)
        if len(normals) < self.config.min_normals:
            return None
        grid = self._grid @ geometry.upright(expected)[:3, :3]
        found = _refine(normals, _native.fit_vertical(normals, grid, _TOLERANCES_RAD[:-1]))
        off = angle_deg(found.up, expected)
        if off > self.config.max_tilt_deg or found.sigma_deg > self.config.max_sigma_deg:
            return None
        return found

    def normals(self, points: Float32) -> Float32:
        """Return the unit normals, of either sign, of flat patches near the sensor, (M, 3).

        Parameters
        ----------
        points : (N, 3) float32
            Sensor frame.
        """
        config = self.config
        return _native.flat_normals(
            points,
            config.radius_m,
            config.voxel_size,
            config.support_m,
            _MIN_NEIGHBOURS,
            _MAX_THICKNESS_M,
            _MAX_NORMALS,
        )


def _directions(max_tilt_deg: float) -> Float64:
    """Return unit vectors spread about evenly over the cap around z."""
    rings = [np.array([[0.0, 0.0, 1.0]])]
    for tilt in np.radians(np.arange(_STEP_DEG, max_tilt_deg + _STEP_DEG / 2, _STEP_DEG)):
        count = max(6, round(2 * math.pi * math.sin(tilt) / math.radians(_STEP_DEG)))
        turn = 2 * math.pi * np.arange(count) / count
        ring = [math.sin(tilt) * np.cos(turn), math.sin(tilt) * np.sin(turn)]
        rings.append(np.stack([*ring, np.full(count, math.cos(tilt))], axis=1))
    return np.concatenate(rings)


def _refine(normals: Float32, up: Float64) -> Attitude:
    """Fit the direction parallel to floor normals and normal to wall normals, with its error."""
    tolerance, exact = _TOLERANCES_RAD[-1], normals.astype(np.float64)
    along = np.abs(exact @ up)
    floors, walls = exact[along > math.cos(tolerance)], exact[along < math.sin(tolerance)]
    values, axes = np.linalg.eigh(walls.T @ walls - floors.T @ floors)
    up = axes[:, 0] * (1.0 if axes[:, 0] @ up > 0 else -1.0)
    residual = float(values[0]) + len(floors)  # sum of squared sines
    count = len(floors) + len(walls)
    curvature = float(values[1] - values[0])
    if count < 3 or curvature <= 0.0:
        return Attitude(up, math.inf)
    variance = max(residual, 0.0) / count / curvature
    return Attitude(up, math.degrees(math.sqrt(_CORRELATED * variance)))
