"""Where sessions lead: the way that is mapped, and ways that come back to it."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from segloc.errors import ConfigError

from .motion.platforms import Platform, Route
from .motion.traversal import SimulatedSequence, simulate_session
from .sensors.lidar import hdl64e
from .sensors.ranging import Lidar
from .worlds.town import town
from .worlds.world import Conditions, World

_LANES = (1.1, 0.2, 0.7, -0.4, 0.9)  # metres right of the centre line, session by session
_LANE_OF = 3.4  # half the width of a street that has room for all of these, metres
_DEMO_M = 500.0  # driven in each session of the demonstration


def mapped_way(world: World, rng: np.random.Generator, length_m: float) -> list[int]:
    """At least ``length_m`` through a world, by streets not taken before while there are any."""
    start = int(rng.integers(len(world.roads.nodes)))
    return world.roads.walk(rng, [start], length_m, avoid=[])


def way_back(
    world: World, rng: np.random.Generator, mapped: list[int], length_m: float
) -> list[int]:
    """Along the mapped way, off into streets it never took, back onto it the other way.

    Of several such drives the one whose three parts are most alike in length.
    """
    roads = world.roads
    if len(mapped) < 3:
        return roads.walk(rng, mapped[::-1], length_m, avoid=mapped)
    drives = []
    for _ in range(32):
        first = int(rng.integers(len(mapped) - 2))
        last = first + 2
        while last < len(mapped) and roads.length(mapped[first:last]) < 0.3 * length_m:
            last += 1
        route = roads.walk(rng, mapped[first:last], 0.2 * length_m, avoid=mapped)
        route = roads.join(route, mapped[::-1])
        left = max(0.0, length_m - roads.length(route))
        drives.append(roads.walk(rng, route, left, avoid=mapped))
    return max(drives, key=lambda route: min(_shares(world, route, mapped, length_m)))


def _shares(
    world: World, route: list[int], mapped: list[int], length: float
) -> tuple[float, float, float]:
    """Metres of the first ``length`` driven along a mapped route, against it, and off it."""
    with_it, against = set(pairwise(mapped)), set(pairwise(mapped[::-1]))
    shares, left = [0.0, 0.0, 0.0], length
    for pair in pairwise(route):
        metres = min(left, world.roads.length(list(pair)))
        shares[0 if pair in with_it else 1 if pair in against else 2] += metres
        left -= metres
    return shares[0], shares[1], shares[2]


def lane(world: World, session: int) -> float:
    """Metres right of the centre line, another in each session; less where ways are narrow."""
    narrowest = min(street.half_width for street in world.roads.streets)
    return _LANES[session % len(_LANES)] * min(1.0, narrowest / _LANE_OF)


def simulate_sessions(
    world: World,
    sensor: Lidar,
    conditions: list[Conditions],
    *,
    length_m: float,
    spacing_m: float = 2.0,
    seed: int = 0,
    platform: Platform | None = None,
    skew: bool = False,
    storey: int = 0,
) -> list[SimulatedSequence]:
    """One drive for each of the conditions, ``session_0`` and so on; their poses are the truth.

    Session 0 is the one to map. Each later one drives part of its way in another lane, leaves it
    for ways that the map never saw, and comes back along it in the opposite direction.

    Parameters
    ----------
    world : World
    sensor : Lidar
    conditions : list of Conditions
        Of each session.
    length_m : float
        Of each drive.
    spacing_m : float
        Between scans.
    seed : int
        Of routes and noise.
    platform : Platform, optional
        What carries the sensor; without one it is put from place to place at its own height.
    skew : bool
        Let the sensor move while it scans.
    storey : int
        Of a building; the ways are the same on all.
    """
    if not 0 < length_m < np.inf:
        raise ConfigError(f"length_m must be positive, not {length_m}")
    rng = np.random.default_rng([seed, 31])
    mapped = mapped_way(world, rng, length_m)
    drives = []
    for k, condition in enumerate(conditions):
        way = mapped if k == 0 else way_back(world, rng, mapped, length_m)
        route = Route(tuple(way), lane(world, k), spacing_m, length_m, storey)
        drives.append(
            simulate_session(
                world,
                k,
                route,
                sensor,
                seed,
                name=f"session_{k}",
                conditions=condition,
                platform=platform,
                skew=skew,
            )
        )
    return drives


def demo_sessions(
    seed: int = 0,
    *,
    sensor: Lidar | None = None,
    size_m: float = 330.0,
) -> dict[str, SimulatedSequence]:
    """Three drives: ``map``, ``revisit`` and ``elsewhere``.

    ``revisit`` is another session of the same town (other parked cars and people): it drives part
    of the mapped route in another lane, turns back over part of it in the opposite direction,
    and leaves it for streets that the map never saw. ``elsewhere`` is another town.
    """
    lidar = hdl64e(900) if sensor is None else sensor
    here, there = town(seed, size_m=size_m), town(seed + 1000, size_m=size_m)
    rng = np.random.default_rng([seed, 31])
    mapped = mapped_way(here, rng, _DEMO_M)
    again = way_back(here, rng, mapped, _DEMO_M)
    away = mapped_way(there, rng, _DEMO_M)
    routes = {
        "map": (here, 0, Route(tuple(mapped), length_m=_DEMO_M)),
        "revisit": (here, 1, Route(tuple(again), lane_offset_m=0.3, length_m=_DEMO_M)),
        "elsewhere": (there, 0, Route(tuple(away), length_m=_DEMO_M)),
    }
    return {
        name: simulate_session(world, session, route, lidar, seed, name=name)
        for name, (world, session, route) in routes.items()
    }
