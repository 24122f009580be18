"""Offices: a storey of rooms along corridors, or several above each other."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from segloc.errors import ConfigError

from ..objects.mesh import Mesh, boxes, join, tubes
from ..objects.shell import panes, slab, stair_flight, wall
from .fitting import Fitting
from .floorplan import FloorPlan, Room, divided_anew, draw_plan
from .furnish import furnish, places
from .layout import check_world
from .world import World

_DOOR = (0.9, 2.05)  # width and height
_OUTER, _INNER = 0.35, 0.14  # thickness of walls
_SLAB = 0.25
_NONE = np.zeros((0, 4))
_ORIGIN = np.zeros(2)


@lru_cache(maxsize=2)
def offices(seed: int, *, size_m: float = 60.0) -> World:
    """One storey of offices, ``size_m`` metres long; the same for the same seed.

    Raises
    ------
    ConfigError
        If ``size_m`` is not in 30..200 or the seed is negative.
    """
    return _erect("offices", seed, size_m, 1, 0.0, False)


@lru_cache(maxsize=2)
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
    seed : int
    size_m : float
        Length, metres.
    storeys : int
    differ : float
        Share of the places where each storey has furniture of its own: 0 for storeys that are
        equal but for doors, chairs and people. Walls and doorways are the same on all.
    own_rooms : bool
        Each storey is divided into rooms of its own. Facades, corridors and stairs are the same.

    Raises
    ------
    ConfigError
        If ``size_m`` is not in 30..200, ``storeys`` not in 1..20, ``differ`` not in 0..1, or the
        seed is negative.
    """
    if not 1 <= storeys <= 20:
        raise ConfigError(f"storeys must be in 1..20, not {storeys}")
    if not 0 <= differ <= 1:
        raise ConfigError(f"differ must be in 0..1, not {differ}")
    return _erect("building", seed, size_m, storeys, differ, own_rooms)


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
            plan = divided_anew(plan, own)
            built, found = _structure(own, plan), places(own, plan)
        for kind, mesh in built:
            site.put(kind, mesh, _ORIGIN, 0.0, z)
        _slabs(site, plan, k, storeys)
        _doors(site, plan, k)
        furnish(site, found, seed, k, z, differ)
    _stairs(site, plan, storeys)
    site.people = [np.array(street.at(s)[0]) for street in site.roads.streets for s in (3.0, 7.0)]
    arguments = (name, seed, size_m, storeys, differ, own_rooms)
    return site.world(name, seed, (_remake, arguments), storeys=heights)


def _remake(
    name: str, seed: int, size_m: float, storeys: int, differ: float, own_rooms: bool
) -> World:
    if name == "offices":
        return offices(seed, size_m=size_m)
    return building(seed, size_m=size_m, storeys=storeys, differ=differ, own_rooms=own_rooms)


def _structure(rng: np.random.Generator, plan: FloorPlan) -> list[tuple[str, Mesh]]:
    """Walls, windows and what hangs under the ceilings: of every storey."""
    items = [("wall", _front(room, plan)) for room in plan.rooms if room.kind != "niche"]
    items += [("wall", _sides(room, plan)) for room in plan.rooms]
    items += [("wall", mesh) for mesh in _facades(plan)]
    items += [("wall", mesh) for mesh in _ends(plan)]
    items.append(("lamps", _lamps(plan)))
    items.append(("duct", _ducts(rng, plan)))
    return items


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
        sheets = [panes([a, y], [b, y], (low, high)) for a, b, low, high in holes]
        parts.append(join(sheets))
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
