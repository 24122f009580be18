"""Where a building is: a turned rectangle with storeys."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from segloc.types import Float64

_FOOT = 0.4  # what stands on a floor may begin this far below it, metres


@dataclass(frozen=True)
class Interior:
    """The inside of a building.

    Attributes
    ----------
    size : (float, float)
        Of its plan, metres.
    turn : float
        Heading of the plan's x axis, radians.
    corner : (float, float)
        World coordinates of the plan's origin.
    storeys : tuple of float
        Heights of the floors above the lowest, rising from 0, metres.
    """

    size: tuple[float, float]
    turn: float = 0.0
    corner: tuple[float, float] = (0.0, 0.0)
    storeys: tuple[float, ...] = (0.0,)

    def to_world(self, plan: ArrayLike) -> Float64:
        """World coordinates (..., 2) of points (..., 2) of the plan."""
        c, s = np.cos(self.turn), np.sin(self.turn)
        points = np.asarray(plan, dtype=float) @ np.array([[c, s], [-s, c]])
        return np.asarray(points + self.corner, dtype=np.float64)

    def to_plan(self, world: ArrayLike) -> Float64:
        """Points (..., 2) of the plan for world coordinates (..., 2)."""
        c, s = np.cos(self.turn), np.sin(self.turn)
        points = np.asarray(world, dtype=float) - self.corner
        return np.asarray(points @ np.array([[c, -s], [s, c]]), dtype=np.float64)

    def inside(self, world: ArrayLike) -> NDArray[np.bool_]:
        """Which of the world coordinates (..., 2) lie at least a metre inside the outer walls."""
        plan = self.to_plan(world)
        within = (plan > 1.0) & (plan < np.array(self.size) - 1.0)
        return np.asarray(within.all(axis=-1))

    def storey(self, height: float) -> int:
        """The storey that something stands on whose foot is so high above the lowest floor."""
        return max(0, int(np.searchsorted(self.storeys, height + _FOOT, side="right")) - 1)
