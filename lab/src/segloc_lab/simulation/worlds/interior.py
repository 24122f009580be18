"""Where a building is: a turned rectangle with storeys."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from segloc.types import Float64

from ..objects import fixtures, furniture, vegetation, works
from ..objects.mesh import Mesh, rotation

_FOOT = 0.4  # what stands on a floor may begin this far below it, metres


@dataclass(frozen=True)
class Interior:
    """The inside of a building."""

    size: tuple[float, float]  # of its plan, metres
    turn: float = 0.0  # heading of the plan's x axis, radians
    corner: tuple[float, float] = (0.0, 0.0)  # world coordinates of the plan's origin
    storeys: tuple[float, ...] = (0.0,)  # heights of the floors above the lowest, metres

    def to_world(self, plan: ArrayLike) -> Float64:
        """World coordinates (..., 2) of points (..., 2) of the plan."""
        return np.asarray(plan, dtype=float) @ rotation(self.turn) + self.corner

    def inside(self, world: ArrayLike) -> NDArray[np.bool_]:
        """Which of the world coordinates (..., 2) lie at least a metre inside the outer walls."""
        plan = (np.asarray(world, dtype=float) - self.corner) @ rotation(self.turn).T
        within = (plan > 1.0) & (plan < np.array(self.size) - 1.0)
        return np.asarray(within.all(axis=-1))

    def storey(self, height: float) -> int:
        """The storey that something stands on whose foot is so high above the lowest floor."""
        return max(0, int(np.searchsorted(self.storeys, height + _FOOT, side="right")) - 1)


@dataclass(frozen=True)
class Replaceable:
    """A kind of object that may be gone in another session, and what then stands elsewhere."""

    make: Callable[[np.random.Generator], Mesh]  # another of its kind
    radius: float  # of the ground that it needs, metres
    tallest: float = np.inf  # what is higher stays, metres
    in_place: bool = False  # the other stands where the first stood, as goods on a shelf do


def _small_tree(rng: np.random.Generator) -> Mesh:
    return vegetation.tree(rng, float(rng.uniform(2.5, 5.5)))


REPLACEABLE: dict[str, Replaceable] = {
    "bench": Replaceable(fixtures.bench, 1.1),
    "bin": Replaceable(fixtures.wheelie_bin, 0.5),
    "litter bin": Replaceable(fixtures.litter_bin, 0.4),
    "bollards": Replaceable(fixtures.bollards, 1.5),
    "bush": Replaceable(vegetation.bush, 1.3),
    "traffic sign": Replaceable(fixtures.traffic_sign, 0.4),
    "name sign": Replaceable(fixtures.name_sign, 1.2),
    "cabinet": Replaceable(fixtures.cabinet, 0.8),
    "container": Replaceable(fixtures.skip_container, 1.8),
    "tree": Replaceable(_small_tree, 1.0, tallest=6.0),
    "shipping container": Replaceable(works.shipping_container, 3.4, tallest=3.2),
    "pallets": Replaceable(works.pallets, 0.9),
    "drums": Replaceable(works.drums, 1.2),
    "barrier": Replaceable(works.barriers, 3.5),
    "rubble": Replaceable(works.rubble, 3.2),
    "stores": Replaceable(works.stores, 1.2, in_place=True),
    "goods": Replaceable(furniture.pallet_load, 0.9, in_place=True),
    "cages": Replaceable(furniture.cage, 1.6),
    "machine": Replaceable(furniture.machine, 2.2),
    "desk": Replaceable(furniture.desk, 1.0, in_place=True),
    "cupboard": Replaceable(furniture.cupboard, 1.2, in_place=True),
    "shelf": Replaceable(furniture.shelf, 0.9, in_place=True),
    "table": Replaceable(furniture.table, 1.6, in_place=True),
    "sofa": Replaceable(furniture.sofa, 1.1, in_place=True),
    "plant": Replaceable(furniture.pot_plant, 0.4),
    "printer": Replaceable(furniture.printer, 0.6, in_place=True),
}
"""By kind. Of each the share that :class:`Conditions` names is replaced."""


class Movable(NamedTuple):
    """A kind of thing that stands elsewhere in each session."""

    kind: str
    make: Callable[[np.random.Generator], Mesh]
    odds: float  # that one stands at a place for it
    shift_m: float  # standard deviation about the place
    turn: float  # standard deviation of its heading, radians


MOVABLES: tuple[Movable, ...] = (
    Movable("door", furniture.door_leaf, 1.0, 0.0, 0.0),
    Movable("chair", furniture.chair, 0.9, 0.2, 1.0),
    Movable("trolley", furniture.trolley, 0.4, 0.2, 0.3),
    Movable("goods", furniture.pallet_load, 0.5, 0.1, 0.1),
    Movable("cages", furniture.cage, 0.5, 0.3, 0.1),
    Movable("fork lift", furniture.fork_lift, 0.4, 0.2, 0.3),
)
"""Places name them by their number here."""

NUMBER = {each.kind: k for k, each in enumerate(MOVABLES)}
