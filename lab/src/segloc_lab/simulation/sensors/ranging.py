"""What every simulated LiDAR shares: range noise, lost and mixed returns, glass."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

from segloc.errors import ConfigError
from segloc.types import Float32, Float64, Pose

from ..objects.identity import Int32
from ..objects.mesh import GLASS
from ..objects.scene import Hits, Scene
from .echoes import mix_echoes

_DIRTY, _MIRRORED = 0.25, 0.02  # shares of the panes
_THROUGH_TWICE, _MIRRORED_TWICE = 0.7, 0.03  # of the light, there and back
_SKIN = 2e-3  # where a ray goes on behind a pane, metres

Self = TypeVar("Self", bound="Lidar")
PosesAt: TypeAlias = Callable[[Float64], Float64]


class Rays(NamedTuple):
    """The rays of one scan: F firings of B beams each, one firing after another.

    Attributes
    ----------
    directions : (F * B, 3) float32
        Unit vectors, sensor frame.
    times : (F,) float64
        When each firing is, seconds from the start of the scan; rising.
    """

    directions: Float32
    times: Float64

    @property
    def beams_a_firing(self) -> int:
        return len(self.directions) // len(self.times)


class Returns(NamedTuple):
    """What a sensor reports of one scan.

    Attributes
    ----------
    points : (N, 3) float32
        Metres, in the frame that the sensor has when it takes each point.
    object_ids : (N,) int32
        Which object each point lies on; -1 for ghosts, which were mirrored by glass.
    times : (N,) float64
        Seconds from the start of the scan.
    """

    points: Float32
    object_ids: Int32
    times: Float64


@dataclass(frozen=True, kw_only=True)
class Lidar(ABC):
    """A LiDAR: rays from one origin, and what becomes of them.

    A return of reflectance rho at range r and angle of incidence theta is found with probability
    1 / (1 + s**-4). Its strength relative to the detection threshold is
    s = rho * cos(theta)**incidence_exponent * (reference_range_m / r)**2. The exponent is below one
    because rough surfaces send light back at grazing angles too.

    Of the panes of glass a quarter are dirty enough to be seen. A few mirror the rays, which then
    report what they meet next as if it lay behind the glass (often below the ground). Through all
    others the sensor sees what is behind, if anything.

    A beam is a cone. Where it meets an edge, the sensor gets light back from both sides of it and
    reports the stronger echo, or a point between the two where they are too close to tell apart.

    Attributes
    ----------
    name : str
    min_range_m, max_range_m : float
        Returns outside are not reported.
    range_sigma_m : float
        Standard deviation of a range.
    beam_bias_sigma_m : float
        Standard deviation, over the beams, of the error that each beam makes all the time.
    reference_range_m : float
        Where a white surface square to the beam is still found half of the time; infinite for a
        sensor that loses nothing.
    incidence_exponent : float
    glass : bool
        Whether glass is glass, or like any other surface.
    divergence_mrad : float
        Opening angle of a beam; 0 for rays without width.
    rate_hz : float
        Scans a second.
    mount_height_m : float
        Of the sensor above the ground.
    unit : int
        Serial number: which beams are biased how.

    Raises
    ------
    ConfigError
        If a value is out of range.
    """

    name: str
    min_range_m: float = 1.0
    max_range_m: float = 120.0
    range_sigma_m: float = 0.02
    beam_bias_sigma_m: float = 0.005
    reference_range_m: float = 200.0
    incidence_exponent: float = 0.35
    glass: bool = True
    divergence_mrad: float = 3.0
    rate_hz: float = 10.0
    mount_height_m: float = 1.73
    unit: int = 0

    def __post_init__(self) -> None:
        if not 0 <= self.min_range_m < self.max_range_m:
            raise ConfigError(
                "min_range_m and max_range_m must rise from 0, "
                f"not {self.min_range_m}, {self.max_range_m}"
            )
        not_negative = ("range_sigma_m", "beam_bias_sigma_m", "incidence_exponent")
        for name in (*not_negative, "divergence_mrad", "unit"):
            if not getattr(self, name) >= 0:
                raise ConfigError(f"{name} must not be negative, not {getattr(self, name)}")
        for name in ("reference_range_m", "mount_height_m", "rate_hz"):
            if not getattr(self, name) > 0:
                raise ConfigError(f"{name} must be positive, not {getattr(self, name)}")

    @abstractmethod
    def rays(self, phase: float, number: int = 0) -> Rays:
        """The rays of a scan.

        Parameters
        ----------
        phase : float
            In [0, 1): where the pattern starts, for sensors that start anywhere.
        number : int
            How many scans went before, for sensors whose pattern goes on from scan to scan.
        """

    @abstractmethod
    def thinned(self: Self, factor: int) -> Self:
        """The same sensor with about every ``factor``-th firing: faster scans of fewer points.

        Raises
        ------
        ConfigError
            If the factor is below 1.
        """

    @staticmethod
    def _fewer(firings: int, factor: int, least: int) -> int:
        if factor < 1:
            raise ConfigError(f"factor must be at least 1, not {factor}")
        return max(least, round(firings / factor))

    def ideal(self: Self) -> Self:
        """The same rays without noise, lost or mixed returns, or glass."""
        return replace(
            self,
            range_sigma_m=0.0,
            beam_bias_sigma_m=0.0,
            reference_range_m=np.inf,
            glass=False,
            divergence_mrad=0.0,
        )

    def scan(
        self, scene: Scene, T_world_sensor: Pose, rng: np.random.Generator
    ) -> tuple[Float32, Int32]:
        """Points and object ids of one scan from a sensor at rest, as :meth:`take` has them."""
        returns = self.take(scene, T_world_sensor, rng)
        return returns.points, returns.object_ids

    def take(
        self,
        scene: Scene,
        T_world_sensor: Pose | PosesAt,
        rng: np.random.Generator,
        number: int = 0,
    ) -> Returns:
        """One scan, from a sensor at rest or from one that moves while it scans.

        Parameters
        ----------
        scene : Scene
        T_world_sensor : (4, 4) float64, or callable
            Of a sensor that moves: the poses (F, 4, 4) at times (F,), seconds from the start of
            the scan.
        rng : Generator
            Decides phase, noise and lost returns; the same state gives the same scan.
        number : int
            How many scans went before.
        """
        rays = self.rays(rng.random(), number)
        poses = T_world_sensor(rays.times) if callable(T_world_sensor) else T_world_sensor
        T = np.asarray(poses, dtype=np.float32).reshape(-1, 4, 4)  # one, or one a firing
        local = rays.directions.reshape(len(rays.times), -1, 3)
        ways = local @ T[:, :3, :3].transpose(0, 2, 1)
        origins = np.broadcast_to(T[:, None, :3, 3], ways.shape).reshape(-1, 3)
        ways = ways.reshape(-1, 3)
        return self._measure(scene, rays, origins, ways, rng)

    def _measure(
        self, scene: Scene, rays: Rays, origins: Float32, ways: Float32, rng: np.random.Generator
    ) -> Returns:
        hits = scene.cast(origins, ways, self.max_range_m)
        if self.glass:
            self._meet_glass(scene, origins, ways, hits)
        beams = rays.beams_a_firing
        noise = rng.standard_normal((len(rays.times), beams), dtype=np.float32)
        noise *= np.float32(self.range_sigma_m)
        bias = np.random.default_rng([self.unit, 23]).normal(0.0, self.beam_bias_sigma_m, beams)
        noise += bias.astype(np.float32)
        draw = rng.random(len(ways), dtype=np.float32)
        if self.divergence_mrad > 0:
            mix_echoes(hits, ways, beams, self.divergence_mrad / 1000, rng)
        measured = hits.ranges + noise.reshape(-1)
        kept = self._returned(hits, draw)
        kept &= (measured >= self.min_range_m) & (measured <= self.max_range_m)
        found = np.flatnonzero(kept)
        return Returns(
            rays.directions[found] * measured[found, None],
            hits.object_ids[found],
            rays.times[found // beams],
        )

    def _meet_glass(self, scene: Scene, origins: Float32, ways: Float32, hits: Hits) -> None:
        """Follow rays through panes or off them; changes ``hits`` in place."""
        pane = np.flatnonzero(hits.material == GLASS)
        kind = hits.lots[pane]
        pane, kind = pane[kind > _DIRTY], kind[kind > _DIRTY]
        mirrored = kind > 1 - _MIRRORED
        way, normal = ways[pane], hits.normals[pane]
        bounced = way - 2 * np.einsum("ij,ij->i", way, normal)[:, None] * normal
        onward = np.where(mirrored[:, None], bounced, way).astype(np.float32)
        start = origins[pane] + way * hits.ranges[pane, None] + onward * np.float32(_SKIN)
        behind = scene.cast(start, onward, self.max_range_m)
        lost = behind.material == GLASS
        left = np.where(mirrored, np.float32(_MIRRORED_TWICE), np.float32(_THROUGH_TWICE))
        hits.ranges[pane] += np.where(lost, np.float32(np.inf), behind.ranges + np.float32(_SKIN))
        hits.object_ids[pane] = np.where(mirrored, -1, behind.object_ids)
        hits.reflectance[pane] = behind.reflectance * left
        hits.cosines[pane] = behind.cosines
        hits.normals[pane] = behind.normals

    def _returned(self, hits: Hits, draw: Float32) -> NDArray[np.bool_]:
        found = np.isfinite(hits.ranges)
        if np.isinf(self.reference_range_m):
            return found
        far = np.where(found, hits.ranges, np.float32(1.0)) / np.float32(self.reference_range_m)
        strength = hits.reflectance * hits.cosines ** np.float32(self.incidence_exponent) / far**2
        square = np.clip(strength, np.float32(1e-4), np.float32(1e4)) ** 2
        return np.asarray(found & (draw * (1 + 1 / square**2) < 1))
