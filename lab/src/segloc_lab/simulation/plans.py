"""Plans of simulated buildings: what an architect draws of a world, or what was built otherwise."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from segloc.errors import ConfigError
from segloc.system.files import replacing
from segloc.types import Float64

from .objects.mesh import GLASS
from .worlds.world import World

STRUCTURE = frozenset({"wall", "ceiling", "floor", "stairs", "pillar", "piers", "beams"})
"""Kinds of objects that a plan has: no furniture, goods, racks, lamps or ducts."""
SHIFT_M, MISSING, MOVED, FAR_M = 0.05, 0.05, 0.05, 1.0
_WALLS = ("wall",)
_PIECE_M = 1.0  # triangles that are cut in half are split until they are smaller


@dataclass(frozen=True)
class Plan:
    """Triangles of a plan, element by element.

    Attributes
    ----------
    elements : tuple of (kind, (T, 3, 3) float64)
        In the frame of the world [m], z up.
    """

    elements: tuple[tuple[str, Float64], ...]

    @property
    def triangles(self) -> Float64:
        """All triangles, (T, 3, 3)."""
        return np.concatenate([triangles for _, triangles in self.elements])

    def deviating(self, rng: np.random.Generator) -> Plan:
        """Return the plan of a building that was built otherwise.

        Each wall is off by ``SHIFT_M`` (one standard deviation) along both axes of the ground; a
        share ``MISSING`` of the walls is missing, and a share ``MOVED`` is off by up to ``FAR_M``.
        """
        elements = []
        for kind, triangles in self.elements:
            shift = np.append(rng.normal(0.0, SHIFT_M, 2), 0.0)
            lot, far = float(rng.random()), np.append(rng.uniform(-FAR_M, FAR_M, 2), 0.0)
            if kind not in _WALLS:
                elements.append((kind, triangles))
            elif lot >= MISSING:
                elements.append((kind, triangles + (far if lot < MISSING + MOVED else shift)))
        return Plan(tuple(elements))

    def half(self, direction: Float64) -> Plan:
        """Return what lies on one side of the middle of the plan, cut to pieces of 1 m."""
        along = self.triangles.reshape(-1, 3)[:, :2] @ direction
        middle = (along.min() + along.max()) / 2

        def kept(triangles: Float64) -> Float64:
            pieces = _pieces(triangles)
            near: Float64 = pieces[pieces.mean(axis=1)[:, :2] @ direction < middle]
            return near

        return Plan(tuple((kind, kept(triangles)) for kind, triangles in self.elements))


def _pieces(triangles: Float64) -> Float64:
    """Split triangles across their longest sides until all are small."""
    done = [np.empty((0, 3, 3))]
    while len(triangles):
        sides = np.linalg.norm(triangles - np.roll(triangles, -1, axis=1), axis=2)
        large = sides.max(axis=1) > _PIECE_M
        done.append(triangles[~large])
        triangles, first = triangles[large], sides[large].argmax(axis=1)
        a, b, c = (triangles[np.arange(len(first)), (first + k) % 3] for k in range(3))
        middle = (a + b) / 2
        halves = [np.stack(corners, axis=1) for corners in ((a, middle, c), (middle, b, c))]
        triangles = np.concatenate(halves)
    return np.concatenate(done)


def plan_of(world: World) -> Plan:
    """Return the plan of a world indoors, without glass, and with the ground under it.

    Raises
    ------
    ConfigError
        If the world is outdoors.
    """
    inside, static = world.interior, world.static
    if inside is None:
        raise ConfigError(f"{world.name}: only buildings have a plan")
    solid = static.material != GLASS
    elements = []
    for number, kind in sorted(static.kinds.items()):
        triangles = static.triangles[solid & (static.object_ids == number)]
        if kind in STRUCTURE and len(triangles):
            elements.append((kind, triangles.astype(np.float64)))
    long, wide = inside.size
    corners = [[0.0, 0.0], [long, 0.0], [long, wide], [0.0, wide]]
    ground = np.column_stack([inside.to_world(np.array(corners)), np.zeros(4)])
    return Plan((*elements, ("floor", ground[[[0, 1, 2], [0, 2, 3]]])))


def write_stl(path: Path, plan: Plan) -> None:
    """Write a plan as a binary STL file: coordinates in metres, z up."""
    triangles = plan.triangles
    rows = np.zeros(len(triangles), dtype=[("normal", "<f4", 3), ("at", "<f4", 9), ("more", "<u2")])
    rows["at"] = triangles.reshape(-1, 9)
    with replacing(path) as stream:
        stream.write(b"plan".ljust(80) + np.uint32(len(rows)).tobytes() + rows.tobytes())
