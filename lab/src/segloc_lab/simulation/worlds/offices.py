"""Offices: a storey of rooms along corridors, or several above each other."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from segloc.errors import ConfigError
from segloc.types import Float64

from ..objects.furniture import (
    cupboard,
    desk,
    lockers,
    panes,
    pot_plant,
    printer,
    shelf,
    slab,
    sofa,
    stair_flight,
    table,
    wall,
    wall_things,
)
from ..objects.mesh import Mesh, boxes, join, tubes
from .fitting import Fitting
from .layout import check_world
from .roads import RoadNetwork, straight
from .world import World, remember

_STAIRS_M = 3.4  # length of a stairwell along the building


@dataclass(frozen=True)
class Room:
    """A room of a plan; metres.

    Its kind is "office", "meeting", "open" (plan), "store", or "niche", which is open to the
    corridor.
    """

    low: tuple[float, float]  # opposite corners
    high: tuple[float, float]
    front: float  # y of the wall to the corridor: low[1] or high[1]
    kind: str
    door: float  # x of the middle of its door
    glazed: bool  # whether its front is of glass

    @property
    def into(self) -> float:
        """+1 if the room lies above its corridor in the plan, -1 if below."""
        return 1.0 if self.front == self.low[1] else -1.0

    @property
    def size(self) -> tuple[float, float]:
        """Length along the corridor, and depth."""
        return self.high[0] - self.low[0], self.high[1] - self.low[1]


@dataclass(frozen=True)
class FloorPlan:
    """The plan of a storey; storeys of a building differ in rooms alone; metres."""

    size: tuple[float, float]
    rooms: tuple[Room, ...]
    corridor: float  # width of the corridors
    outer: float  # depth of the rooms that have windows
    crossings: tuple[float, ...]  # x of the middles of the corridors across
    rise: float  # from floor to floor
    ceiling: float  # height of the ceilings
    windows: float  # width of a window and the wall beside it

    @property
    def core(self) -> tuple[float, float]:
        """y of the walls between which the rooms without windows lie."""
        low = self.outer + self.corridor
        return low, self.size[1] - low

    @property
    def stairs(self) -> Float64:
        """The stairwells at both ends, (2, 4): x0, y0, x1, y1."""
        ends, (low, high) = (0.0, self.size[0] - _STAIRS_M), self.core
        return np.array([(x, low, x + _STAIRS_M, high) for x in ends])

    def in_corridor(self, x: float) -> bool:
        """Whether a long corridor runs there, and none leads across."""
        off = min(abs(x - middle) for middle in self.crossings) > self.corridor / 2 + 0.9
        return bool(off and self.crossings[0] < x < self.crossings[-1])

    def corridors(self) -> RoadNetwork:
        """The ladder of corridors."""
        half = self.corridor / 2
        rows = (self.outer + half, self.size[1] - self.outer - half)
        nodes = np.array([[x, y] for x in self.crossings for y in rows])
        width = half - 0.2
        streets = [straight(nodes, 2 * k, 2 * k + 1, width) for k in range(len(self.crossings))]
        for k in range(len(self.crossings) - 1):
            streets += [straight(nodes, 2 * k + r, 2 * k + 2 + r, width) for r in (0, 1)]
        return RoadNetwork(nodes, tuple(streets))


def draw_plan(rng: np.random.Generator, size_m: float) -> FloorPlan:
    """A plan of about ``size_m`` metres in length."""
    corridor, outer = (float(v) for v in rng.uniform([2.0, 4.4], [2.8, 6.2]))
    core = float(rng.uniform(6.5, 12.0))
    wide = 2 * (outer + corridor) + core
    first, last = _STAIRS_M + corridor / 2, size_m - _STAIRS_M - corridor / 2
    count = max(2, round((last - first) / rng.uniform(14, 26)) + 1)
    crossings = np.linspace(first, last, count)
    crossings[1:-1] += rng.uniform(-2.0, 2.0, count - 2)
    ways = (corridor, outer, tuple(crossings.tolist()))
    rooms = _rooms(rng, (size_m, wide), *ways)
    ceiling, windows = (float(v) for v in rng.uniform([2.6, 1.4], [3.3, 2.4]))
    return FloorPlan((size_m, wide), rooms, *ways, ceiling + 0.4, ceiling, windows)


def _rooms(
    rng: np.random.Generator,
    size: tuple[float, float],
    corridor: float,
    outer: float,
    crossings: tuple[float, ...],
) -> tuple[Room, ...]:
    """Two rows of rooms with windows, and two between the corridors."""
    (long, wide), half = size, corridor / 2
    glazed = float(rng.choice([0.1, 0.3, 0.7]))
    rooms: list[Room] = []
    for low, high, front in ((0.0, outer, outer), (wide - outer, wide, wide - outer)):
        rooms += _row(rng, (0.0, long), (low, high), front, glazed)
    bottom, top = outer + corridor, wide - outer - corridor
    middle = wide / 2 + float(rng.uniform(-0.1, 0.1)) * (top - bottom)
    for a, b in pairwise(crossings):
        rooms += _row(rng, (a + half, b - half), (bottom, middle), bottom, glazed)
        rooms += _row(rng, (a + half, b - half), (middle, top), top, glazed)
    return tuple(rooms)


def _row(
    rng: np.random.Generator,
    along: tuple[float, float],
    across: tuple[float, float],
    front: float,
    glazed: float,
) -> list[Room]:
    """Rooms side by side, some of them alike."""
    usual = float(rng.uniform(3.0, 5.0))
    rooms, x = [], along[0]
    while along[1] - x > 1.6:
        pick = rng.random()
        wide = usual if pick < 0.5 else float(rng.uniform(2.8, 8.0))
        if along[1] - x - wide < 2.6:
            wide = along[1] - x
        if wide > 6.0:
            kind = str(rng.choice(["open", "meeting"]))
        else:
            kind = str(rng.choice(["office", "store", "niche"], p=[0.78, 0.12, 0.1]))
        door = x + float(rng.choice([0.75, wide - 0.75]))
        see = bool(rng.random() < glazed)
        rooms.append(Room((x, across[0]), (x + wide, across[1]), front, kind, door, see))
        x += wide
    return rooms


_MAKERS: dict[str, Callable[[np.random.Generator], Mesh]] = {
    "desk": desk,
    "cupboard": cupboard,
    "shelf": shelf,
    "table": table,
    "sofa": sofa,
    "plant": pot_plant,
    "printer": printer,
    "fixture": wall_things,
    "lockers": lockers,
}
_ABSENT = 0.12  # of the places, on each storey


@dataclass(frozen=True)
class Place:
    """Where something stands: kind, middle in the plan, and heading of its x axis."""

    kind: str
    x: float
    y: float
    yaw: float


def places(rng: np.random.Generator, plan: FloorPlan) -> list[Place]:
    """The places of all furniture; chairs are places, too."""
    found: list[Place] = []
    for room in plan.rooms:
        found += _OF_ROOMS[room.kind](rng, room)
    return found + _along_corridors(rng, plan)


def furnish(
    site: Fitting, found: list[Place], seed: int, storey: int, height: float, differ: float
) -> None:
    """Furnish a storey; ``differ`` is the share of places where storeys have nothing in common."""
    for k, place in enumerate(found):
        own = np.random.default_rng([seed, 8819, k, storey + 1])
        rng = own if own.random() < differ else np.random.default_rng([seed, 8819, k, 0])
        if rng.random() < _ABSENT:
            continue
        at = np.array([place.x, place.y])
        if place.kind == "chair":
            site.move_about("chair", at, place.yaw, storey)
            continue
        shift = rng.normal(0, 0.04, 2) * (place.kind not in ("fixture", "lockers"))
        mesh = _MAKERS[place.kind](rng)
        site.put(place.kind, mesh, at + shift, place.yaw + 0.02 * float(rng.normal()), height)


def _corner(room: Room, s: float, t: float) -> tuple[float, float]:
    """Plan coordinates ``s`` metres along the room's front and ``t`` metres into it."""
    return room.low[0] + s, room.front + room.into * t


