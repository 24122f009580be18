"""Prior: rough position, height and heading of the sensor."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from . import geometry
from .errors import ConfigError
from .system.checks import MAX_METRES
from .types import Candidate, Float64, Int64, Pose

MAX_RADIUS_M, MAX_HEADING_DEG = 1e6, 3600.0


@dataclass(frozen=True, eq=False)
class Prior:
    """Rough position of the sensor, its height or its heading: at least one of them.

    Attributes
    ----------
    position : (2,) or (3,) float64
        x, y and optionally z in the map's frame [m].
    radius_m : float
        Largest distance from there [m]: horizontal, or in space if the position has a z. By default
        the position does not count.
    anywhere : bool
        True to search the whole map if nothing is found near the prior; the answer may then be
        far from it.
    heading_deg : float, optional
        Heading of the sensor: of its x axis, counterclockwise from the map's [deg].
    heading_tolerance_deg : float
        Largest difference from that heading [deg].
    height_m : float, optional
        Height of the sensor in the map's frame [m], as of a floor and the mount on the robot.
    height_tolerance_m : float
        Largest difference from that height [m]; less than half a storey selects one.

    Raises
    ------
    ConfigError
        If a number is missing, not finite or out of range.
    """

    position: ArrayLike = (0.0, 0.0)
    radius_m: float = math.inf
    anywhere: bool = False
    heading_deg: float | None = None
    heading_tolerance_deg: float = 45.0
    height_m: float | None = None
    height_tolerance_m: float = 1.5

    def __post_init__(self) -> None:
        try:
            position = np.array(self.position, dtype=np.float64)
            radius = float(self.radius_m)
            heading = None if self.heading_deg is None else float(self.heading_deg)
            tolerance = float(self.heading_tolerance_deg)
            height = None if self.height_m is None else float(self.height_m)
            height_tolerance = float(self.height_tolerance_m)
        except (TypeError, ValueError) as error:
            raise ConfigError(
                "a prior must be a position (x, y) or (x, y, z) and a radius"
            ) from error
        if position.shape not in ((2,), (3,)) or not (np.abs(position) <= MAX_METRES).all():
            raise ConfigError(
                f"prior: the position must be x, y or x, y, z in metres, not {self.position!r:.60}"
            )
        is_alone = radius == math.inf and (heading is not None or height is not None)
        if not (0 < radius <= MAX_RADIUS_M or is_alone):
            raise ConfigError(f"prior: the radius must be above 0 m, not {self.radius_m!r:.40}")
        if heading is not None and not abs(heading) <= MAX_HEADING_DEG:
            raise ConfigError(
                f"prior: the heading must be in degrees, not {self.heading_deg!r:.40}"
            )
        if not 0 < tolerance <= 180:
            raise ConfigError(
                f"prior: the heading tolerance must be 0 to 180 degrees, not {tolerance!r:.40}"
            )
        if height is not None and not abs(height) <= MAX_METRES:
            raise ConfigError(f"prior: the height must be in metres, not {self.height_m!r:.40}")
        if not 0 < height_tolerance <= MAX_RADIUS_M:
            raise ConfigError(
                f"prior: the height tolerance must be above 0 m, not {height_tolerance!r:.40}"
            )
        position.setflags(write=False)
        object.__setattr__(self, "position", position)
        object.__setattr__(self, "radius_m", radius)
        object.__setattr__(self, "heading_deg", heading)
        object.__setattr__(self, "heading_tolerance_deg", tolerance)
        object.__setattr__(self, "height_m", height)
        object.__setattr__(self, "height_tolerance_m", height_tolerance)

    def __str__(self) -> str:
        known = list[str]()
        if self.has_position:
            where = ", ".join(f"{metres:.0f}" for metres in np.asarray(self.position))
            known.append(f"within {self.radius_m:g} m of {where}")
        if self.height_m is not None:
            known.append(f"height {self.height_m:.1f} +- {self.height_tolerance_m:g} m")
        if self.heading_deg is not None:
            tolerance = self.heading_tolerance_deg
            known.append(f"heading {self.heading_deg:.0f} +- {tolerance:.0f} degrees")
        return ", ".join(known)

    @property
    def has_position(self) -> bool:
        """Whether the position counts."""
        return self.radius_m < math.inf

    @classmethod
    def of(cls, near: Near | None) -> Prior | None:
        """Return the argument as a prior.

        Raises
        ------
        ConfigError
        """
        if near is None or isinstance(near, Prior):
            return near
        try:
            position, radius_m, *heading = near
            if len(heading) > 1:
                raise TypeError
        except (TypeError, ValueError) as error:
            raise ConfigError(
                "a prior must be ((x, y), radius_m), ((x, y), radius_m, heading_deg) or a Prior, "
                f"not {near!r:.60}"
            ) from error
        return cls(position, radius_m, heading_deg=heading[0] if heading else None)

    def widened(self, separation: geometry.Separation) -> Prior:
        """Return the prior with more radius and tolerance: half of what separates places.

        Rough poses within it may be aligned to a pose that it permits.
        """
        return replace(
            self,
            radius_m=_widen(self.radius_m, separation.metres, MAX_RADIUS_M),
            heading_tolerance_deg=_widen(self.heading_tolerance_deg, separation.degrees, 180.0),
            height_tolerance_m=_widen(self.height_tolerance_m, separation.height, MAX_RADIUS_M),
        )

    def distances(self, positions: Float64) -> Float64:
        """Return the distance of each of (N, 3) positions from the prior [m]."""
        centre: Float64 = np.asarray(self.position)
        found: Float64 = np.linalg.norm(positions[:, : len(centre)] - centre, axis=1)
        return found

    def holds(self, T_map_sensor: Pose) -> bool:
        """Return whether a (4, 4) pose is within the radius and the tolerances."""
        if not self.distances(T_map_sensor[None, :3, 3])[0] <= self.radius_m:
            return False
        height = self.height_m
        if height is not None and abs(T_map_sensor[2, 3] - height) > self.height_tolerance_m:
            return False
        if self.heading_deg is None:
            return True
        turn = math.degrees(geometry.heading(T_map_sensor)) - self.heading_deg
        return abs((turn + 180.0) % 360.0 - 180.0) <= self.heading_tolerance_deg

    def rows(self, positions: Float64, reach_m: float) -> Int64:
        """Return the rows of (N, 3) positions within ``reach_m`` of a sensor near the prior."""
        x, y = np.asarray(self.position)[:2]
        squared = (positions[:, 0] - x) ** 2 + (positions[:, 1] - y) ** 2
        return np.flatnonzero(squared <= (self.radius_m + reach_m) ** 2)


def _widen(value: float, separation: float, limit: float) -> float:
    return max(value, min(value + 0.5 * separation, limit))


Near: TypeAlias = Prior | tuple[ArrayLike, float] | tuple[ArrayLike, float, float]
"""A prior, or its position, its radius [m], and optionally its heading [deg]."""


def allowed(near: Prior | None) -> Callable[[Pose], bool]:
    """Return the test of poses; without a prior it accepts all."""
    return near.holds if near else lambda _: True


def within(near: Prior | None, candidates: list[Candidate]) -> list[Candidate]:
    """Return the candidates that a prior allows."""
    return [c for c in candidates if near is None or near.holds(c.T_map_local)]
