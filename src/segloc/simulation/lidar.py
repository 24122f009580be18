"""Spinning LiDARs: beam tables, range noise, and which returns are lost."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..errors import ConfigError
from ..types import Float32, Pose
from .worlds import Hits, Int32, Scene


@dataclass(frozen=True)
class SpinningLidar:
    """A LiDAR whose column of beams turns about its z axis once a scan.

    A return of reflectance rho at range r and angle of incidence theta is found with probability
    1 / (1 + s**-4). Its strength relative to the detection threshold is
    s = rho * cos(theta)**incidence_exponent * (reference_range_m / r)**2. The exponent is below one
    because rough surfaces send light back at grazing angles too.

    Attributes
    ----------
    name : str
    elevations_deg : tuple of float
        Of each beam above the sensor's x-y plane.
    azimuth_steps : int
        Firings of the column a turn.
    min_range_m, max_range_m : float
        Returns outside are not reported.
    range_sigma_m : float
        Standard deviation of a range.
    reference_range_m : float
        Where a white surface square to the beam is still found half of the time; infinite for a
        sensor that loses nothing.
    incidence_exponent : float
    mount_height_m : float
        Of the sensor above the ground.

    Raises
    ------
    ConfigError
        If a value is out of range.
    """

    name: str
    elevations_deg: tuple[float, ...]
    azimuth_steps: int
    min_range_m: float = 1.0
    max_range_m: float = 120.0
    range_sigma_m: float = 0.02
    reference_range_m: float = 200.0
    incidence_exponent: float = 0.35
    mount_height_m: float = 1.73

    def __post_init__(self) -> None:
        if not self.elevations_deg or max(abs(e) for e in self.elevations_deg) >= 90:
            raise ConfigError(
                "elevations_deg must name at least one beam, each within -90..90 degrees"
            )
        if self.azimuth_steps < 1:
            raise ConfigError(f"azimuth_steps must be at least 1, not {self.azimuth_steps}")
        if not 0 <= self.min_range_m < self.max_range_m:
            raise ConfigError(
                "min_range_m and max_range_m must rise from 0, "
                f"not {self.min_range_m}, {self.max_range_m}"
            )
        if not self.range_sigma_m >= 0:
            raise ConfigError(f"range_sigma_m must not be negative, not {self.range_sigma_m}")
        if not self.reference_range_m > 0:
            raise ConfigError(f"reference_range_m must be positive, not {self.reference_range_m}")
        if not self.mount_height_m > 0:
            raise ConfigError(f"mount_height_m must be positive, not {self.mount_height_m}")

    @property
    def rays(self) -> int:
        """Rays a scan."""
        return len(self.elevations_deg) * self.azimuth_steps

    def ideal(self) -> SpinningLidar:
        """The same beams without noise or lost returns."""
        return replace(self, range_sigma_m=0.0, reference_range_m=np.inf)

    def directions(self, phase: float = 0.0) -> Float32:
        """Unit vectors (rays, 3) in the sensor frame, one column of beams after another.

        ``phase`` in [0, 1) shifts all azimuths by that share of a step.
        """
        azimuth = (np.arange(self.azimuth_steps) + phase) * (-2 * np.pi / self.azimuth_steps)
        elevation = np.radians(np.array(self.elevations_deg))
        flat = np.cos(elevation)
        x, y = np.outer(np.cos(azimuth), flat), np.outer(np.sin(azimuth), flat)
        z = np.broadcast_to(np.sin(elevation), x.shape)
        return np.stack([x, y, z], axis=-1).reshape(-1, 3).astype(np.float32)

    def scan(
        self, scene: Scene, T_world_sensor: Pose, rng: np.random.Generator
    ) -> tuple[Float32, Int32]:
        """One turn from a sensor at rest.

        Parameters
        ----------
        scene : Scene
        T_world_sensor : (4, 4) float64
        rng : Generator
            Decides phase, noise and lost returns; the same state gives the same scan.

        Returns
        -------
        points : (N, 3) float32
            Sensor frame, metres.
        object_ids : (N,) int32
            Which object each point lies on.
        """
        local = self.directions(rng.random())
        R = np.asarray(T_world_sensor, dtype=np.float32)
        origins = np.broadcast_to(R[:3, 3], local.shape)
        hits = scene.cast(origins, local @ R[:3, :3].T, self.max_range_m)
        noise = rng.normal(0.0, 1.0, len(local)).astype(np.float32) * np.float32(self.range_sigma_m)
        measured = hits.ranges + noise
        kept = self._returned(hits, rng.random(len(local), dtype=np.float32))
        kept &= (measured >= self.min_range_m) & (measured <= self.max_range_m)
        return local[kept] * measured[kept, None], hits.object_ids[kept]

    def _returned(self, hits: Hits, draw: Float32) -> NDArray[np.bool_]:
        found = hits.object_ids >= 0
        if np.isinf(self.reference_range_m):
            return found
        far = np.where(found, hits.ranges, np.float32(1.0)) / np.float32(self.reference_range_m)
        strength = hits.reflectance * hits.cosines ** np.float32(self.incidence_exponent) / far**2
        return np.asarray(found & (draw * (1 + np.maximum(strength, 1e-4) ** -4) < 1))


def hdl64e(azimuth_steps: int = 2083) -> SpinningLidar:
    """Velodyne HDL-64E: 32 beams a third of a degree apart over 32 half a degree apart."""
    upper = tuple(2.0 - k / 3 for k in range(32))
    lower = tuple(-8.83 - k / 2 for k in range(32))
    return SpinningLidar("hdl64e", upper + lower, azimuth_steps)


def hdl32e(azimuth_steps: int = 2170) -> SpinningLidar:
    """Velodyne HDL-32E: 32 beams four thirds of a degree apart, -30.67 to 10.67 degrees."""
    beams = tuple(-30.67 + k * 4 / 3 for k in range(32))
    return SpinningLidar("hdl32e", beams, azimuth_steps, max_range_m=100.0, reference_range_m=150.0)


def vlp16(azimuth_steps: int = 1800) -> SpinningLidar:
    """Velodyne VLP-16: 16 beams two degrees apart, -15 to 15 degrees."""
    beams = tuple(-15.0 + 2 * k for k in range(16))
    return SpinningLidar(
        "vlp16",
        beams,
        azimuth_steps,
        min_range_m=0.5,
        max_range_m=100.0,
        range_sigma_m=0.03,
        reference_range_m=150.0,
    )
