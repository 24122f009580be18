"""Spinning LiDARs and their beam tables."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..errors import ConfigError
from ..types import Float32, Int64
from .ranging import Lidar


@dataclass(frozen=True, kw_only=True)
class SpinningLidar(Lidar):
    """A LiDAR whose column of beams turns about its z axis once a scan.

    Attributes
    ----------
    elevations_deg : tuple of float
        Of each beam above the sensor's x-y plane.
    azimuth_steps : int
        Firings of the column a turn.

    Raises
    ------
    ConfigError
        If a value is out of range.
    """

    elevations_deg: tuple[float, ...]
    azimuth_steps: int

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.elevations_deg or not max(abs(e) for e in self.elevations_deg) < 90:
            raise ConfigError("elevations_deg must name at least one beam within -90..90 degrees")
        if self.azimuth_steps < 1:
            raise ConfigError(f"azimuth_steps must be at least 1, not {self.azimuth_steps}")

    def rays(self, phase: float) -> tuple[Float32, Int64]:
        """Directions and beams, one column after another; ``phase`` is a share of one step."""
        azimuth = (np.arange(self.azimuth_steps) + phase) * (-2 * np.pi / self.azimuth_steps)
        elevation = np.radians(np.array(self.elevations_deg))
        flat = np.cos(elevation)
        x, y = np.outer(np.cos(azimuth), flat), np.outer(np.sin(azimuth), flat)
        z = np.broadcast_to(np.sin(elevation), x.shape)
        directions = np.stack([x, y, z], axis=-1).reshape(-1, 3).astype(np.float32)
        beams = np.tile(np.arange(len(elevation), dtype=np.int64), self.azimuth_steps)
        return directions, beams


def hdl64e(azimuth_steps: int = 2083) -> SpinningLidar:
    """Velodyne HDL-64E: 32 beams a third of a degree apart over 32 half a degree apart."""
    upper = tuple(2.0 - k / 3 for k in range(32))
    lower = tuple(-8.83 - k / 2 for k in range(32))
    return SpinningLidar(
        name="hdl64e",
        elevations_deg=upper + lower,
        azimuth_steps=azimuth_steps,
        beam_bias_sigma_m=0.016,
    )


def hdl32e(azimuth_steps: int = 2170) -> SpinningLidar:
    """Velodyne HDL-32E: 32 beams four thirds of a degree apart, -30.67 to 10.67 degrees."""
    return SpinningLidar(
        name="hdl32e",
        elevations_deg=tuple(-30.67 + k * 4 / 3 for k in range(32)),
        azimuth_steps=azimuth_steps,
        max_range_m=100.0,
        reference_range_m=150.0,
    )


def vlp16(azimuth_steps: int = 1800) -> SpinningLidar:
    """Velodyne VLP-16: 16 beams two degrees apart, -15 to 15 degrees."""
    return SpinningLidar(
        name="vlp16",
        elevations_deg=tuple(-15.0 + 2 * k for k in range(16)),
        azimuth_steps=azimuth_steps,
        min_range_m=0.5,
        max_range_m=100.0,
        range_sigma_m=0.03,
        reference_range_m=150.0,
    )
