"""What is known of where the sensor is before anything is looked at."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from .errors import ConfigError
from .system.checks import MOST_METRES
from .types import Candidate, Float64, Int64, Pose

MOST_RADIUS_M = 1e6


@dataclass(frozen=True, eq=False)
class Prior:
    """Rough position of the sensor, from GNSS or the last pose.

    Attributes
    ----------
    position : (2,) or (3,) float64
        x, y and optionally z in the map's frame [m].
    radius_m : float
        Largest distance from there [m]: horizontal, or in space if the position has a z.
    anywhere : bool
        True to search the whole map if nothing is found near the prior; the answer may then be
        far from it.

    Raises
    ------
    ConfigError
        If a number is missing, not finite or absurd.
    """

    position: ArrayLike
    radius_m: float
    anywhere: bool = False

    def __post_init__(self) -> None:
        try:
            position = np.array(self.position, dtype=np.float64)
            radius = float(self.radius_m)
        except (TypeError, ValueError) as error:
            raise ConfigError("a prior is a position (x, y) or (x, y, z) and a radius") from error
        if position.shape not in ((2,), (3,)) or not (np.abs(position) <= MOST_METRES).all():
            raise ConfigError(
                f"the position of a prior is x, y and perhaps z, metres, not {self.position!r:.60}"
            )
        if not 0 < radius <= MOST_RADIUS_M:
            raise ConfigError(f"the radius of a prior is above 0 m, not {self.radius_m!r:.40}")
        position.setflags(write=False)
        object.__setattr__(self, "position", position)
        object.__setattr__(self, "radius_m", radius)

    def __str__(self) -> str:
        where = ", ".join(f"{metres:.0f}" for metres in np.asarray(self.position))
        return f"within {self.radius_m:g} m of {where}"

    @classmethod
    def of(cls, near: Near | None) -> Prior | None:
        """Return the prior that the argument stands for.

        Raises
        ------
        ConfigError
        """
        if near is None or isinstance(near, Prior):
            return near
        try:
            position, radius_m = near
        except (TypeError, ValueError) as error:
            raise ConfigError(
                f"a prior is ((x, y), radius_m) or a segloc.Prior, not {near!r:.60}"
            ) from error
        return cls(position, radius_m)

    def distances(self, positions: Float64) -> Float64:
        """Return the distance of each of (N, 3) positions from the prior [m]."""
        centre: Float64 = np.asarray(self.position)
        found: Float64 = np.linalg.norm(positions[:, : len(centre)] - centre, axis=1)
        return found

    def holds(self, T_map_sensor: Pose) -> bool:
        """Return whether a (4, 4) pose is within the radius."""
        return bool(self.distances(T_map_sensor[None, :3, 3])[0] <= self.radius_m)

    def rows(self, positions: Float64, reach_m: float) -> Int64:
        """Return the rows of (N, 3) positions within ``reach_m`` of a sensor near the prior."""
        flat = np.linalg.norm(positions[:, :2] - np.asarray(self.position)[:2], axis=1)
        return np.flatnonzero(flat <= self.radius_m + reach_m)


Near: TypeAlias = Prior | tuple[ArrayLike, float]
"""A prior, or its position and radius in metres."""


def allowed(near: Prior | None) -> Callable[[Pose], bool]:
    """Return the test of poses; without a prior it accepts all."""
    return near.holds if near else lambda _: True


def within(near: Prior | None, candidates: list[Candidate]) -> list[Candidate]:
    """Return the candidates within the radius."""
    return [c for c in candidates if near is None or near.holds(c.T_map_local)]
