"""Spinning LiDARs and their beam tables."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from segloc.errors import ConfigError

from .ranging import Lidar, Rays


@dataclass(frozen=True, kw_only=True)
class SpinningLidar(Lidar):
    """A LiDAR whose column of beams turns about its z axis once a scan.

    Attributes
    ----------
    elevations_deg : tuple of float
        Of each beam above the sensor's x-y plane.
    azimuth_steps : int
        Firings of the column a turn.
    azimuths_deg : tuple of float
        Of each beam to the left of its column; repeated where there are more beams.

    Raises
    ------
    ConfigError
        If a value is out of range.
    """

    elevations_deg: tuple[float, ...]
    azimuth_steps: int
    azimuths_deg: tuple[float, ...] = (0.0,)

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.elevations_deg or not max(abs(e) for e in self.elevations_deg) < 90:
            raise ConfigError("elevations_deg must name at least one beam within -90..90 degrees")
        if not self.azimuths_deg or not max(abs(a) for a in self.azimuths_deg) <= 180:
            raise ConfigError("azimuths_deg must name at least one angle within -180..180 degrees")
        if self.azimuth_steps < 1:
            raise ConfigError(f"azimuth_steps must be at least 1, not {self.azimuth_steps}")

    def rays(self, phase: float, number: int = 0) -> Rays:
        """One column after another; ``phase`` is a share of one step."""
        turn = -2 * np.pi * (np.arange(self.azimuth_steps) + phase) / self.azimuth_steps
        elevation = np.radians(np.array(self.elevations_deg))
        azimuth = turn[:, None] + np.radians(np.array(self.azimuths_deg))
        column = np.arange(len(elevation)) % len(self.azimuths_deg)
        flat = np.cos(elevation)
        directions = np.empty((len(turn), len(elevation), 3), dtype=np.float32)
        directions[..., 0] = np.cos(azimuth)[:, column] * flat
        directions[..., 1] = np.sin(azimuth)[:, column] * flat
        directions[..., 2] = np.sin(elevation)
        times = np.arange(self.azimuth_steps) / (self.azimuth_steps * self.rate_hz)
        return Rays(directions.reshape(-1, 3), times)

    def thinned(self, factor: int) -> SpinningLidar:
        return replace(self, azimuth_steps=self._fewer(self.azimuth_steps, factor, 1))


def hdl64e(azimuth_steps: int = 2083) -> SpinningLidar:
    """Velodyne HDL-64E: 32 beams a third of a degree apart over 32 half a degree apart."""
    upper = tuple(2.0 - k / 3 for k in range(32))
    lower = tuple(-8.83 - k / 2 for k in range(32))
    return SpinningLidar(
        name="hdl64e",
        elevations_deg=upper + lower,
        azimuth_steps=azimuth_steps,
        beam_bias_sigma_m=0.016,
        divergence_mrad=2.0,
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


def os1_64(azimuth_steps: int = 1024) -> SpinningLidar:
    """Ouster OS1-64: 64 beams evenly over -16.6 to 16.6 degrees, in four staggered columns."""
    return _ouster("os1-64", 64, 16.6, 3.164, azimuth_steps)


def os1_128(azimuth_steps: int = 1024) -> SpinningLidar:
    """Ouster OS1-128: 128 beams evenly over -22.5 to 22.5 degrees, in four staggered columns."""
    return _ouster("os1-128", 128, 22.5, 4.23, azimuth_steps)


def os0_128(azimuth_steps: int = 1024) -> SpinningLidar:
    """Ouster OS0-128: 128 beams evenly over -45 to 45 degrees, in four staggered columns.

    Field of view, beam divergence (0.35 degrees) and ranges (35 m at 10 %, 75 m at 80 %) after
    Ouster's "OS0 Ultra-Wide View High-Resolution Imaging Lidar", Rev7.
    """
    usual = _ouster("os0-128", 128, 45.0, 11.0, azimuth_steps)
    return replace(usual, max_range_m=100.0, reference_range_m=100.0, divergence_mrad=6.1)


def _ouster(
    name: str, beams: int, half_view_deg: float, stagger_deg: float, azimuth_steps: int
) -> SpinningLidar:
    step = 2 * half_view_deg / (beams - 1)
    return SpinningLidar(
        name=name,
        elevations_deg=tuple(half_view_deg - k * step for k in range(beams)),
        azimuths_deg=tuple(stagger_deg * share for share in (1, 1 / 3, -1 / 3, -1)),
        azimuth_steps=azimuth_steps,
        min_range_m=0.5,
        range_sigma_m=0.025,
        reference_range_m=160.0,
        divergence_mrad=3.1,
    )
