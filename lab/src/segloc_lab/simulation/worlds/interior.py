"""Where a building is: a turned rectangle with storeys."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from segloc.types import Float64

from ..objects.fixtures import (
    bench,
    bollards,
    cabinet,
    litter_bin,
    name_sign,
    skip_container,
    traffic_sign,
    wheelie_bin,
)
from ..objects.furniture import (
    cage,
    chair,
    cupboard,
    desk,
    door_leaf,
    fork_lift,
    machine,
    pallet_load,
    pot_plant,
    printer,
    shelf,
    sofa,
    table,
    trolley,
)
from ..objects.mesh import Mesh
from ..objects.vegetation import bush, tree
from ..objects.works import barriers, drums, pallets, rubble, shipping_container, stores

_FOOT = 0.4  # what stands on a floor may begin this far below it, metres


@dataclass(frozen=True)
class Interior:
    """The inside of a building.

    Attributes
    ----------
    size : (float, float)
        Of its plan, metres.
    turn : float
        Heading of the plan's x axis, radians.
    corner : (float, float)
        World coordinates of the plan's origin.
    storeys : tuple of float
        Heights of the floors above the lowest, rising from 0, metres.
    """

    size: tuple[float, float]
    turn: float = 0.0
    corner: tuple[float, float] = (0.0, 0.0)
    storeys: tuple[float, ...] = (0.0,)

    def to_world(self, plan: ArrayLike) -> Float64:
        """World coordinates (..., 2) of points (..., 2) of the plan."""
        c, s = np.cos(self.turn), np.sin(self.turn)
        points = np.asarray(plan, dtype=float) @ np.array([[c, s], [-s, c]])
        return np.asarray(points + self.corner, dtype=np.float64)

    def to_plan(self, world: ArrayLike) -> Float64:
        """Points (..., 2) of the plan for world coordinates (..., 2)."""
        c, s = np.cos(self.turn), np.sin(self.turn)
        points = np.asarray(world, dtype=float) - self.corner
        return np.asarray(points @ np.array([[c, -s], [s, c]]), dtype=np.float64)

    def inside(self, world: ArrayLike) -> NDArray[np.bool_]:
        """Which of the world coordinates (..., 2) lie at least a metre inside the outer walls."""
        plan = self.to_plan(world)
        within = (plan > 1.0) & (plan < np.array(self.size) - 1.0)
        return np.asarray(within.all(axis=-1))

    def storey(self, height: float) -> int:
        """The storey that something stands on whose foot is so high above the lowest floor."""
        return max(0, int(np.searchsorted(self.storeys, height + _FOOT, side="right")) - 1)


@dataclass(frozen=True)
class Replaceable:
    """A kind of object that may be gone in another session, and what then stands elsewhere.

    Attributes
    ----------
    make : callable
        Makes another of its kind.
    radius : float
        Of the ground that it needs, metres.
    tallest : float
        What is higher stays, metres.
    in_place : bool
        Whether the other one stands where the first stood, as goods on a shelf do.
    """

    make: Callable[[np.random.Generator], Mesh]
    radius: float
    tallest: float = np.inf
    in_place: bool = False


def _small_tree(rng: np.random.Generator) -> Mesh:
    return tree(rng, float(rng.uniform(2.5, 5.5)))


REPLACEABLE: dict[str, Replaceable] = {
    "bench": Replaceable(bench, 1.1),
    "bin": Replaceable(wheelie_bin, 0.5),
    "litter bin": Replaceable(litter_bin, 0.4),
    "bollards": Replaceable(bollards, 1.5),
    "bush": Replaceable(bush, 1.3),
    "traffic sign": Replaceable(traffic_sign, 0.4),
    "name sign": Replaceable(name_sign, 1.2),
    "cabinet": Replaceable(cabinet, 0.8),
    "container": Replaceable(skip_container, 1.8),
    "tree": Replaceable(_small_tree, 1.0, tallest=6.0),
    "shipping container": Replaceable(shipping_container, 3.4, tallest=3.2),
    "pallets": Replaceable(pallets, 0.9),
    "drums": Replaceable(drums, 1.2),
    "barrier": Replaceable(barriers, 3.5),
    "rubble": Replaceable(rubble, 3.2),
    "stores": Replaceable(stores, 1.2, in_place=True),
    "goods": Replaceable(pallet_load, 0.9, in_place=True),
    "cages": Replaceable(cage, 1.6),
    "machine": Replaceable(machine, 2.2),
    "desk": Replaceable(desk, 1.0, in_place=True),
    "cupboard": Replaceable(cupboard, 1.2, in_place=True),
    "shelf": Replaceable(shelf, 0.9, in_place=True),
    "table": Replaceable(table, 1.6, in_place=True),
    "sofa": Replaceable(sofa, 1.1, in_place=True),
    "plant": Replaceable(pot_plant, 0.4),
    "printer": Replaceable(printer, 0.6, in_place=True),
}
"""By kind. Of each the share that :class:`Conditions` names is replaced."""


class Movable(NamedTuple):
    """A kind of thing that stands elsewhere in each session.

    Attributes
    ----------
    odds : float
        That one stands at a place for it.
    shift_m, turn : float
        Standard deviations about the place and its heading, metres and radians.
    """

    kind: str
    make: Callable[[np.random.Generator], Mesh]
    odds: float
    shift_m: float
    turn: float


MOVABLES: tuple[Movable, ...] = (
    Movable("door", door_leaf, 1.0, 0.0, 0.0),
    Movable("chair", chair, 0.9, 0.2, 1.0),
    Movable("trolley", trolley, 0.4, 0.2, 0.3),
    Movable("goods", pallet_load, 0.5, 0.1, 0.1),
    Movable("cages", cage, 0.5, 0.3, 0.1),
    Movable("fork lift", fork_lift, 0.4, 0.2, 0.3),
)
"""Places name them by their number here."""

NUMBER = {each.kind: k for k, each in enumerate(MOVABLES)}
