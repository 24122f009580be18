"""Open land with paths: uneven ground, and plants that are cut back where people walk."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from segloc.types import Float32, Float64

from ..objects.mesh import Mesh, Objects
from ..objects.scene import Terrain, relief, roughness
from .layout import Occupancy, Site
from .roads import RoadNetwork
from .world import World

_STEP = 0.5
_VERGE = 1.0  # kept clear beside paths, metres
_CORNER = 5.2  # radius about junctions, where corners are cut
_HEADROOM = 3.4


@dataclass
class Land(Site):
    """A site on which things also grow.

    Attributes
    ----------
    room : (ny, nx) float32
        Distance from the nearest path or junction, on the terrain's grid, metres.
    ground_reflectance : (T,) float32
    """

    room: Float32 = field(kw_only=True)
    ground_reflectance: Float32 = field(kw_only=True)

    def distance(self, at: Float64) -> float:
        """Metres from the edge of the nearest path, negative on it."""
        return float(self.room[self._cell(at[..., 1]), self._cell(at[..., 0])])

    def detail(self, at: Float64) -> float:
        """How finely to draw what stands there: fully by the paths, coarsely far away."""
        return float(np.clip(1.05 - self.distance(at) / 20.0, 0.18, 0.8))

    def grow(
        self, kind: str, make: Callable[[], Mesh], at: Float64, size: float, *, yaw: float = 0.0
    ) -> bool:
        """Stand what ``make`` makes on free ground; what hangs into a path is cut away.

        ``size`` is what it takes of the ground, metres. False if there is no room.
        """
        if not 0 < at.min() <= at.max() < self.ground.size_m - 1 or self.distance(at) < (
            _VERGE + size / 2
        ):
            return False
        if not self.ground.claim(at, (size, size), yaw):
            return False
        mesh = make().moved([*at, float(self.terrain.height(*at))], yaw)
        self.items.append((kind, self.pruned(mesh)))
        return True

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

    def world(self, name: str, seed: int, make: Callable[..., World], *arguments: Any) -> World:
        """The finished world; ``make(*arguments)`` makes it again."""
        static = Objects.of([item for item in self.items if len(item[1])], 1)
        return World(
            f"{name}-{seed}",
            seed,
            self.terrain,
            self.ground_reflectance,
            self.roads,
            static,
            self.spots(),
            (make, arguments),
        )

    def _cell(self, value: Float64) -> np.ndarray:
        return np.clip(np.rint(value / _STEP), 0, len(self.room) - 1).astype(np.int64)


@dataclass(frozen=True)
class Ground:
    """How uneven land is.

    Attributes
    ----------
    slope : float
        Root mean square slope of the hills.
    humps : float
        The same of humps of 8 to 40 m, which paths are levelled through.
    rough : float
        Standard deviation of the bumps off the paths, metres.
    ditches : float
        Share of the path sides that have a ditch.
    kerb : float
        Step up beside paths wider than 3 m, metres.
    """

    slope: float
    humps: float
    rough: float
    ditches: float = 0.0
    kerb: float = 0.0


def lay_out(rng: np.random.Generator, roads: RoadNetwork, size_m: float, ground: Ground) -> Land:
    """Bare land about a network of paths."""
    axis = _STEP * np.arange(int(np.ceil(size_m / _STEP)) + 1)
    x, y = np.meshgrid(axis, axis)
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
    return Land(
        rng,
        Terrain(np.zeros(2), _STEP, heights),
        roads,
        Occupancy(size_m),
        room=np.minimum(clear, corner).astype(np.float32),
        ground_reflectance=np.repeat(shine, 2),
    )


def scattered(rng: np.random.Generator, size_m: float, spacing: float, loose: float) -> Float64:
    """Points (n, 2) over a square on a turned lattice; ``loose`` shifts them, in steps."""
    half = int(0.75 * size_m / spacing) + 1
    grid = spacing * np.stack(np.meshgrid(*2 * [np.arange(-half, half + 1.0)]), -1).reshape(-1, 2)
    grid += rng.uniform(-loose, loose, grid.shape) * spacing
    turn = rng.uniform(0, np.pi)
    c, s = np.cos(turn), np.sin(turn)
    points = grid @ np.array([[c, s], [-s, c]]) + size_m / 2 + rng.uniform(0, spacing, 2)
    inside = ((points > 1.5) & (points < size_m - 1.5)).all(axis=1)
    return np.asarray(points[inside])
