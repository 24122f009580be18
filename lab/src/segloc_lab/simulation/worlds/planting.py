"""What grows in towns: street and garden trees, ivy on walls, wild corners."""

from __future__ import annotations

import numpy as np

from segloc.types import Float64

from ..objects.mesh import Mesh, join, scraps
from ..objects.species import SPECIES
from ..objects.trees import grow
from ..objects.vegetation import bush, shrubs, tree
from .layout import Site

_TOWN_TREES = ("lime", "ash", "birch", "oak", "hawthorn", "yew", "pine", "willow")
_DETAIL = 0.7


def town_tree(rng: np.random.Generator, low: float, high: float) -> Mesh:
    """A tree between ``low`` and ``high`` metres, of a species that grows in towns."""
    tall = float(rng.uniform(low, high))
    if rng.random() < 0.4:
        return tree(rng, tall)
    species = str(rng.choice(_TOWN_TREES))
    usual = float(np.mean(SPECIES[species].height))
    return grow(rng, species, detail=_DETAIL, scale=tall / usual)


def ivy(rng: np.random.Generator, width: float, depth: float, height: float) -> Mesh:
    """Climbers on the walls of a building of the given plan, centred on the origin."""
    parts = []
    for _ in range(int(rng.integers(1, 4))):
        long, across = ((width, depth), (depth, width))[int(rng.random() < 0.35)]
        turn = np.pi / 2 * float(rng.choice([0, 0, 2] if long == width else [1, 3]))
        wide, high = rng.uniform(0.15, 0.7) * long, rng.uniform(0.3, 1.0) * height
        foot = rng.uniform(-0.5, 0.5) * (long - wide)
        count = int(wide * high * rng.uniform(35, 70))
        up = rng.uniform(0, 1, count)
        x = foot + wide * rng.normal(0, 0.25, count) * (1 - 0.6 * up)
        out = across / 2 + 0.05 + rng.exponential(0.09, count)
        spots = np.column_stack([np.clip(x, -long / 2, long / 2), -out, up * high])
        parts.append(scraps(rng, spots, 0.12, 0.5).moved([0, 0, 0], turn))
    return join(parts)


def _plant(site: Site, at: Float64, tallest: float) -> bool:
    """A tree or bush at random on a spot, if it is free."""
    rng = site.rng
    if tallest > 3 and rng.random() < 0.5:
        return site.stand("tree", town_tree(rng, 2.5, tallest), at, float(rng.uniform(0, 6)), 0.8)
    return site.stand("bush", bush(rng), at, float(rng.uniform(0, 6)), 1.0)


def thicket(site: Site, corners: Float64) -> None:
    """Bushes, shrubs and trees all over a quadrilateral, (4, 2) corners in cyclic order."""
    rng = site.rng
    a, b, c, d = corners
    area = float(np.linalg.norm(b - a) * np.linalg.norm(d - a))
    for u, v in rng.random((int(area / rng.uniform(5, 14)), 2)):
        at = (1 - v) * ((1 - u) * a + u * b) + v * ((1 - u) * d + u * c)
        if site.roads.clearance(at) > 2.0:
            _plant(site, at, 12.0)
    if rng.random() < 0.5:
        t = np.linspace(0.05, 0.95, max(3, int(np.linalg.norm(b - a) / 1.5)))[:, None]
        line = (1 - t) * a + t * b
        if site.clear_line(line, 1.0):
            site.items.append(("shrubs", shrubs(rng, site.ground_line(line))))
