"""A building being fitted out, in the coordinates of its plan."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from segloc.types import Float64

from ..objects.mesh import Mesh, Objects, rotation
from ..objects.scene import Terrain, grid, relief, roughness
from .interior import NUMBER, Interior
from .layout import Occupancy
from .roads import RoadNetwork
from .world import Spots, World

_STEP = 1.0  # of the floor's grid, metres
_EDGE = 4.0  # of ground outside the walls, metres
_CLEAR = 0.2  # from a way to what stands beside it, metres
_ROUNDING = 0.8  # corners are cut little where walls are near, metres


@dataclass
class Fitting:
    """A plan with what is built and put into it; metres from one corner, x along the building."""

    rng: np.random.Generator
    size: tuple[float, float]
    roads: RoadNetwork  # the aisles or corridors
    ground: Occupancy = field(init=False)  # what is taken of the plan
    items: list[tuple[str, Mesh]] = field(default_factory=list)
    # x, y, yaw, storey, number
    movables: list[tuple[float, float, float, int, int]] = field(default_factory=list)
    people: list[Float64] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.ground = Occupancy(max(self.size))

    def put(self, kind: str, mesh: Mesh, at: Float64, yaw: float = 0.0, z: float = 0.0) -> None:
        """Put something up, whatever is there."""
        self.items.append((kind, mesh.moved([at[0], at[1], z], yaw)))

    def stand(
        self, kind: str, mesh: Mesh, at: Float64, yaw: float, size: tuple[float, float]
    ) -> None:
        """Stand something on free floor, if there is room."""
        if self.claim(at, size, yaw):
            self.put(kind, mesh, at, yaw)

    def claim(self, at: Float64, size: tuple[float, float], yaw: float) -> bool:
        """Take a rectangle of free floor that is 0.2 m off the ways; say whether it was."""
        half = np.stack(np.meshgrid([-0.5, 0.0, 0.5], [-0.5, 0.0, 0.5]), -1).reshape(-1, 2) * size
        if self.roads.clearance(half @ rotation(yaw) + at).min() < _CLEAR:
            return False
        return self.ground.claim(at, size, yaw)

    def move_about(self, kind: str, at: Float64, yaw: float, storey: int = 0) -> None:
        """A place for something of :data:`MOVABLES`, which stands there in some sessions."""
        self.movables.append((float(at[0]), float(at[1]), yaw, storey, NUMBER[kind]))

    def world(self, name: str, seed: int, *, storeys: tuple[float, ...] = (0.0,)) -> World:
        """The finished world, turned to a heading of its own."""
        turn, side = float(self.rng.uniform(0, 2 * np.pi)), float(np.hypot(*self.size)) + 2 * _EDGE
        inside = Interior(self.size, turn)
        shift = np.full(2, side / 2) - inside.to_world(np.array(self.size) / 2)
        inside = replace(inside, corner=(float(shift[0]), float(shift[1])), storeys=storeys)
        x, y = grid(side, _STEP)  # a screed: level to a few millimetres in ten metres
        heights = relief(self.rng, x, y, 0.001, lengths=(8.0, 40.0))
        heights += 0.001 * roughness(self.rng, x.shape)
        terrain = Terrain(np.zeros(2), _STEP, heights)
        items = [(kind, mesh.moved([*shift, 0.0], turn)) for kind, mesh in self.items if len(mesh)]
        streets = tuple(replace(s, line=inside.to_world(s.line)) for s in self.roads.streets)
        roads = RoadNetwork(inside.to_world(self.roads.nodes), streets, _ROUNDING)
        movables = np.array(self.movables, dtype=float).reshape(-1, 5)
        movables[:, :2] = inside.to_world(movables[:, :2])
        movables[:, 2] += inside.turn
        people = inside.to_world(np.array(self.people, dtype=float).reshape(-1, 2))
        spots = Spots(people=people, movables=movables)
        ground = (terrain, np.full(2 * (len(heights) - 1) ** 2, 0.35, dtype=np.float32), roads)
        static = Objects.of(items, 1)
        return World(f"{name}-{seed}", seed, *ground, static, spots, interior=inside)
