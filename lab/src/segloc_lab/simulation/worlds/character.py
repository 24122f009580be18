"""How towns differ: green suburbs, dense old towns, wide streets with traffic."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

BUILDINGS = ("villas", "terrace", "flats", "mixed", "green")


@dataclass(frozen=True)
class Character:
    """What the streets of one town have in common.

    Attributes
    ----------
    name : str
    buildings : tuple of float
        Shares of :data:`BUILDINGS`.
    half_width : (float, float)
        From the centre line of a street to its kerb, metres.
    pavement : (float, float)
        Width, metres.
    setback : float
        Times the usual depth of front gardens.
    green : float
        How much grows, 0 to 1.
    parked : float
        Share of the places by the kerb that are taken.
    """

    name: str
    buildings: tuple[float, ...]
    half_width: tuple[float, float]
    pavement: tuple[float, float]
    setback: float
    green: float
    parked: float


def draw_character(rng: np.random.Generator) -> Character:
    """One of four kinds of town, its shares and measures shaken."""
    kind = str(rng.choice(["suburb", "old town", "avenues", "mixed"], p=[0.4, 0.2, 0.15, 0.25]))
    shares, narrow, pavement, setback, green = {
        "suburb": ((0.55, 0.15, 0.03, 0.12, 0.15), 3.4, (1.2, 2.4), 1.05, (0.65, 1.0)),
        "old town": ((0.05, 0.7, 0.1, 0.15, 0.0), 3.3, (0.9, 1.8), 0.6, (0.05, 0.4)),
        "avenues": ((0.15, 0.2, 0.45, 0.15, 0.05), 5.6, (2.2, 4.0), 1.0, (0.35, 0.9)),
        "mixed": ((0.34, 0.24, 0.12, 0.2, 0.1), 3.4, (1.3, 2.6), 0.9, (0.4, 0.95)),
    }[kind]
    drawn = rng.dirichlet(15 * np.array(shares) + 0.05)
    return Character(
        name=kind,
        buildings=tuple(float(share) for share in drawn),
        half_width=(narrow, narrow + float(rng.uniform(0.6, 1.6))),
        pavement=pavement,
        setback=setback * float(rng.uniform(0.75, 1.2)),
        green=float(rng.uniform(*green)),
        parked=float(rng.uniform(0.7, 1.0)),
    )