def _by_side(room: Room, kind: str, right: bool, t: float, deep: float) -> Place:
    """Against one of the side walls, ``t`` metres into the room."""
    s = room.size[0] - 0.1 - deep / 2 if right else 0.1 + deep / 2
    return Place(kind, *_corner(room, s, t), np.pi if right else 0.0)


def _office(rng: np.random.Generator, room: Room) -> list[Place]:
    """Desks at the far wall, a cupboard or a shelf at the side away from the door."""
    wide, deep = room.size
    found = []
    count = max(1, int(wide / rng.uniform(2.0, 3.2)))
    facing = room.into * np.pi / 2
    turned = bool(rng.random() < 0.5)
    for k in range(count):
        s = wide * (k + 0.5) / count
        yaw = facing if turned else 0.0
        back = np.array([-np.cos(yaw), -np.sin(yaw)]) * 0.75
        x, y = _corner(room, s, deep - 1.2)
        found += [Place("desk", x, y, yaw), Place("chair", x + back[0], y + back[1], yaw)]
    right = room.door < (room.low[0] + room.high[0]) / 2
    for t in np.arange(0.9, deep - 2.4, 1.5):
        kind = str(rng.choice(["cupboard", "shelf", "shelf", "sofa"]))
        found.append(_by_side(room, kind, right, float(t), 0.5))
    found.append(Place("plant", *_corner(room, 0.5 if right else wide - 0.5, deep - 0.5), 0.0))
    return found


