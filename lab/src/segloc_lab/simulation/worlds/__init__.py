"""Towns, parks, meadows, forests and industrial sites, drawn from a seed."""

from __future__ import annotations

from collections.abc import Callable

from .car_park import car_park
from .forest import forest
from .industrial import industrial
from .meadow import meadow
from .mine import mine
from .offices import building, offices
from .park import park
from .town import terraces, town
from .warehouse import warehouse
from .world import World

SCENES: dict[str, Callable[..., World]] = {
    "building": building,
    "car_park": car_park,
    "forest": forest,
    "industrial": industrial,
    "meadow": meadow,
    "mine": mine,
    "offices": offices,
    "park": park,
    "terraces": terraces,
    "town": town,
    "warehouse": warehouse,
}
"""Each is called with a seed, and ``size_m`` where its own default does not do.

Those that are built of things from a catalogue also take ``repetition``: car_park, forest, terraces
and town."""
