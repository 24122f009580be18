"""A building being fitted out, in the coordinates of its plan."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from segloc.types import Float64

from ..objects.mesh import Mesh, Objects
from ..objects.scene import Terrain, relief, roughness
from .interior import NUMBER, Interior
from .layout import Occupancy
from .roads import RoadNetwork
from .world import Spots, World

_STEP = 1.0  # of the floor's grid, metres
_EDGE = 4.0  # of ground outside the walls, metres
_ROUNDING = 0.8  # corners are cut little where walls are near, metres


@dataclass
class Fitting:
    """A plan with what is built and put into it; metres from one corner, x along the building.

    Attributes
    ----------
    size : (float, float)
    roads : RoadNetwork
        The aisles or corridors.
    ground : Occupancy
        What is taken of the plan.
    items : list of (kind, mesh)
    movables : list of (x, y, yaw, storey, number)
    people : list of (2,) float64
    """

    rng: np.random.Generator
    size: tuple[float, float]
    roads: RoadNetwork
    ground: Occupancy = field(init=False)
    items: list[tuple[str, Mesh]] = field(default_factory=list)
    movables: list[tuple[float, float, float, int, int]] = field(default_factory=list)
    people: list[Float64] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.ground = Occupancy(max(self.size))

    def put(self, kind: str, mesh: Mesh, at: Float64, yaw: float = 0.0, z: float = 0.0) -> None:
        """Put something up, whatever is there."""
        self.items.append((kind, mesh.moved([at[0], at[1], z], yaw)))

    def stand(
        self,
        kind: str,
        mesh: Mesh,
        at: Float64,
        yaw: float,
        size: tuple[float, float],
    ) -> bool:
        """Stand something on free floor, 0.2 m off the ways; False if there is none."""
        if not self.claim(at, size, yaw, 0.2):
            return False
        self.put(kind, mesh, at, yaw)
        return True

    def claim(self, at: Float64, size: tuple[float, float], yaw: float, clearance: float) -> bool:
        """Take a rectangle of free floor that is ``clearance`` off the ways; say whether it was."""
        c, s = np.cos(yaw), np.sin(yaw)
        half = np.stack(np.meshgrid([-0.5, 0.0, 0.5], [-0.5, 0.0, 0.5]), -1).reshape(-1, 2) * size
        if self.roads.clearance(half @ np.array([[c, s], [-s, c]]) + at).min() < clearance:
            return False
        return self.ground.claim(at, size, yaw)

    def move_about(self, kind: str, at: Float64, yaw: float, storey: int = 0) -> None:
        """A place for something of :data:`MOVABLES`, which stands there in some sessions."""
        self.movables.append((float(at[0]), float(at[1]), yaw, storey, NUMBER[kind]))

    def world(
        self,
        name: str,
        seed: int,
        recipe: tuple[Callable[..., World], tuple[Any, ...]],
        *,
        storeys: tuple[float, ...] = (0.0,),
        shine: float = 0.35,
    ) -> World:
        """The finished world, turned to a heading of its own."""
        turn, side = float(self.rng.uniform(0, 2 * np.pi)), float(np.hypot(*self.size)) + 2 * _EDGE
        inside = Interior(self.size, turn)
        shift = np.full(2, side / 2) - inside.to_world(np.array(self.size) / 2)
        inside = replace(inside, corner=(float(shift[0]), float(shift[1])), storeys=storeys)
        terrain = _floor(self.rng, side)
        items = [(kind, mesh.moved([*shift, 0.0], turn)) for kind, mesh in self.items if len(mesh)]
        streets = tuple(replace(s, line=inside.to_world(s.line)) for s in self.roads.streets)
        roads = RoadNetwork(inside.to_world(self.roads.nodes), streets, _ROUNDING)
        return World(
            f"{name}-{seed}",
            seed,
            terrain,
            np.full(2 * (len(terrain.heights) - 1) ** 2, shine, dtype=np.float32),
            roads,
            Objects.of(items, 1),
            self._spots(inside),
            recipe,
            inside,
        )

    def _spots(self, inside: Interior) -> Spots:
        movables = np.array(self.movables, dtype=float).reshape(-1, 5)
        movables[:, :2] = inside.to_world(movables[:, :2])
        movables[:, 2] += inside.turn
        people = inside.to_world(np.array(self.people, dtype=float).reshape(-1, 2))
        return replace(Spots.none(), people=people, movables=movables)


def _floor(rng: np.random.Generator, side: float) -> Terrain:
    """A screed: level to a few millimetres in ten metres."""
    axis = _STEP * np.arange(int(np.ceil(side / _STEP)) + 1)
    x, y = np.meshgrid(axis, axis)
    heights = relief(rng, x, y, 0.001, lengths=(8.0, 40.0)) + 0.001 * roughness(rng, x.shape)
    return Terrain(np.zeros(2), _STEP, heights)