def _meeting(rng: np.random.Generator, room: Room) -> list[Place]:
    wide, deep = room.size
    yaw = np.pi / 2 if wide > deep else 0.0
    found = [Place("table", *_corner(room, wide / 2, deep / 2), yaw)]
    for turn in np.arange(0, 2 * np.pi, np.pi / int(rng.integers(2, 5))):
        reach = 1.3 * np.array([np.cos(turn), np.sin(turn)]) * [1.1, 0.8]
        x, y = _corner(room, wide / 2 + reach[0], deep / 2 + reach[1])
        found.append(Place("chair", x, y, float(np.arctan2(-room.into * reach[1], -reach[0]))))
    found.append(_by_side(room, "cupboard", bool(rng.random() < 0.5), deep - 1.2, 0.5))
    found.append(_by_side(room, "fixture", bool(rng.random() < 0.5), deep / 2, 0.0))
    return found


def _open(rng: np.random.Generator, room: Room) -> list[Place]:
    """Rows of desks, plants and cupboards between them."""
    wide, deep = room.size
    found = []
    for s in np.arange(1.3, wide - 0.8, rng.uniform(2.2, 3.0)):
        for t in np.arange(1.6, deep - 0.8, 1.9):
            x, y = _corner(room, float(s), float(t))
            found += [Place("desk", x, y, 0.0), Place("chair", x - 0.75, y, 0.0)]
    found.append(_by_side(room, "printer", bool(rng.random() < 0.5), 0.8, 0.6))
    found.append(_by_side(room, "cupboard", bool(rng.random() < 0.5), deep - 1.0, 0.5))
    return found


def _store(rng: np.random.Generator, room: Room) -> list[Place]:
    """Shelves along both sides."""
    deep = room.size[1]
    return [
        _by_side(room, str(rng.choice(["shelf", "shelf", "cupboard"])), right, float(t), 0.4)
        for right in (False, True)
        for t in np.arange(1.2, deep - 0.8, 1.7)
    ]


def _niche(rng: np.random.Generator, room: Room) -> list[Place]:
    """A copier, a sofa, plants."""
    wide, deep = room.size
    kind = str(rng.choice(["sofa", "printer", "table"]))
    x, y = _corner(room, wide / 2, deep - 0.8)
    found = [Place(kind, x, y, -room.into * np.pi / 2)]
    found.append(Place("plant", *_corner(room, 0.5, deep - 0.5), 0.0))
    return [*found, _by_side(room, "cupboard", bool(rng.random() < 0.5), 1.0, 0.5)]


_OF_ROOMS: dict[str, Callable[[np.random.Generator, Room], list[Place]]] = {
    "office": _office,
    "meeting": _meeting,
    "open": _open,
    "store": _store,
    "niche": _niche,
}


def _along_corridors(rng: np.random.Generator, plan: FloorPlan) -> list[Place]:
    """Lockers, extinguishers, radiators and boards on the corridors' walls, off the doors."""
    found = []
    busy = float(rng.uniform(0.1, 0.6))
    for room in plan.rooms:
        if room.kind == "niche" or room.glazed:
            continue
        for x in np.arange(room.low[0] + 0.9, room.high[0] - 0.7, 1.9):
            if abs(x - room.door) < 1.5 or not plan.in_corridor(float(x)) or rng.random() > busy:
                continue
            kind = str(rng.choice(["lockers", "fixture", "fixture"]))
            away = 0.1 + (0.2 if kind == "lockers" else 0.0)
            y = room.front - room.into * away
            found.append(Place(kind, float(x), y, -room.into * np.pi / 2))
    return found


_DOOR = (0.9, 2.05)  # width and height
_OUTER, _INNER = 0.35, 0.14  # thickness of walls
_SLAB = 0.25
_NONE = np.zeros((0, 4))
_ORIGIN = np.zeros(2)


def offices(seed: int, *, size_m: float = 60.0) -> World:
    """One storey of offices, ``size_m`` metres long; the same for the same seed."""
    return _erect("offices", seed, size_m, 1, 0.0, False)


