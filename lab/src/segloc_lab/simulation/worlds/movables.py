"""What is moved about indoors from session to session: chairs, doors, trolleys, fork lifts."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from ..objects.furniture import chair, door_leaf, trolley
from ..objects.mesh import Mesh
from ..objects.storage import cage, fork_lift, pallet_load


class Movable(NamedTuple):
    """A kind of thing that stands elsewhere in each session.

    Attributes
    ----------
    kind : str
    make : callable
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
