"""Kinds of trees: the proportions that each tree of a kind is drawn from."""

from __future__ import annotations

from dataclasses import dataclass

Range = tuple[float, float]


@dataclass(frozen=True)
class Species:
    """What trees of a kind have in common; pairs are the ranges that each tree is drawn from.

    Attributes
    ----------
    height : (low, high)
        Metres.
    girth : (low, high)
        Radius of the trunk over its height.
    bare : (low, high)
        Where the crown begins, as a share of the height.
    spread : (low, high)
        Radius of the crown over the height.
    crown : tuple of float
        Reach of the branches at even steps from the foot of the crown to its top.
    branches : (low, high)
        Number of branches.
    rise : (low, high)
        Elevation of the lowest and of the highest branches, radians.
    droop : float
        How far tips sink, as a share of the branch's length.
    hang : float
        How much twigs hang down: 0 for not at all, 1 for a willow.
    leaves : (low, high)
        Scraps of foliage a metre of twig.
    leaf : float
        Size of a scrap, metres.
    stems : (low, high)
        Stems from one root.
    lean : float
        Standard deviation of the lean, rise over run.
    forked : float
        Probability that the trunk divides.
    bark : float
        Reflectance.
    """

    height: Range
    girth: Range
    bare: Range
    spread: Range
    crown: tuple[float, ...]
    branches: tuple[int, int]
    rise: Range = (0.3, 1.0)
    droop: float = 0.1
    hang: float = 0.0
    leaves: Range = (5.0, 9.0)
    leaf: float = 0.17
    stems: tuple[int, int] = (1, 1)
    lean: float = 0.03
    forked: float = 0.0
    bark: float = 0.35


_DOME = (0.75, 1.0, 1.0, 0.85, 0.5)
_CONE = (1.0, 0.85, 0.6, 0.35, 0.05)
_COLUMN = (0.6, 1.0, 0.9, 0.6, 0.2)
_VASE = (0.4, 0.7, 0.95, 1.0, 0.7)

SPECIES: dict[str, Species] = {
    "oak": Species(
        (9.0, 19.0), (0.022, 0.036), (0.18, 0.36), (0.28, 0.44), _DOME, (11, 22),
        rise=(0.15, 1.1), droop=0.05, forked=0.6, lean=0.04, bark=0.3,
    ),
    "beech": Species(
        (16.0, 27.0), (0.011, 0.019), (0.38, 0.6), (0.16, 0.27), _DOME, (12, 22),
        rise=(0.5, 1.2), forked=0.25, leaves=(5.0, 8.0), bark=0.5,
    ),
    "ash": Species(
        (10.0, 22.0), (0.012, 0.02), (0.25, 0.5), (0.18, 0.3), _VASE, (9, 17),
        rise=(0.6, 1.2), forked=0.45, leaves=(3.0, 6.0), bark=0.4,
    ),
    "lime": Species(
        (10.0, 21.0), (0.015, 0.026), (0.14, 0.28), (0.2, 0.32), _COLUMN, (16, 28),
        rise=(0.2, 1.2), forked=0.3, leaves=(6.0, 10.0), bark=0.3,
    ),
    "birch": Species(
        (8.0, 17.0), (0.006, 0.011), (0.25, 0.5), (0.13, 0.22), _COLUMN, (12, 22),
        rise=(0.6, 1.2), droop=0.3, hang=0.4, leaves=(3.0, 6.0), leaf=0.12,
        stems=(1, 2), lean=0.06, forked=0.15, bark=0.65,
    ),
    "willow": Species(
        (6.0, 14.0), (0.02, 0.035), (0.2, 0.35), (0.35, 0.5), _DOME, (14, 24),
        rise=(0.5, 1.1), droop=0.35, hang=1.0, leaves=(3.5, 6.0), leaf=0.14,
        lean=0.08, forked=0.7, bark=0.3,
    ),
    "spruce": Species(
        (11.0, 24.0), (0.009, 0.014), (0.08, 0.35), (0.12, 0.2), _CONE, (36, 60),
        rise=(-0.25, 0.5), droop=0.15, leaves=(6.0, 9.0), leaf=0.13, lean=0.015,
    ),
    "pine": Species(
        (12.0, 22.0), (0.009, 0.016), (0.5, 0.72), (0.13, 0.22), _DOME, (14, 26),
        rise=(0.0, 0.7), leaves=(5.0, 9.0), leaf=0.14, lean=0.04, forked=0.1,
    ),
    "yew": Species(
        (3.0, 8.0), (0.03, 0.05), (0.04, 0.15), (0.3, 0.5), _DOME, (16, 30),
        rise=(0.2, 1.1), leaves=(9.0, 15.0), leaf=0.12, forked=0.5, bark=0.3,
    ),
    "hawthorn": Species(
        (2.5, 6.0), (0.018, 0.03), (0.1, 0.3), (0.3, 0.5), _DOME, (12, 22),
        rise=(0.2, 1.0), leaves=(7.0, 14.0), leaf=0.1, stems=(1, 4), lean=0.12, forked=0.4,
    ),
    "hazel": Species(
        (2.5, 6.0), (0.007, 0.011), (0.15, 0.3), (0.18, 0.3), _VASE, (14, 26),
        rise=(0.7, 1.2), leaves=(5.0, 9.0), leaf=0.13, stems=(4, 9), lean=0.22,
    ),
    "sapling": Species(
        (1.2, 4.0), (0.005, 0.009), (0.15, 0.4), (0.16, 0.3), _COLUMN, (5, 12),
        rise=(0.4, 1.0), leaves=(5.0, 10.0), leaf=0.11, lean=0.08, bark=0.4,
    ),
    "snag": Species(
        (3.0, 13.0), (0.016, 0.035), (0.25, 0.5), (0.08, 0.22), _VASE, (2, 9),
        rise=(0.0, 0.9), leaves=(0.0, 0.0), lean=0.09, forked=0.3, bark=0.45,
    ),
}  # fmt: skip
"""Broadleaves, conifers, shrubs of tree shape, and dead wood."""

EVERGREEN = frozenset({"spruce", "pine", "yew"})
"""Species that keep their leaves in winter."""
