"""Simulated worlds: what never changes, what is redrawn each session, and the scene rays meet."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np

from segloc.errors import ConfigError
from segloc.types import Float32, Float64

from ..objects.fixtures import person
from ..objects.mesh import SESSION_IDS, Mesh, Objects
from ..objects.scene import Scene, Terrain
from ..objects.vehicles import bicycle, vehicle
from .changes import BUILT, Extent, Footing, replace_some, road_works, scaffold
from .interior import MOVABLES, REPLACEABLE, Interior
from .roads import RoadNetwork

_ROAD_WORKS = 0.012  # at how many of the places to park they dig


@dataclass(frozen=True)
class Catalogue:
    """Things of a few types, as they are bought, planted or built in rows.

    Attributes
    ----------
    seed : int
        Another one has other types.
    repetition : float
        Share of the things that are of a type from the catalogue, 0 to 1; the others are like no
        other.
    types : int
        Of each kind.
    """

    seed: int = 0
    repetition: float = 0.0
    types: int = 3

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
        return np.random.default_rng(
            [self.seed, 6211, int(own.integers(self.types)), *kind.encode()]
        )


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
    """

    foliage: float = 1.0
    replaced: float = 0.0
    scaffolding: float = 0.0

    def __post_init__(self) -> None:
        for item in fields(self):
            value = getattr(self, item.name)
            if not 0 <= value <= 1:
                raise ConfigError(f"{item.name} must be in 0..1, not {value}")


@dataclass(frozen=True)
class Spots:
    """Places where things come and go between sessions.

    Attributes
    ----------
    parking : (n, 5) float64
        x, y, yaw, longest vehicle that fits (m), probability that one stands there.
    people : (m, 2) float64
        Where somebody may stand, one in a dozen at a time.
    bicycles : (k, 3) float64
        x, y, yaw of places to lean a bicycle.
    movables : (j, 5) float64
        x, y, yaw, storey and number in :data:`MOVABLES` of what is moved about indoors.
    """

    parking: Float64
    people: Float64
    bicycles: Float64
    movables: Float64 = field(default_factory=lambda: np.zeros((0, 5)))

    @staticmethod
    def none() -> Spots:
        """No place for anything: a world that never changes."""
        return Spots(np.zeros((0, 5)), np.zeros((0, 2)), np.zeros((0, 3)))


@dataclass
class World:
    """Static geometry, the roads through it, and what changes between sessions.

    Attributes
    ----------
    name : str
    seed : int
        Of what changes between sessions.
    terrain : Terrain
    ground_reflectance : (T,) float32
        Of each triangle of the terrain's mesh.
    roads : RoadNetwork
    static : Objects
    spots : Spots
    recipe : (callable, arguments) or None
        How to make the world again; with one, a pickled world is as small as its recipe.
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
            scene = self._scenes[key] = Scene(self.terrain, self.ground_reflectance, leafy)
        return scene

    def standing(self, k: int, conditions: Conditions) -> list[Objects]:
        """What stays, less what is gone in session k; and what is put up instead."""
        rng = np.random.default_rng([self.seed, 7927, k])
        gone: set[int] = set()
        items: list[tuple[str, Mesh]] = []
        if conditions.replaced:
            gone, items = self._replaced(rng, conditions.replaced)
        rng = np.random.default_rng([self.seed, 7933, k])
        if conditions.scaffolding:
            for _, (_, extent) in sorted(self._extents(BUILT).items()):
                if rng.random() < conditions.scaffolding:
                    mesh = scaffold(rng, extent, self.terrain, self.roads.clearance)
                    items.append(("scaffolding", mesh))
        if not (gone or items):
            return [self.static]
        stays = ~np.isin(self.static.object_ids, sorted(gone))
        added = Objects.of(items, (k + 1) * SESSION_IDS + SESSION_IDS // 2)
        return [self.static.only(stays), added]

    def _floors(self) -> list[Terrain]:
        count = 1 if self.interior is None else len(self.interior.storeys)
        return [self.floor(storey) for storey in range(count)]

    def _replaced(
        self, rng: np.random.Generator, share: float
    ) -> tuple[set[int], list[tuple[str, Mesh]]]:
        """Ids of the things that are gone, and what stands instead, storey by storey."""
        things = self._extents(frozenset(REPLACEABLE))
        gone: set[int] = set()
        items: list[tuple[str, Mesh]] = []
        inside = self.interior
        for storey, floor in enumerate(self._floors()):
            standing, mine = self.static.triangles, things
            if inside is not None:
                base = float(floor.heights.min()) - 0.3
                standing = standing[standing[..., 2].max(axis=1) > base]
                mine = {k: v for k, v in things.items() if inside.storey(v[1].base) == storey}
            parked = self.spots.parking[:, :2]
            footing = Footing(standing, floor, parked, self.roads.clearance, inside)
            lost, added = replace_some(rng, share, mine, footing, floor)
            gone |= lost
            items += added
        return gone, items

    def _extents(self, kinds: frozenset[str]) -> dict[int, tuple[str, Extent]]:
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
                foot = [*at, float(floor.height(*at))]
                items.append(("person", person(rng).moved(foot, rng.uniform(0, 2 * np.pi))))
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