def building(
    seed: int,
    *,
    size_m: float = 50.0,
    storeys: int = 5,
    differ: float = 0.5,
    own_rooms: bool = False,
) -> World:
    """Storeys of one plan above each other, with stairs at both ends.

    ``world.floor(k)`` is the floor of storey k, and ``Route(storey=k)`` leads over it.

    Parameters
    ----------
    size_m : float
        Length, metres.
    differ : float
        Share of the places where each storey has furniture of its own: 0 for storeys that are
        equal but for doors, chairs and people. Walls and doorways are the same on all.
    own_rooms : bool
        Each storey is divided into rooms of its own. Facades, corridors and stairs are the same.
    """
    if not 1 <= storeys <= 20:
        raise ConfigError(f"storeys must be in 1..20, not {storeys}")
    if not 0 <= differ <= 1:
        raise ConfigError(f"differ must be in 0..1, not {differ}")
    return _erect("building", seed, size_m, storeys, differ, own_rooms)


@remember
def _erect(
    name: str, seed: int, size_m: float, storeys: int, differ: float, own_rooms: bool
) -> World:
    check_world(seed, size_m, 30.0, 200.0)
    rng = np.random.default_rng([seed, 86_028_121])
    plan = draw_plan(rng, size_m)
    site = Fitting(rng, plan.size, plan.corridors())
    built, found = _structure(rng, plan), places(rng, plan)
    heights = tuple(plan.rise * k for k in range(storeys))
    for k, z in enumerate(heights):
        if own_rooms and k:
            own = np.random.default_rng([seed, 86_028_121, k])
            rooms = _rooms(own, plan.size, plan.corridor, plan.outer, plan.crossings)
            plan = replace(plan, rooms=rooms)
            built, found = _structure(own, plan), places(own, plan)
        for kind, mesh in built:
            site.put(kind, mesh, _ORIGIN, 0.0, z)
        _slabs(site, plan, k, storeys)
        _doors(site, plan, k)
        furnish(site, found, seed, k, z, differ)
    _stairs(site, plan, storeys)
    site.people = [np.array(street.at(s)[0]) for street in site.roads.streets for s in (3.0, 7.0)]
    return site.world(name, seed, storeys=heights)


def _structure(rng: np.random.Generator, plan: FloorPlan) -> list[tuple[str, Mesh]]:
    """Walls, windows and what hangs under the ceilings: of every storey."""
    walls = [_front(room, plan) for room in plan.rooms if room.kind != "niche"]
    walls += [_sides(room, plan) for room in plan.rooms]
    items = [("wall", mesh) for mesh in (*walls, *_facades(plan), *_ends(plan))]
    return [*items, ("lamps", _lamps(plan)), ("duct", _ducts(rng, plan))]


def _front(room: Room, plan: FloorPlan) -> Mesh:
    """The wall between a room and its corridor: plaster or glass, with a doorway."""
    (x0, _), (x1, _), y = room.low, room.high, room.front
    left, right = room.door - _DOOR[0] / 2, room.door + _DOOR[0] / 2
    thick = 0.3 if room.kind == "store" else _INNER  # deep doorways
    if not room.glazed:
        hole = (left - x0, right - x0, 0.0, _DOOR[1])
        return wall([x0, y], [x1, y], (-0.05, plan.rise), [hole], thick=thick)
    spans = [(x0, left), (right, x1)]
    parts = [panes([a, y], [b, y], (0.0, plan.ceiling)) for a, b in spans if b - a > 0.3]
    frame = [[x, y, _DOOR[1] / 2] for x in (left, right)]
    parts.append(boxes(frame, [0.07, 0.1, _DOOR[1]], 0.4))
    parts.append(panes([left, y], [right, y], (_DOOR[1], plan.ceiling)))
    parts.append(wall([x0, y], [x1, y], (plan.ceiling, plan.rise), thick=_INNER))
    return join(parts)


def _sides(room: Room, plan: FloorPlan) -> Mesh:
    """The wall at a room's right end, and the one at its back."""
    (x0, y0), (x1, y1) = room.low, room.high
    back = y1 if room.into > 0 else y0
    top = (-0.05, plan.rise)
    side = wall([x1, y0], [x1, y1], top, thick=_INNER)
    if back in (0.0, plan.size[1]):
        return side
    return join([side, wall([x0, back], [x1, back], top, thick=_INNER)])


def _facades(plan: FloorPlan) -> list[Mesh]:
    """The long outer walls with their windows, and the plain short ones."""
    long, wide = plan.size
    x = np.arange(0.7, long - plan.windows, plan.windows)
    top = min(2.4, plan.ceiling - 0.1)
    holes = [(a, a + 0.75 * plan.windows, 0.9, top) for a in x]
    parts = []
    for y in (0.0, wide):
        parts.append(wall([0, y], [long, y], (-0.3, plan.rise), holes, thick=_OUTER))
        parts.append(join(panes([a, y], [b, y], (low, high)) for a, b, low, high in holes))
    parts += [wall([x, 0], [x, wide], (-0.3, plan.rise), thick=_OUTER) for x in (0.0, long)]
    return parts


