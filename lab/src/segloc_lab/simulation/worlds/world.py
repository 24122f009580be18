"""Simulated worlds: what never changes, what is redrawn each session, and the scene rays meet."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, fields, replace
from functools import lru_cache, wraps
from inspect import signature
from typing import Any, ParamSpec, TypeAlias

import numpy as np
from scipy.ndimage import gaussian_filter
from scipy.spatial import ConvexHull, cKDTree

from segloc.errors import ConfigError
from segloc.types import Float32, Float64

from ..objects.fixtures import cabinet, person, traffic_sign
from ..objects.mesh import (
    SESSION_IDS,
    SOLID,
    Mesh,
    Objects,
    above,
    at_height,
    boxes,
    join,
    rotation,
    scraps,
    triangles,
    tubes,
    xyz,
)
from ..objects.scene import Scene, Terrain
from ..objects.vehicles import bicycle, vehicle
from ..objects.works import barriers, cones
from .interior import MOVABLES, REPLACEABLE, Interior, Replaceable
from .roads import RoadNetwork

_CELL_M = 0.5

Item: TypeAlias = tuple[str, Mesh]
Clearance: TypeAlias = Callable[[Float64], Float64]

BUILT = frozenset({"house", "hall", "training house"})
"""Kinds that scaffolding may stand before."""
_WALL = "wall"
"""The kind of walls of rooms, which are moved where buildings are rebuilt."""
_MOVED_WALL_M = (0.5, 2.0)
_HOARDING_M = 2.2
_SNOW = 0.8
"""Reflectance of snow."""


class Footing:
    """Where the ground of a storey is free between the (T, 3, 3) triangles that stay on it.

    Nothing is put where vehicles come and go, on roads, or beyond the walls of an interior.
    """

    def __init__(self, world: World, triangles: Float32, terrain: Terrain) -> None:
        parked, corners = world.spots.parking[:, :2], triangles.reshape(-1, 3)
        low = corners[corners[:, 2] < terrain.height(corners[:, 0], corners[:, 1]) + 2.5]
        cell = np.rint(low[:, :2] / _CELL_M).astype(np.int64)
        first = cell.min(axis=0, initial=0)
        taken = np.zeros(cell.max(axis=0, initial=0) - first + 1, dtype=bool)
        taken[tuple((cell - first).T)] = True
        self._taken = cKDTree(np.concatenate([_CELL_M * (np.argwhere(taken) + first), parked]))
        self._parked = cKDTree(parked) if len(parked) else None
        self._clearance = world.roads.clearance
        self.interior = world.interior

    def find(
        self, rng: np.random.Generator, near: Float64, radius: float, taken: list[Float64]
    ) -> Float64 | None:
        """A free spot of a radius 2 to 15 m from a (2,) place; None where there is none."""
        turn, reach = rng.uniform(0, 2 * np.pi, 40), rng.uniform(2.0, 15.0, 40)
        spots = near + reach[:, None] * np.stack([np.cos(turn), np.sin(turn)], axis=1)
        free = (self._taken.query(spots)[0] > radius + 0.3) & (self._clearance(spots) > radius)
        if self._parked is not None:
            free &= self._parked.query(spots)[0] > radius + 2.7
        if self.interior is not None:
            free &= self.interior.inside(spots)
        if taken:
            apart = np.linalg.norm(spots[:, None] - np.array(taken), axis=2).min(axis=1)
            free &= apart > radius + 3.5
        return spots[int(np.argmax(free))] if free.any() else None


@dataclass(frozen=True)
class Extent:
    """Where an object is: the middle of its plan, (2,), foot, height, and its triangles."""

    middle: Float64
    base: float
    height: float
    triangles: Float32

    @staticmethod
    def of(triangles: Float32) -> Extent:
        """Of the (T, 3, 3) triangles of one object."""
        points = triangles.reshape(-1, 3)
        low, high = points.min(axis=0), points.max(axis=0)
        middle = ((low + high) / 2)[:2].astype(np.float64)
        return Extent(middle, float(low[2]), float(high[2] - low[2]), triangles)

    @property
    def sides(self) -> tuple[Float64, Float64, Float64]:
        """The smallest rectangle about the plan, side by side.

        Both ends, (4, 2) each, and the unit vectors away from it, (4, 2).
        """
        points = self.triangles.reshape(-1, 3)[:, :2].astype(np.float64)
        hull = points[ConvexHull(points).vertices]
        edges = np.roll(hull, -1, axis=0) - hull
        angles = np.unique(np.round(np.arctan2(edges[:, 1], edges[:, 0]) % (np.pi / 2), 3))
        turns = [rotation(float(a)).T for a in angles]
        R = min(turns, key=lambda turn: float(np.prod(np.ptp(hull @ turn, axis=0))))
        low, high = (hull @ R).min(axis=0), (hull @ R).max(axis=0)
        start = np.array([low, [high[0], low[1]], high, [low[0], high[1]]]) @ R.T
        end = np.roll(start, -1, axis=0)
        way = (end - start) / np.linalg.norm(end - start, axis=1)[:, None]
        return start, end, np.stack([way[:, 1], -way[:, 0]], axis=1)

    @property
    def across(self) -> Float64:
        """The unit vector across the longest side, (2,)."""
        start, end, out = self.sides
        return np.asarray(out[int(np.argmax(np.linalg.norm(end - start, axis=1)))])


Things: TypeAlias = dict[int, tuple[str, Extent]]
"""Objects by id, with their kind."""


def replace_some(
    source: Callable[[int], np.random.Generator],
    share: float,
    things: Things,
    footing: Footing,
    terrain: Terrain,
) -> tuple[set[int], list[Item]]:
    """Which of the replaceable objects are gone, and others near where they stood.

    ``source`` is the randomness of each, and things are taken in their order.
    """
    gone: set[int] = set()
    added: list[Item] = []
    taken: list[Float64] = []
    for number, (kind, extent) in things.items():
        entry, rng = REPLACEABLE[kind], source(number)
        if extent.height > entry.tallest or rng.random() >= share:
            continue
        gone.add(number)
        if entry.in_place:
            added.append((kind, _instead(rng, entry, extent, footing.interior)))
            continue
        at = footing.find(rng, extent.middle, entry.radius, taken)
        mesh, yaw = entry.make(rng), float(rng.uniform(0, 2 * np.pi))
        if at is not None:
            taken.append(at)
            added.append((kind, mesh.moved([*at, float(terrain.height(*at))], yaw)))
    return gone, added


def _instead(
    rng: np.random.Generator, entry: Replaceable, extent: Extent, interior: Interior | None
) -> Mesh:
    """Another of its kind where one stood, either way round, square to the walls."""
    turn = 0.0 if interior is None else interior.turn
    span = np.ptp(extent.triangles.reshape(-1, 3)[:, :2] @ rotation(turn).T, axis=0)
    mesh = entry.make(rng)
    own = np.ptp(mesh.triangles.reshape(-1, 3)[:, :2], axis=0)
    across = np.pi / 2 * ((span[0] > span[1]) != (own[0] > own[1]))
    return mesh.moved([*extent.middle, extent.base], turn + across + np.pi * int(rng.integers(2)))


def rebuild(
    source: Callable[[int], np.random.Generator],
    share: float,
    things: Things,
) -> tuple[set[int], list[Item]]:
    """Which buildings and walls are pulled down, and what was put up instead.

    Of a building that is nothing but a hoarding, or a smaller one of another height; a wall was
    moved across itself.
    """
    gone: set[int] = set()
    added: list[Item] = []
    for number, (kind, extent) in things.items():
        rng = source(number)
        if rng.random() >= share:
            continue
        gone.add(number)
        shell = triangles(extent.triangles.astype(np.float64), 0.4)
        if kind == _WALL:
            across = extent.across * rng.uniform(*_MOVED_WALL_M) * rng.choice([-1.0, 1.0])
            added.append((kind, shell.moved([*across, 0.0])))
        elif rng.random() < 0.5:
            foot = np.array([*extent.middle, extent.base])
            factor = rng.uniform([0.6, 0.6, 0.5], [0.95, 0.95, 1.5])
            added.append((kind, shell.moved(-foot).scaled(factor).moved(foot)))
        else:
            start, end, _ = extent.sides
            middle, way = (start + end) / 2, end - start
            for at, along in zip(middle, way, strict=True):
                size = [float(np.hypot(*along)), 0.05, _HOARDING_M]
                yaw = float(np.arctan2(along[1], along[0]))
                board = boxes([0, 0, _HOARDING_M / 2], size, 0.4)
                added.append(("hoarding", board.moved([*at, extent.base], yaw)))
    return gone, added


def scaffold(
    rng: np.random.Generator, extent: Extent, terrain: Terrain, clearance: Clearance
) -> Mesh:
    """Scaffolding before that side of a building which is nearest to a road.

    Two rows of standards with ledgers, decks, diagonals, handrails; netting on part of it.
    """
    start, end, out = _street_side(extent, clearance)
    long = float(np.linalg.norm(end - start))
    bays = max(1, round(long / rng.uniform(1.9, 2.6)))
    deep, lift = rng.uniform([0.7, 1.9], [1.2, 2.1])
    base = float(np.min(terrain.height(*(start + end) / 2 + out * deep)))
    top = max(lift, extent.height - rng.uniform(1.0, 3.0))
    s = np.linspace(0, 1, bays + 1)[:, None]
    line = start + s * (end - start)
    rows = [at_height(line + out * d, base) for d in (0.3, 0.3 + deep)]
    foot, (inner, outer) = np.concatenate(rows), rows
    parts = [tubes(foot - above(0.2), foot + above(top + 1.0), 0.024, 0.4, sides=5)]
    for z in np.arange(lift, top, lift):
        for row in (inner + above(z), outer + above(z), outer + above(z + 1.0)):
            parts.append(tubes(row[:-1], row[1:], 0.024, 0.4, sides=4))
        parts.append(tubes(inner + above(z), outer + above(z), 0.024, 0.4, sides=4))
        parts.append(_deck(start, end, out, deep, base + z))
    parts.append(tubes(outer[:-1] + above(0.1), outer[1:] + above(top), 0.024, 0.4, sides=4))
    if rng.random() < 0.6:
        parts.append(_netting(rng, outer, top))
    return join(parts)


def _street_side(extent: Extent, clearance: Clearance) -> tuple[Float64, Float64, Float64]:
    """The side of a building that is nearest to a road: both ends, and the direction outwards."""
    start, end, out = extent.sides
    k = int(np.argmin(clearance((start + end) / 2)))
    return start[k], end[k], out[k]


def _deck(start: Float64, end: Float64, out: Float64, deep: float, z: float) -> Mesh:
    middle = (start + end) / 2 + out * (0.3 + deep / 2)
    way = end - start
    yaw = float(np.arctan2(way[1], way[0]))
    board = boxes([0, 0, 0], [float(np.linalg.norm(way)), 0.9 * deep, 0.05], 0.4)
    return board.moved([*middle, z], yaw)


def _netting(rng: np.random.Generator, row: Float64, top: float) -> Mesh:
    """Net before a stretch of scaffolding: small patches in its plane, some rays pass."""
    first = int(rng.integers(0, max(1, len(row) // 2)))
    last = int(rng.integers(first + 1, len(row) + 1)) - 1
    a, b = row[first], row[max(last, first + 1) if first + 1 < len(row) else -1]
    count = int(np.linalg.norm(b - a) * top * rng.uniform(25, 60))
    t, z = rng.random((count, 1)), rng.uniform(0.5, top, count)
    sway = rng.normal(0, 0.02, (count, 3))
    center = a + t * (b - a) + sway + xyz(0, 0, z)
    return scraps(rng, center, 0.1, 0.35, SOLID)


def road_works(rng: np.random.Generator) -> Mesh:
    """Cones or barriers about a heap or a hole's spoil, about 5 m along x and 1.8 m wide."""
    edge = cones(rng) if rng.random() < 0.6 else barriers(rng)
    fit = min(1.0, 4.6 / float(np.ptp(edge.triangles[..., 0])))
    parts = [edge.scaled([fit, 1, 1]).moved([0, 0.75, 0])]
    size = rng.uniform([1.2, 0.5, 0.3], [3.2, 0.9, 1.1])
    n = int(40 * size[0])
    way = rng.normal(0, 0.33, (n, 2)) * size[:2]
    lift = size[2] * np.exp(-((way / size[:2]) ** 2).sum(axis=1) * 3)
    heap = scraps(rng, np.column_stack([way - [0, 0.2], 0.5 * lift]), 0.16, 0.35, SOLID)
    parts.append(heap)
    if rng.random() < 0.5:
        parts.append(traffic_sign(rng).moved([rng.choice([-2.4, 2.4]), 0.4, 0]))
    if rng.random() < 0.3:
        parts.append(cabinet(rng).moved([rng.uniform(-1, 1), -0.4, 0], 1.6))
    return join(parts)


