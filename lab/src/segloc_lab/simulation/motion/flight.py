"""How a drone flies along a line on the map."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.transform import Rotation

from segloc.errors import ConfigError
from segloc.types import Float64

from ..objects.terrain import Terrain
from .gait import slow

_CLIMB_M = 40.0  # of way over which its height is alike
_GUST_S = 1.2
_GRAVITY = 9.81


@dataclass(frozen=True, kw_only=True)
class Flight:
    """Where a drone keeps above ground, and how it tilts.

    Attributes
    ----------
    low_m, high_m : float
        It stays between these above the ground.
    cruise_deg : float
        It pitches forward by so much to keep its speed.
    gust_deg : float
        Standard deviation of roll and pitch in the wind.

    Raises
    ------
    ConfigError
        If the heights do not rise from 0, or a tilt is negative.
    """

    low_m: float = 5.0
    high_m: float = 30.0
    cruise_deg: float = 5.0
    gust_deg: float = 1.5

    def __post_init__(self) -> None:
        if not 0 < self.low_m < self.high_m < np.inf:
            raise ConfigError(f"low_m and high_m must rise from 0, not {self.low_m}, {self.high_m}")
        for name in ("cruise_deg", "gust_deg"):
            if not 0 <= getattr(self, name) < 45:
                raise ConfigError(f"{name} must be in 0..45, not {getattr(self, name)}")

    def poses(
        self,
        terrain: Terrain,
        xy: Float64,
        yaw: Float64,
        distance: Float64,
        stamps: Float64,
        rng: np.random.Generator,
    ) -> Float64:
        """Poses (N, 4, 4) at points (N, 2) and headings (N,), banked as its bends demand.

        ``distance`` (N,) is how far it has flown at evenly spaced ``stamps`` (N,).
        """
        T = np.tile(np.eye(4), (len(xy), 1, 1))
        speed = np.gradient(distance, stamps)
        turning = gaussian_filter1d(np.gradient(np.unwrap(yaw), stamps), 0.4 / stamps[1])
        tilt = np.radians(self.gust_deg) * slow(rng, stamps, _GUST_S)[:, :2]
        tilt[:, 0] -= np.arctan(speed * turning / _GRAVITY)
        tilt[:, 1] += np.radians(self.cruise_deg) * speed / speed.max()
        angles = np.column_stack([yaw, tilt[:, 1], tilt[:, 0]])
        T[:, :3, :3] = Rotation.from_euler("ZYX", angles).as_matrix()
        T[:, :2, 3] = xy
        T[:, 2, 3] = terrain.height(*xy.T) + self._heights(distance, rng)
        return T

    def _heights(self, distance: Float64, rng: np.random.Generator) -> Float64:
        """Above ground: a smooth curve that uses all of the band on a long flight."""
        even = np.arange(-4 * _CLIMB_M, distance[-1] + 4 * _CLIMB_M, 1.0)
        curve = np.tanh(slow(rng, even, _CLIMB_M)[:, 0])
        middle, half = (self.low_m + self.high_m) / 2, (self.high_m - self.low_m) / 2
        return np.asarray(middle + half * np.interp(distance, even, curve), dtype=np.float64)