def _ends(plan: FloorPlan) -> list[Mesh]:
    """The walls of the stairwells and at the corridors' ends, and the core's flanks."""
    parts, top, half = [], (-0.05, plan.rise), plan.corridor / 2
    low, high = plan.core
    for x, well in zip((plan.stairs[0, 2], plan.stairs[1, 0]), plan.stairs, strict=True):
        hole = (0.15, 1.25, 0.0, 2.2)
        parts.append(wall([x, low], [x, high], top, [hole], thick=_INNER))
        for y in (low, high):
            parts.append(wall([well[0], y], [well[2], y], top, thick=_INNER))
        for y in (low - plan.corridor, high):
            parts.append(wall([x, y], [x, y + plan.corridor], top, thick=_INNER))
    for x in plan.crossings[:-1]:
        parts.append(wall([x + half, low], [x + half, high], top, thick=_INNER))
    return parts


def _lamps(plan: FloorPlan) -> Mesh:
    """A row of lamps under the ceiling of each corridor."""
    x = np.arange(plan.crossings[0] + 1.0, plan.crossings[-1], 2.4)
    rows = [plan.outer + plan.corridor / 2, plan.size[1] - plan.outer - plan.corridor / 2]
    return boxes([[a, y, plan.ceiling - 0.04] for a in x for y in rows], [1.2, 0.16, 0.08], 0.7)


def _ducts(rng: np.random.Generator, plan: FloorPlan) -> Mesh:
    """Trays and pipes along the corridors, and beams across them."""
    begin, end = plan.crossings[0], plan.crossings[-1]
    middle, parts = (begin + end) / 2, []
    for y, up in ((plan.outer, 1), (plan.size[1] - plan.outer, -1)):
        z = plan.ceiling - 0.15
        parts.append(boxes([middle, y + up * 0.35, z], [end - begin, 0.3, 0.1], 0.3))
        pipe = np.array([[begin, y + up * 0.62, z], [end, y + up * 0.62, z]])
        parts.append(tubes(pipe[:1], pipe[1:], [0.04, 0.04], 0.3, sides=6))
        x = np.arange(begin + rng.uniform(2, 6), end, rng.uniform(5.0, 8.0))
        across = y + up * plan.corridor / 2
        girder = [[a, across, plan.ceiling - 0.12] for a in x]
        parts.append(boxes(girder, [0.3, plan.corridor, 0.24], 0.5))
    return join(parts)


def _slabs(site: Fitting, plan: FloorPlan, storey: int, storeys: int) -> None:
    """Ceiling and floor, with holes where stairs come up."""
    z, size = plan.rise * storey, np.array(plan.size)
    wells = plan.stairs + [0.1, 1.4, -0.1, -0.1]
    last = storey + 1 == storeys
    ceiling = slab(_ORIGIN, size, plan.ceiling, _NONE if last else wells, 0.7)
    site.put("ceiling", ceiling, _ORIGIN, 0.0, z)
    if storey:
        site.put("floor", slab(_ORIGIN, size, 0.0, wells, 0.35), _ORIGIN, 0.0, z)


def _doors(site: Fitting, plan: FloorPlan, storey: int) -> None:
    """A leaf in every doorway, its hinge such that it opens into the room."""
    for room in plan.rooms:
        if room.kind != "niche":
            hinge = np.array([room.door - room.into * _DOOR[0] / 2, room.front + room.into * 0.05])
            site.move_about("door", hinge, 0.0 if room.into > 0 else np.pi, storey)


def _stairs(site: Fitting, plan: FloorPlan, storeys: int) -> None:
    """Two flights and a landing from each storey to the next, at both ends."""
    rise = plan.rise
    for x0, y0, x1, y1 in plan.stairs:
        run = y1 - y0 - 2.8
        for k in range(storeys - 1):
            z = rise * k
            up = stair_flight(1.4, run, rise / 2)
            site.put("stairs", up, np.array([x1 - 0.85, y0 + 1.4]), np.pi / 2, z)
            site.put("stairs", up, np.array([x0 + 0.85, y1 - 1.4]), -np.pi / 2, z + rise / 2)
            landing = boxes([(x0 + x1) / 2, y1 - 0.7, 0.0], [x1 - x0 - 0.2, 1.4, _SLAB], 0.45)
            site.put("stairs", landing, _ORIGIN, 0.0, z + rise / 2 - _SLAB / 2)
