"""Open land with paths: uneven ground, and plants that are cut back where people walk."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TypeAlias

import numpy as np

from segloc.types import Float32, Float64

from ..objects.mesh import Mesh, rotation
from ..objects.scene import Terrain, grid, relief, roughness
from ..objects.vegetation import thicket
from .layout import Occupancy, Site
from .roads import RoadNetwork
from .world import World

_STEP = 0.5
_VERGE = 1.0  # kept clear beside paths, metres
_CORNER = 5.2  # radius about junctions, where corners are cut
_HEADROOM = 3.4

Maker: TypeAlias = Callable[[np.random.Generator], Mesh]
Options: TypeAlias = tuple[tuple[float, str, Maker, float], ...]
"""Bound, kind, maker, and size in metres: of a number in [0, 1) the first bound above it counts."""


@dataclass
class Land(Site):
    """A site on which things also grow."""

    # (ny, nx): distance from the nearest path or junction, on the terrain's grid, metres
    room: Float32 = field(kw_only=True)

    def distance(self, at: Float64) -> float:
        """Metres from the edge of the nearest path, negative on it."""
        return float(self.room[self._cell(at[..., 1]), self._cell(at[..., 0])])

    def detail(self, at: Float64) -> float:
        """How finely to draw what stands there: fully by the paths, coarsely far away."""
        return float(np.clip(1.05 - self.distance(at) / 20.0, 0.18, 0.8))

    def grow(
        self,
        kind: str,
        make: Maker,
        at: Float64,
        size: float,
        *,
        yaw: float = 0.0,
        source: np.random.Generator | None = None,
    ) -> bool:
        """Stand what ``make`` makes on free ground; what hangs into a path is cut away.

        ``size`` is what it takes of the ground, metres. False if there is no room.
        """
        if not 0 < at.min() <= at.max() < self.ground.size_m - 1:
            return False
        if self.distance(at) < _VERGE + size / 2 or not self.ground.claim(at, (size, size), yaw):
            return False
        mesh = make(source or self.rng)
        self.put(kind, mesh.moved([*at, float(self.terrain.height(*at))], yaw))
        return True

    def grow_one(self, options: Options, pick: float, at: Float64, yaw: float = 0.0) -> bool:
        """Grow the first of the options whose bound is above ``pick``, if any."""
        for bound, kind, make, size in options:
            if pick < bound:
                return self.grow(kind, make, at, size, yaw=yaw)
        return False

    def put(self, kind: str, mesh: Mesh) -> None:
        """Put something that is in its place already, less what hangs into a path."""
        self.items.append((kind, self.pruned(mesh)))

    def pruned(self, mesh: Mesh) -> Mesh:
        """A mesh in place without the triangles that hang into a path."""
        corner = mesh.triangles
        cells = self._cell(corner[..., 1]), self._cell(corner[..., 0])
        over = np.flatnonzero((self.room[cells] < _VERGE).any(axis=1))
        if not len(over):
            return mesh
        x, y, z = corner[over].reshape(-1, 3).T
        low = (z - self.terrain.height(x, y) < _HEADROOM).reshape(-1, 3).any(axis=1)
        keep = np.ones(len(mesh), dtype=bool)
        keep[over[low]] = False
        return mesh.only(keep)

    def line(self, points: Float64) -> Float64:
        """The longest stretch of a (n, 2) line that is free and off the paths; maybe empty."""
        free = [
            bool(self.distance(p) > _VERGE + 0.3 and self.ground.free(p, (0.3, 0.3), 0.0))
            for p in points
        ]
        edges = np.flatnonzero(np.diff(np.concatenate([[0], np.array(free, dtype=int), [0]])))
        runs = edges.reshape(-1, 2)
        if not len(runs):
            return points[:0]
        begin, end = runs[np.argmax(runs[:, 1] - runs[:, 0])]
        return points[begin:end]

    def walkers(self, points: Float64) -> None:
        """People may stand at those of the (n, 2) points that no vehicle comes near."""
        self.people.extend(p for p in points if self.distance(p) > _VERGE)

    def world(self, name: str, seed: int) -> World:
        """The finished world, without what was cut away as a whole."""
        self.items = [item for item in self.items if len(item[1])]
        return super().world(name, seed)

    def _cell(self, value: Float64) -> np.ndarray:
        return np.clip(np.rint(value / _STEP), 0, len(self.room) - 1).astype(np.int64)


@dataclass(frozen=True)
class Ground:
    """How uneven land is."""

    slope: float  # root mean square slope of the hills
    humps: float  # the same of humps of 8 to 40 m, which paths are levelled through
    rough: float  # standard deviation of the bumps off the paths, metres
    ditches: float = 0.0  # share of the path sides that have a ditch
    kerb: float = 0.0  # step up beside paths wider than 3 m, metres


def lay_out(rng: np.random.Generator, roads: RoadNetwork, size_m: float, ground: Ground) -> Land:
    """Bare land about a network of paths."""
    x, y = grid(size_m, _STEP)
    xy = np.stack([x, y], axis=-1)
    clear = roads.clearance(xy)
    away = np.clip(clear / 4.0, 0, 1)
    heights = relief(rng, x, y, ground.slope)
    heights += away * relief(rng, x, y, ground.humps, lengths=(8.0, 40.0))
    heights += roughness(rng, x.shape) * (0.012 + ground.rough * np.clip(clear / 1.5, 0, 1))
    heights += ground.kerb * np.clip((clear - 0.1) / 0.3, 0, 1)
    if ground.ditches:
        some = relief(rng, x, y, 1.0, lengths=(60.0, 200.0)) > 0
        shape = np.exp(-(((clear - 2.6) / 0.7) ** 2))
        heights -= rng.uniform(0.3, 0.7) * shape * some * (rng.random() < ground.ditches)
    corner = np.full(clear.shape, np.inf)
    for node in roads.nodes:
        np.minimum(corner, np.linalg.norm(xy - node, axis=-1) - _CORNER, out=corner)
    shine = np.where(clear < 0.2, 0.25, 0.4).astype(np.float32)[:-1, :-1].reshape(-1)
    terrain, room = Terrain(np.zeros(2), _STEP, heights), np.minimum(clear, corner)
    shades, free = np.repeat(shine, 2), Occupancy(size_m)
    return Land(rng, terrain, shades, roads, free, room=room.astype(np.float32))


def grow_thicket(land: Land, at: Float64, low: list[float], high: list[float]) -> None:
    """Grow a thicket of a radius and a height between those of ``low`` and ``high``, metres."""
    (radius, tall), detail = land.rng.uniform(low, high), land.detail(at)
    land.grow("thicket", lambda rng: thicket(rng, radius, tall, detail), at, 1.2 * radius)


def scattered(rng: np.random.Generator, size_m: float, spacing: float, loose: float) -> Float64:
    """Points (n, 2) over a square on a turned lattice; ``loose`` shifts them, in steps."""
    half = int(0.75 * size_m / spacing) + 1
    lattice = np.stack(np.meshgrid(*2 * [np.arange(-half, half + 1.0)]), -1).reshape(-1, 2)
    lattice = spacing * lattice + rng.uniform(-loose, loose, lattice.shape) * spacing
    turn = rotation(rng.uniform(0, np.pi))
    points = lattice @ turn + size_m / 2 + rng.uniform(0, spacing, 2)
    inside = ((points > 1.5) & (points < size_m - 1.5)).all(axis=1)
    return np.asarray(points[inside])
