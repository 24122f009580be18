"""Helpers that lay out a settlement: which ground is taken, and a growing list of objects."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from segloc.errors import ConfigError
from segloc.types import Float32, Float64

from ..objects.mesh import Mesh, Objects, join, loft, rectangle, rotation, scraps, xyz
from ..objects.scene import Terrain, grid, relief, roughness
from ..objects.vegetation import SPECIES, bush, grow, shrubs, tree
from .roads import RoadNetwork, Street
from .world import Catalogue, Spots, World

_KERB = 0.12
_STEP = 0.5  # of the terrain's grid, metres
_CELL = 0.25  # of the grid of taken ground, metres
_HEADROOM = 3.8  # below which branches are cut over streets, metres


class Occupancy:
    """Which ground of a square with a corner at the origin is taken, on a fine grid."""

    def __init__(self, size_m: float) -> None:
        self.size_m = size_m
        side = int(np.ceil(size_m / _CELL)) + 1
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
        if corners.min() < 0 or corners.max() > (len(self._taken) - 1) * _CELL:
            return False
        rows, inside = self._cells(center, wide, yaw)
        return not bool((self._taken[rows] & inside).any())

    def _cells(
        self, center: Float64, size: tuple[float, float], yaw: float
    ) -> tuple[tuple[slice, slice], np.ndarray]:
        corners = rectangle(center, size, yaw)
        low = np.floor(corners.min(axis=0) / _CELL).astype(int)
        high = np.ceil(corners.max(axis=0) / _CELL).astype(int) + 1
        x = np.arange(low[0], high[0]) * _CELL - center[0]
        y = np.arange(low[1], high[1])[:, None] * _CELL - center[1]
        c, s = np.cos(yaw), np.sin(yaw)
        half = _CELL / 2
        inside = (np.abs(c * x + s * y) <= size[0] / 2 + half) & (
            np.abs(c * y - s * x) <= size[1] / 2 + half
        )
        return (slice(low[1], high[1]), slice(low[0], high[0])), inside


@dataclass(frozen=True)
class Frontage:
    """One side of one street, and what stands along it."""

    street: Street
    side: int  # +1 to the left of the street, -1 to the right
    pavement: float  # its width, metres
    character: str  # what is built: "villas", "terrace", "flats", "mixed" or "green"
    setback: float = 1.0  # times the usual depth of front gardens

    def at(self, s: float | Float64, beyond_kerb: float | Float64) -> tuple[Float64, Float64]:
        """Points and yaws; local +y leads away from the street."""
        offset = self.side * (self.street.half_width + np.asarray(beyond_kerb))
        point, yaw = self.street.at(s, offset)
        return point, yaw + (0.0 if self.side > 0 else np.pi)


@dataclass
class Site:
    """A settlement being laid out; ``green`` is the amount of vegetation, 0 to 1."""

    rng: np.random.Generator
    terrain: Terrain
    ground_reflectance: Float32  # (T,), of each triangle of the terrain
    roads: RoadNetwork
    ground: Occupancy
    items: list[tuple[str, Mesh]] = field(default_factory=list)
    parking: list[tuple[float, float, float, float, float]] = field(default_factory=list)
    people: list[Float64] = field(default_factory=list)
    bicycles: list[tuple[float, float, float]] = field(default_factory=list)
    green: float = 0.5
    catalogue: Catalogue = field(default_factory=Catalogue)

    def like(self, kind: str) -> np.random.Generator:
        """What to make the next thing of a kind from: see :meth:`Catalogue.source`."""
        return self.catalogue.source(self.rng, kind)

    def stand(self, kind: str, mesh: Mesh, at: Float64, yaw: float, size: float) -> bool:
        """Stand an object of about ``size`` metres on free ground; False if there is none."""
        if self.roads.clearance(at) < size / 2 or not self.ground.claim(at, (size, size), yaw):
            return False
        placed = mesh.moved([*at, float(self.terrain.height(*at))], yaw)
        self.items.append((kind, self.pruned(placed) if kind == "tree" else placed))
        return True

    def pruned(self, mesh: Mesh) -> Mesh:
        """A mesh in place without the triangles that hang low over a carriageway."""
        middle = mesh.triangles.mean(axis=1)
        ground = self.terrain.height(middle[:, 0], middle[:, 1])
        low = np.flatnonzero(middle[:, 2] < ground + _HEADROOM)
        keep = np.ones(len(mesh), dtype=bool)
        keep[low] = self.roads.clearance(middle[low, :2]) > -0.2
        return mesh if keep.all() else mesh.only(keep)

    def erect(
        self,
        kind: str,
        mesh: Mesh,
        at: Float64,
        size: tuple[float, float],
        yaw: float,
        *,
        clearance: float = 1.2,
        margin: float = 0.0,
    ) -> bool:
        """Put up something large, ``size`` metres, on the mean height of free ground."""
        steps = np.meshgrid(np.linspace(-0.5, 0.5, 7), np.linspace(-0.5, 0.5, 5))
        plan = np.stack(steps, -1).reshape(-1, 2) * size @ rotation(yaw) + at
        if self.roads.clearance(plan).min() < clearance:
            return False
        if not self.ground.free(at, size, yaw, margin) or not self.ground.claim(at, size, yaw):
            return False
        z = float(self.terrain.height(*plan.T).mean())
        self.items.append((kind, mesh.moved([*at, z], yaw)))
        return True

    def world(self, name: str, seed: int) -> World:
        """The finished world."""
        spots = Spots(
            np.array(self.parking).reshape(-1, 5),
            np.array(self.people).reshape(-1, 2),
            np.array(self.bicycles).reshape(-1, 3),
        )
        ground = (self.terrain, self.ground_reflectance, self.roads)
        static = Objects.of(self.items, 1)
        return World(f"{name}-{seed}", seed, *ground, static, spots, catalogue=self.catalogue)

    def ground_line(self, points: Float64) -> Float64:
        """(n, 3) points on the terrain under (n, 2) points."""
        return np.column_stack([points, self.terrain.height(points[:, 0], points[:, 1])])

    def clear_start(self, points: Float64, clearance: float) -> Float64:
        """The points of a (n, 2) line before the first on a road or on what is built already."""
        taken = (not self.clear_line(point[None], clearance) for point in points)
        count = next((k for k, blocked in enumerate(taken) if blocked), len(points))
        return points[:count]

    def clear_line(self, points: Float64, clearance: float) -> bool:
        """Whether a (n, 2) line stays off the roads and off what is built already."""
        if (self.roads.clearance(points) < clearance).any():
            return False
        return all(self.ground.free(point, (0.3, 0.3), 0.0) for point in points)


def check_world(seed: int, size_m: float, smallest: float, largest: float) -> None:
    """Refuse a seed or a size that no world can be made of."""
    if not smallest <= size_m <= largest:
        raise ConfigError(f"size_m must be in {smallest:.0f}..{largest:.0f}, not {size_m}")
    if seed < 0:
        raise ConfigError(f"seed must not be negative, not {seed}")


def paved_site(
    rng: np.random.Generator, roads: RoadNetwork, size_m: float, *, slope: float, paved_m: float
) -> Site:
    """Relief with streets, kerb steps, and lawns from ``paved_m`` beyond the kerb."""
    x, y = grid(size_m, _STEP)
    clear = roads.clearance(np.stack([x, y], axis=-1))
    kerb = _KERB * np.clip((clear - 0.1) / 0.3, 0, 1)
    lawn = np.clip((clear - paved_m) / 1.5, 0, 1)
    bumps = roughness(rng, x.shape) * (0.008 + 0.032 * lawn)
    heights = relief(rng, x, y, slope) + kerb + bumps
    shine = np.where(clear < 0.2, 0.13, np.where(clear < paved_m - 0.5, 0.25, 0.4))
    cells = shine.astype(np.float32)[:-1, :-1].reshape(-1)
    terrain = Terrain(np.zeros(2), _STEP, heights)
    return Site(rng, terrain, np.repeat(cells, 2), roads, Occupancy(size_m))


def lay_kerb(site: Site, front: Frontage) -> None:
    """Kerb stones where the pavement meets the carriageway, not across side roads."""
    s = np.arange(0.0, front.street.length, 1.0)
    inner, _ = front.at(s, 0.0)
    outer, _ = front.at(s, 0.18)
    along = site.roads.clearance(inner) > -0.15
    z = site.terrain.height(*front.at(s, -0.3)[0].T) + _KERB
    profile = [(inner, -0.3), (inner, 0.0), (outer, 0.0), (outer, -0.3)]
    sections = np.stack([np.column_stack([xy, z + dz]) for xy, dz in profile], axis=1)
    runs = np.flatnonzero(np.diff(np.concatenate([[0], along.astype(int), [0]])))
    for begin, end in runs.reshape(-1, 2):
        if end - begin >= 2:
            site.items.append(("kerb", loft(sections[begin:end], 0.35)))


_TOWN_TREES = ("lime", "ash", "birch", "oak", "hawthorn", "yew", "pine", "willow")
_DETAIL = 0.7


def town_tree(rng: np.random.Generator, low: float, high: float) -> Mesh:
    """A tree between ``low`` and ``high`` metres, of a species that grows in towns."""
    tall = float(rng.uniform(low, high))
    if rng.random() < 0.4:
        return tree(rng, tall)
    species = str(rng.choice(_TOWN_TREES))
    usual = float(np.mean(SPECIES[species].height))
    return grow(rng, species, detail=_DETAIL, scale=tall / usual)


def ivy(rng: np.random.Generator, width: float, depth: float, height: float) -> Mesh:
    """Climbers on the walls of a building of the given plan, centred on the origin."""
    parts = []
    for _ in range(int(rng.integers(1, 4))):
        long, across = ((width, depth), (depth, width))[int(rng.random() < 0.35)]
        turn = np.pi / 2 * float(rng.choice([0, 0, 2] if long == width else [1, 3]))
        wide, high = rng.uniform(0.15, 0.7) * long, rng.uniform(0.3, 1.0) * height
        foot = rng.uniform(-0.5, 0.5) * (long - wide)
        count = int(wide * high * rng.uniform(35, 70))
        up = rng.uniform(0, 1, count)
        x = foot + wide * rng.normal(0, 0.25, count) * (1 - 0.6 * up)
        out = across / 2 + 0.05 + rng.exponential(0.09, count)
        spots = xyz(np.clip(x, -long / 2, long / 2), -out, up * high)
        parts.append(scraps(rng, spots, 0.12, 0.5).moved([0, 0, 0], turn))
    return join(parts)


def _plant(site: Site, at: Float64, tallest: float) -> bool:
    """Add a random tree or bush at a spot, if it is free."""
    rng = site.rng
    if tallest > 3 and rng.random() < 0.5:
        return site.stand("tree", town_tree(rng, 2.5, tallest), at, float(rng.uniform(0, 6)), 0.8)
    return site.stand("bush", bush(rng), at, float(rng.uniform(0, 6)), 1.0)


def thicket(site: Site, corners: Float64) -> None:
    """Bushes, shrubs and trees all over a quadrilateral, (4, 2) corners in cyclic order."""
    rng = site.rng
    a, b, c, d = corners
    area = float(np.linalg.norm(b - a) * np.linalg.norm(d - a))
    for u, v in rng.random((int(area / rng.uniform(5, 14)), 2)):
        at = (1 - v) * ((1 - u) * a + u * b) + v * ((1 - u) * d + u * c)
        if site.roads.clearance(at) > 2.0:
            _plant(site, at, 12.0)
    if rng.random() < 0.5:
        t = np.linspace(0.05, 0.95, max(3, int(np.linalg.norm(b - a) / 1.5)))[:, None]
        line = (1 - t) * a + t * b
        if site.clear_line(line, 1.0):
            site.items.append(("shrubs", shrubs(rng, site.ground_line(line))))
