"""What every simulated LiDAR shares: range noise, lost returns, glass."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from ..errors import ConfigError
from ..types import Float32, Int64, Pose
from .mesh import GLASS
from .worlds import Hits, Int32, Scene

_DIRTY, _MIRRORED = 0.25, 0.02  # shares of the panes
_THROUGH_TWICE, _MIRRORED_TWICE = 0.7, 0.03  # of the light, there and back
_SKIN = 2e-3  # where a ray goes on behind a pane, metres

Self = TypeVar("Self", bound="Lidar")


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
    mount_height_m: float = 1.73
    unit: int = 0

    def __post_init__(self) -> None:
        if not 0 <= self.min_range_m < self.max_range_m:
            raise ConfigError(
                "min_range_m and max_range_m must rise from 0, "
                f"not {self.min_range_m}, {self.max_range_m}"
            )
        for name in ("range_sigma_m", "beam_bias_sigma_m", "incidence_exponent", "unit"):
            if not getattr(self, name) >= 0:
                raise ConfigError(f"{name} must not be negative, not {getattr(self, name)}")
        for name in ("reference_range_m", "mount_height_m"):
            if not getattr(self, name) > 0:
                raise ConfigError(f"{name} must be positive, not {getattr(self, name)}")

    @abstractmethod
    def rays(self, phase: float) -> tuple[Float32, Int64]:
        """Unit directions (R, 3) in the sensor frame, and the beam that sends each ray, (R,).

        ``phase`` in [0, 1) says where in its pattern the sensor starts.
        """

    def ideal(self: Self) -> Self:
        """The same rays without noise, lost returns or glass."""
        return replace(
            self, range_sigma_m=0.0, beam_bias_sigma_m=0.0, reference_range_m=np.inf, glass=False
        )

    def scan(
        self, scene: Scene, T_world_sensor: Pose, rng: np.random.Generator
    ) -> tuple[Float32, Int32]:
        """One scan from a sensor at rest.

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
            Which object each point lies on; -1 for ghosts, which were mirrored by glass.
        """
        local, beam = self.rays(rng.random())
        T = np.asarray(T_world_sensor, dtype=np.float32)
        origins = np.ascontiguousarray(np.broadcast_to(T[:3, 3], local.shape))
        ways = local @ T[:3, :3].T
        hits = scene.cast(origins, ways, self.max_range_m)
        if self.glass:
            self._meet_glass(scene, origins, ways, hits)
        bias = np.random.default_rng([self.unit, 23]).normal(0, 1, int(beam.max()) + 1)
        noise = (
            rng.normal(0.0, self.range_sigma_m, len(local)) + self.beam_bias_sigma_m * bias[beam]
        )
        measured = hits.ranges + noise.astype(np.float32)
        kept = self._returned(hits, rng.random(len(local), dtype=np.float32))
        kept &= (measured >= self.min_range_m) & (measured <= self.max_range_m)
        return local[kept] * measured[kept, None], hits.object_ids[kept]

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

    def _returned(self, hits: Hits, draw: Float32) -> NDArray[np.bool_]:
        found = np.isfinite(hits.ranges)
        if np.isinf(self.reference_range_m):
            return found
        far = np.where(found, hits.ranges, np.float32(1.0)) / np.float32(self.reference_range_m)
        strength = hits.reflectance * hits.cosines ** np.float32(self.incidence_exponent) / far**2
        return np.asarray(found & (draw * (1 + np.maximum(strength, 1e-4) ** -4) < 1))
