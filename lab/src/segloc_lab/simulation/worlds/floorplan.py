"""The plan of an office storey: two long corridors, ways across, rooms, stairs at both ends."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from segloc.types import Float64

from .roads import RoadNetwork, straight

_STAIRS_M = 3.4  # length of a stairwell along the building


@dataclass(frozen=True)
class Room:
    """A room of a plan.

    Attributes
    ----------
    low, high : (float, float)
        Opposite corners, metres.
    front : float
        y of the wall to the corridor: ``low[1]`` or ``high[1]``.
    kind : str
        "office", "meeting", "open" (plan), "store", or "niche", which is open to the corridor.
    door : float
        x of the middle of its door.
    glazed : bool
        Whether its front is of glass.
    """

    low: tuple[float, float]
    high: tuple[float, float]
    front: float
    kind: str
    door: float
    glazed: bool

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
    """The plan of a storey; what is not of its rooms, all storeys of a building have in common.

    Attributes
    ----------
    size : (float, float)
    rooms : tuple of Room
    corridor : float
        Width of the corridors.
    outer : float
        Depth of the rooms that have windows.
    crossings : tuple of float
        x of the middles of the corridors across.
    rise : float
        From floor to floor.
    ceiling : float
        Height of the ceilings.
    windows : float
        Width of a window and the wall beside it.
    """

    size: tuple[float, float]
    rooms: tuple[Room, ...]
    corridor: float
    outer: float
    crossings: tuple[float, ...]
    rise: float
    ceiling: float
    windows: float
    core: tuple[float, float] = field(init=False)
    stairs: Float64 = field(init=False, compare=False)

    def __post_init__(self) -> None:
        low = self.outer + self.corridor
        core = (low, self.size[1] - low)
        object.__setattr__(self, "core", core)
        ends = (0.0, self.size[0] - _STAIRS_M)
        wells = np.array([(x, core[0], x + _STAIRS_M, core[1]) for x in ends])
        object.__setattr__(self, "stairs", wells)

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
    rooms = _rooms(rng, (size_m, wide), corridor, outer, crossings)
    ceiling = float(rng.uniform(2.6, 3.3))
    return FloorPlan(
        (size_m, wide),
        rooms,
        corridor,
        outer,
        tuple(crossings.tolist()),
        ceiling + 0.4,
        ceiling,
        float(rng.uniform(1.4, 2.4)),
    )


def divided_anew(plan: FloorPlan, rng: np.random.Generator) -> FloorPlan:
    """The same shell, corridors and stairs, with other rooms."""
    crossings = np.array(plan.crossings)
    return replace(plan, rooms=_rooms(rng, plan.size, plan.corridor, plan.outer, crossings))


def _rooms(
    rng: np.random.Generator,
    size: tuple[float, float],
    corridor: float,
    outer: float,
    crossings: Float64,
) -> tuple[Room, ...]:
    """Two rows of rooms with windows, and two between the corridors."""
    long, wide = size
    glazed = float(rng.choice([0.1, 0.3, 0.7]))
    rooms: list[Room] = []
    for low, high, front in ((0.0, outer, outer), (wide - outer, wide, wide - outer)):
        rooms += _row(rng, (0.0, long), (low, high), front, glazed)
    bottom, top = outer + corridor, wide - outer - corridor
    middle = wide / 2 + float(rng.uniform(-0.1, 0.1)) * (top - bottom)
    for a, b in zip(crossings[:-1] + corridor / 2, crossings[1:] - corridor / 2, strict=True):
        rooms += _row(rng, (a, b), (bottom, middle), bottom, glazed)
        rooms += _row(rng, (a, b), (middle, top), top, glazed)
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
