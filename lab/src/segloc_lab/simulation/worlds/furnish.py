"""What stands in the rooms and corridors of an office storey, the same on others or not."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..objects.furniture import (
    cupboard,
    desk,
    lockers,
    pot_plant,
    printer,
    shelf,
    sofa,
    table,
    wall_things,
)
from ..objects.mesh import Mesh
from .fitting import Fitting
from .floorplan import FloorPlan, Room

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
