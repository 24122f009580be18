"""Helpers that lay out a settlement: which ground is taken, and a growing list of objects."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ..types import Float64
from .mesh import Mesh, rectangle
from .roads import RoadNetwork, Street
from .terrain import Terrain


class Occupancy:
    """Which ground is taken, on a grid of quarter metres."""

    def __init__(self, size_m: float, step: float = 0.25) -> None:
        self._step = step
        self.size_m = size_m
        side = int(np.ceil(size_m / step)) + 1
        self._taken = np.zeros((side, side), dtype=bool)

    def claim(
        self, center: Float64, size: tuple[float, float], yaw: float, margin: float = 0.0
    ) -> bool:
        """Take a rectangle if it is free with ``margin`` around it; say whether it was."""
        if not self.free(center, size, yaw, margin):
            return False
        rows, inside = self._cells(center, size, yaw)
        self._taken[rows] |= inside
        return True

    def free(
        self, center: Float64, size: tuple[float, float], yaw: float, margin: float = 0.0
    ) -> bool:
        """Whether a rectangle and ``margin`` around it are free and lie inside the grid."""
        wide = (size[0] + 2 * margin, size[1] + 2 * margin)
        corners = rectangle(center, wide, yaw)
        if corners.min() < 0 or corners.max() > (len(self._taken) - 1) * self._step:
            return False
        rows, inside = self._cells(center, wide, yaw)
        return not bool((self._taken[rows] & inside).any())

    def _cells(
        self, center: Float64, size: tuple[float, float], yaw: float
    ) -> tuple[tuple[slice, slice], np.ndarray]:
        corners = rectangle(center, size, yaw)
        low = np.floor(corners.min(axis=0) / self._step).astype(int)
        high = np.ceil(corners.max(axis=0) / self._step).astype(int) + 1
        x = np.arange(low[0], high[0]) * self._step - center[0]
        y = np.arange(low[1], high[1])[:, None] * self._step - center[1]
        c, s = np.cos(yaw), np.sin(yaw)
        half = self._step / 2
        inside = (np.abs(c * x + s * y) <= size[0] / 2 + half) & (
            np.abs(c * y - s * x) <= size[1] / 2 + half
        )
        return (slice(low[1], high[1]), slice(low[0], high[0])), inside


@dataclass(frozen=True)
class Frontage:
    """One side of one street, and what stands along it.

    Attributes
    ----------
    street : Street
    side : int
        +1 to the left of the street, -1 to the right.
    pavement : float
        Width, metres.
    character : str
        What is built: "villas", "terrace", "flats", "mixed" or "green".
    """

    street: Street
    side: int
    pavement: float
    character: str

    def at(self, s: float | Float64, beyond_kerb: float | Float64) -> tuple[Float64, Float64]:
        """Points and yaws; local +y leads away from the street."""
        point, yaw = self.street.at(
            s, self.side * (self.street.half_width + np.asarray(beyond_kerb))
        )
        return point, yaw + (0.0 if self.side > 0 else np.pi)


@dataclass
class Site:
    """A settlement being laid out."""

    rng: np.random.Generator
    terrain: Terrain
    roads: RoadNetwork
    ground: Occupancy
    items: list[tuple[str, Mesh]] = field(default_factory=list)
    parking: list[tuple[float, float, float, float, float]] = field(default_factory=list)
    people: list[Float64] = field(default_factory=list)
    bicycles: list[tuple[float, float, float]] = field(default_factory=list)

    def stand(self, kind: str, mesh: Mesh, at: Float64, yaw: float, size: float) -> bool:
        """Stand an object of about ``size`` metres on free ground; False if there is none."""
        if self.roads.clearance(at) < size / 2 or not self.ground.claim(at, (size, size), yaw):
            return False
        self.items.append((kind, mesh.moved([*at, float(self.terrain.height(*at))], yaw)))
        return True

    def ground_line(self, points: Float64) -> Float64:
        """(n, 3) points on the terrain under (n, 2) points."""
        return np.column_stack([points, self.terrain.height(points[:, 0], points[:, 1])])

    def clear_line(self, points: Float64, clearance: float) -> bool:
        """Whether a (n, 2) line stays off the roads and off what is built already."""
        if (self.roads.clearance(points) < clearance).any():
            return False
        return all(self.ground.free(point, (0.3, 0.3), 0.0) for point in points)