_ROAD_WORKS = 0.012  # at how many of the places to park they dig


@dataclass(frozen=True)
class Catalogue:
    """Things of a few types, as they are bought, planted or built in rows."""

    seed: int = 0  # another one has other types
    repetition: float = 0.0  # share of the things that are of a type; others are like no other
    types: int = 3  # of each kind

    def __post_init__(self) -> None:
        if not 0 <= self.repetition <= 1:
            raise ConfigError(f"repetition must be in 0..1, not {self.repetition}")

    def source(self, own: np.random.Generator, kind: str) -> np.random.Generator:
        """What to make the next thing of a kind from: ``own`` randomness, or that of its type.

        Equal types start from equal generators, so what is made of them is equal, too. Without
        repetition ``own`` is left as it is.
        """
        if not self.repetition or own.random() >= self.repetition:
            return own
        number = int(own.integers(self.types))
        return np.random.default_rng([self.seed, 6211, number, *kind.encode()])


@dataclass(frozen=True)
class Conditions:
    """How a session differs from the world as it was made, beside parked cars and people.

    Attributes
    ----------
    foliage : float
        Share of the leaves that are there: 1 in summer, 0 in winter. Leaves fall in a fixed order,
        so that what is there at 0.5 is also there at 0.8.
    replaced : float
        Share of the replaceable objects that are gone; about as many others stand near by.
    scaffolding : float
        Share of the buildings with scaffolding before their front.
    rebuilt : float
        Share of the buildings that were pulled down, half of them for others in their place; of
        rooms, share of the walls that were moved.
    snow : float
        Depth of the snow beside the roads [m].
    lasting : bool
        Whether changes stay in later sessions: what is gone at 0.1 is also gone at 0.2, and what
        stands instead is the same. Otherwise each session has its own.
    """

    foliage: float = 1.0
    replaced: float = 0.0
    scaffolding: float = 0.0
    rebuilt: float = 0.0
    snow: float = 0.0
    lasting: bool = False

    def __post_init__(self) -> None:
        for item in fields(self):
            value = getattr(self, item.name)
            if not 0 <= value <= 1:
                raise ConfigError(f"{item.name} must be in 0..1, not {value}")


