"""Routes along the roads of a world."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from segloc.errors import ConfigError
from segloc.geometry import arc_length
from segloc.motion import Motion
from segloc.types import Float64

from ..worlds.roads import along
from ..worlds.world import World
from .paths import driven_line, on_ground
from .platforms import Platform


@dataclass(frozen=True)
class Route:
    """Where a vehicle drives.

    Attributes
    ----------
    junctions : tuple of int
        Nodes of the road network, in driving order, neighbours joined by streets.
    lane_offset_m : float
        To the right of the centre line.
    spacing_m : float
        Distance between scans.
    length_m : float or None
        Where to stop; None for the whole way.
    storey : int
        Of a building, from 0.
    """

    junctions: tuple[int, ...]
    lane_offset_m: float = 1.1
    spacing_m: float = 2.0
    length_m: float | None = None
    storey: int = 0

    def __post_init__(self) -> None:
        if not self.spacing_m > 0:
            raise ConfigError(f"spacing_m must be positive, not {self.spacing_m}")
        if self.length_m is not None and not self.length_m > 0:
            raise ConfigError(f"length_m must be positive, not {self.length_m}")
        if abs(self.lane_offset_m) > 2.0:
            raise ConfigError(f"lane_offset_m must be within -2..2, not {self.lane_offset_m}")

    def poses(self, world: World, mount_height_m: float) -> Float64:
        """Poses (N, 4, 4) T_world_sensor of a sensor on a vehicle that follows the route.

        Pitch and roll are those of the ground under the wheels.

        Raises
        ------
        ConfigError
            If the junctions are not a way through the world's road network.
        """
        line = self._line(world)
        xy, yaw = along(line, np.arange(0.0, self._stop(line), self.spacing_m))
        return on_ground(world.floor(self.storey), xy, yaw, mount_height_m)

    def drive(
        self,
        world: World,
        platform: Platform,
        rng: np.random.Generator,
        rate_hz: float | None = None,
    ) -> tuple[Motion, Float64]:
        """How a platform moves along the route, and when scans start, (N,) seconds.

        Scans start ``spacing_m`` of way apart, or ``rate_hz`` of them a second; ``rng`` decides
        the platform's sway.

        Raises
        ------
        ConfigError
            If the junctions are not a way through the world's road network.
        """
        line = self._line(world)
        motion = platform.motion(world.floor(self.storey), line, rng)
        stop = self._stop(line)
        if rate_hz is None:
            return motion, motion.times_of(np.arange(0.0, stop, self.spacing_m))
        end = motion.times_of(np.array([stop]))[0]
        return motion, np.arange(int(end * rate_hz)) / rate_hz

    def _line(self, world: World) -> Float64:
        centre = world.roads.centre_line(list(self.junctions))
        return driven_line(centre, self.lane_offset_m, world.roads.rounding_m)

    def _stop(self, line: Float64) -> float:
        total = float(arc_length(line)[-1])
        return total if self.length_m is None else min(total, self.length_m)