@dataclass(frozen=True)
class Spots:
    """Places where things come and go between sessions; each row is one place."""

    # x, y, yaw, longest vehicle that fits [m], probability that one stands there
    parking: Float64 = field(default_factory=lambda: np.zeros((0, 5)))
    # x, y of where somebody may stand, one in a dozen at a time
    people: Float64 = field(default_factory=lambda: np.zeros((0, 2)))
    # x, y, yaw of places to lean a bicycle
    bicycles: Float64 = field(default_factory=lambda: np.zeros((0, 3)))
    # x, y, yaw, storey and number in MOVABLES of what is moved about indoors
    movables: Float64 = field(default_factory=lambda: np.zeros((0, 5)))


@dataclass
class World:
    """Static geometry, the roads through it, and what changes between sessions.

    Attributes
    ----------
    seed : int
        Of what changes between sessions.
    ground_reflectance : (T,) float32
        Of each triangle of the terrain's mesh.
    recipe : (callable, arguments) or None
        How to make the world again, by :func:`remember`; pickled worlds are their recipes.
    interior : Interior or None
        Of a world indoors: where its walls are, and its storeys.
    catalogue : Catalogue
        Of what comes and goes: how many of the vehicles are alike.
    """

    name: str
    seed: int
    terrain: Terrain
    ground_reflectance: Float32
    roads: RoadNetwork
    static: Objects
    spots: Spots
    recipe: tuple[Callable[..., World], tuple[Any, ...]] | None = None
    interior: Interior | None = None
    catalogue: Catalogue = field(default_factory=Catalogue)
    _scenes: dict[tuple[int, Conditions], Scene] = field(default_factory=dict, repr=False)

    def floor(self, storey: int = 0) -> Terrain:
        """The ground that one stands on in a storey; outdoors there is but storey 0."""
        heights = (0.0,) if self.interior is None else self.interior.storeys
        if not 0 <= storey < len(heights):
            raise ConfigError(f"{self.name}: storey must be in 0..{len(heights) - 1}, not {storey}")
        return self.terrain if storey == 0 else self.terrain.raised(heights[storey])

    def session(self, k: int, conditions: Conditions | None = None) -> Scene:
        """The world in session k: same houses, other parked cars and people.

        The scene depends on the world, k and the conditions alone.
        """
        if not 0 <= k <= 1000:
            raise ConfigError(f"session must be in 0..1000, not {k}")
        conditions = conditions or Conditions()
        key = (k, conditions)
        scene = self._scenes.get(key)
        if scene is None:
            self._scenes.clear()  # one at a time: a scene holds some hundred megabytes
            groups = [*self.standing(k, conditions), self.changing(k)]
            leafy = [group.with_foliage(conditions.foliage) for group in groups]
            scene = self._scenes[key] = Scene(*self._ground(conditions.snow), leafy)
        return scene

    def standing(self, k: int, conditions: Conditions) -> list[Objects]:
        """What stays, less what is gone in session k; and what is put up instead."""
        gone: set[int] = set()
        items: list[Item] = []
        if conditions.replaced:
            gone, items = self._replaced(k, conditions)
        if conditions.rebuilt:
            built = self._extents(BUILT if self.interior is None else frozenset({_WALL}))
            source, things = self._changes(7937, k, built, conditions.lasting)
            pulled_down, put_up = rebuild(source, conditions.rebuilt, things)
            gone |= pulled_down
            items += put_up
        if conditions.scaffolding:
            source, things = self._changes(7933, k, self._extents(BUILT), conditions.lasting)
            for number, (_, extent) in things.items():
                rng = source(number)
                if rng.random() < conditions.scaffolding:
                    mesh = scaffold(rng, extent, self.terrain, self.roads.clearance)
                    items.append(("scaffolding", mesh))
        if not (gone or items):
            return [self.static]
        stays = ~np.isin(self.static.object_ids, sorted(gone))
        added = Objects.of(items, (k + 1) * SESSION_IDS + SESSION_IDS // 2)
        return [self.static.only(stays), added]

    def _ground(self, snow: float) -> tuple[Terrain, Float32]:
        """The surface on a day of snow, and the reflectance of its triangles."""
        if not snow:
            return self.terrain, self.ground_reflectance
        ground = self.terrain
        ny, nx = ground.heights.shape
        vertices, faces = ground.mesh()
        off_road = self.roads.clearance(vertices[:, :2]).reshape(ny, nx)
        wind = gaussian_filter(np.random.default_rng([self.seed, 7949]).normal(size=(ny, nx)), 2.0)
        drifts = np.clip(1.0 + 0.3 * wind / wind.std(), 0.3, 2.0)
        depth = snow * np.clip(off_road, 0.0, 1.0) * drifts
        white = depth.reshape(-1)[faces].max(axis=1) > 0.05
        reflectance = np.where(white, np.float32(_SNOW), self.ground_reflectance)
        return replace(ground, heights=ground.heights + depth), reflectance

    def _changes(
        self, salt: int, k: int, things: Things, lasting: bool
    ) -> tuple[Callable[[int], np.random.Generator], Things]:
        """The randomness of what changes, and the things in the order in which they change."""
        if lasting:

            def own(number: int) -> np.random.Generator:
                return np.random.default_rng([self.seed, salt, number])

            return own, {n: things[n] for n in sorted(things, key=lambda n: own(n).random())}
        rng = np.random.default_rng([self.seed, salt, k])
        return (lambda _: rng), dict(sorted(things.items()))

    def _floors(self) -> list[Terrain]:
        count = 1 if self.interior is None else len(self.interior.storeys)
        return [self.floor(storey) for storey in range(count)]

    def _replaced(self, k: int, conditions: Conditions) -> tuple[set[int], list[Item]]:
        """Ids of the things that are gone, and what stands instead, storey by storey."""
        every = self._extents(frozenset(REPLACEABLE))
        source, things = self._changes(7927, k, every, conditions.lasting)
        gone: set[int] = set()
        items: list[Item] = []
        inside = self.interior
        for storey, floor in enumerate(self._floors()):
            standing, mine = self.static.triangles, things
            if inside is not None:
                base = float(floor.heights.min()) - 0.3
                standing = standing[standing[..., 2].max(axis=1) > base]
                mine = {k: v for k, v in things.items() if inside.storey(v[1].base) == storey}
            footing = Footing(self, standing, floor)
            lost, added = replace_some(source, conditions.replaced, mine, footing, floor)
            gone |= lost
            items += added
        return gone, items

    def _extents(self, kinds: frozenset[str]) -> Things:
        """The static objects of some kinds by id."""
        ids = self.static.object_ids
        wanted = {k: kind for k, kind in self.static.kinds.items() if kind in kinds}
        numbers = np.array(sorted(wanted), dtype=ids.dtype)
        first, last = (np.searchsorted(ids, numbers, side) for side in ("left", "right"))
        return {
            int(k): (wanted[int(k)], Extent.of(self.static.triangles[a:b]))
            for k, a, b in zip(numbers, first, last, strict=True)
            if b > a
        }

    def changing(self, k: int) -> Objects:
        """Vehicles, people, bicycles and road works of session k."""
        rng = np.random.default_rng([self.seed, 7919, k])
        items: list[tuple[str, Mesh]] = []
        for x, y, yaw, longest, odds in self.spots.parking:
            if rng.random() < _ROAD_WORKS and longest < 7:
                spot = np.array([x, y])
                items.append(("road works", self._stand(road_works(rng), spot, yaw)))
            elif rng.random() < odds:
                items.append(("car", self._park(rng, x, y, yaw, longest)))
        floors = self._floors()
        for floor in floors:
            for x, y in self.spots.people[rng.random(len(self.spots.people)) < 1 / 12]:
                at = np.array([x, y]) + rng.normal(0, 0.3, 2)
                walker, yaw = person(rng), rng.uniform(0, 2 * np.pi)
                items.append(("person", walker.moved([*at, floor.height(*at)], yaw)))
        for x, y, yaw in self.spots.bicycles[rng.random(len(self.spots.bicycles)) < 0.5]:
            at = np.array([x, y]) + rng.normal(0, 0.2, 2)
            items.append(("bicycle", self._stand(bicycle(rng), at, yaw + rng.normal(0, 0.2))))
        for x, y, yaw, storey, number in self.spots.movables:
            thing = MOVABLES[int(number)]
            if rng.random() < thing.odds:
                at = np.array([x, y]) + rng.normal(0, 1, 2) * thing.shift_m
                height = float(floors[int(storey)].height(*at))
                turn = yaw + thing.turn * float(rng.normal())
                items.append((thing.kind, thing.make(rng).moved([*at, height], turn)))
        return Objects.of(items, (k + 1) * SESSION_IDS)

    def _park(
        self, rng: np.random.Generator, x: float, y: float, yaw: float, longest: float
    ) -> Mesh:
        mesh, (length, _) = vehicle(self.catalogue.source(rng, "car"), longest)
        turn = yaw + rng.normal(0, 0.025) + np.pi * (rng.random() < 0.3)
        slack = max(0.0, longest - length) / 2
        along, across = rng.uniform(-slack, slack), rng.normal(0, 0.08)
        x += np.cos(yaw) * along - np.sin(yaw) * across
        y += np.sin(yaw) * along + np.cos(yaw) * across
        c, s = np.cos(turn), np.sin(turn)
        front, rear = (self.terrain.height(x + k * c, y + k * s) for k in (1.3, -1.3))
        left, right = (self.terrain.height(x - k * s, y + k * c) for k in (0.7, -0.7))
        tilted = replace(mesh, triangles=mesh.triangles.copy())
        tilted.triangles[..., 2] += (front - rear) / 2.6 * mesh.triangles[..., 0]
        tilted.triangles[..., 2] += (left - right) / 1.4 * mesh.triangles[..., 1]
        return tilted.moved([float(x), float(y), float((front + rear) / 2)], turn)

    def _stand(self, mesh: Mesh, at: Float64, yaw: float) -> Mesh:
        return mesh.moved(np.append(at, self.terrain.height(*at)), yaw)

    def __reduce__(self) -> Any:
        if self.recipe is not None:
            return self.recipe
        state = (self.name, self.seed, self.terrain, self.ground_reflectance)
        rest = (self.roads, self.static, self.spots, None, self.interior, self.catalogue)
        return World, (*state, *rest)


P = ParamSpec("P")


def remember(make: Callable[P, World]) -> Callable[P, World]:
    """Keep the last two worlds that a function makes; it makes pickled ones again."""
    parameters = signature(make).parameters
    by_place = signature(make).replace(
        parameters=[each.replace(kind=each.POSITIONAL_OR_KEYWORD) for each in parameters.values()]
    )

    @lru_cache(maxsize=2)
    def made(*values: Any) -> World:
        world = make(**dict(zip(parameters, values, strict=True)))  # type: ignore[call-arg]
        world.recipe = (again, values)
        return world

    @wraps(make)
    def again(*args: P.args, **kwargs: P.kwargs) -> World:
        given = by_place.bind(*args, **kwargs)
        given.apply_defaults()
        return made(*given.arguments.values())

    return again
