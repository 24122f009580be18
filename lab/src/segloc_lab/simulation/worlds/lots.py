"""Lots along a street: houses, and the gardens, hedges, walls and drives about them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from segloc.types import Float64

from ..objects.buildings import Building, garage, house
from ..objects.fixtures import fence, garden_wall, wheelie_bin
from ..objects.mesh import join
from ..objects.vegetation import bush, hedge, shrubs, trimmed_box_bush
from .layout import Frontage, Site, ivy, thicket, town_tree


@dataclass(frozen=True)
class Lot:
    """A stretch of a frontage, from ``begin`` to ``end`` along the street."""

    front: Frontage
    begin: float
    end: float
    house_width: float  # 0 where nothing could be built
    setback: float  # depth of the front garden
    gap: float  # width left beside the house


def build_along(site: Site, front: Frontage) -> list[Lot]:
    """Divide a frontage into lots and build on those where there is room."""
    rng, lots = site.rng, []
    s = float(rng.uniform(3, 9))
    while s < front.street.length - 6:
        source = site.like(f"house {front.character}")
        building, setback, gap = _draw_building(source, front.character)
        setback *= front.setback
        width = building.width + gap if building else float(rng.uniform(8, 18))
        beyond = front.pavement + setback
        placed = building is not None and _place(site, front, building, s + width / 2, beyond)
        built = building.width if building is not None and placed else 0.0
        lots.append(Lot(front, s, s + width, built, setback, gap))
        s += width
    return lots


def dress(site: Site, lot: Lot) -> None:
    """Hedges, walls, gardens, a drive: what lies before and between the houses."""
    if lot.setback > 1.2 or not lot.house_width:
        _front_edge(site, lot.front, lot.begin, lot.end)
    if lot.house_width and lot.setback > 1.6:
        _front_garden(site, lot)
    if not lot.house_width and site.rng.random() < 0.3 + 0.6 * site.green:
        reach = site.rng.uniform(4, 14)
        along = np.array([lot.begin, lot.end, lot.end, lot.begin])
        thicket(site, lot.front.at(along, lot.front.pavement + np.array([1, 1, reach, reach]))[0])
    if lot.gap > 1.0 or not lot.house_width:
        _divider(site, lot.front, lot.begin, float(site.rng.uniform(6, 18)))
    if lot.gap > 3.2 and lot.house_width:
        _beside(site, lot)


def _draw_building(
    rng: np.random.Generator, character: str
) -> tuple[Building | None, float, float]:
    """A building, its distance from the pavement, and the gap after it."""
    kind = str(rng.choice(["villas", "terrace", "flats"])) if character == "mixed" else character
    if kind == "green":
        if rng.random() < 0.6:
            return None, 3.0, 0.0
        kind = "villas"
    if kind == "terrace":
        plan = rng.uniform([5.2, 8.0], [9.5, 11.5])
        gap = float(rng.choice([0.02, 0.02, 0.02, 1.2, 3.6]))
        setback = float(rng.choice([0.05, 0.3, 1.5, 2.6]) + rng.uniform(0, 0.5))
        return house(rng, *plan, floors=int(rng.integers(2, 4))), setback, gap
    if kind == "flats":
        plan = rng.uniform([14.0, 10.0], [24.0, 13.0])
        block = house(rng, *plan, floors=int(rng.integers(3, 6)), flats=True)
        return block, float(rng.uniform(0.2, 5.0)), float(rng.uniform(2.0, 9.0))
    plan = rng.uniform([7.5, 7.0], [14.0, 11.0])
    villa = house(rng, *plan, floors=int(rng.choice([1, 2, 2, 3])))
    return villa, float(rng.uniform(1.0, 6.5)), float(rng.uniform(2.0, 7.0))


def _place(site: Site, front: Frontage, building: Building, s: float, beyond_kerb: float) -> bool:
    """Put a building with its front on a line along the street, unless it would stand on others.

    Nor may it stand on any street.
    """
    at, yaw = front.at(s, beyond_kerb + building.depth / 2)
    turn = float(yaw + site.rng.normal(0, 0.012))
    mesh, plan = building.mesh, (building.width, building.depth)
    if site.rng.random() < 0.5 * site.green:
        high = min(6.5, float(mesh.triangles[..., 2].max()))
        mesh = join([mesh, ivy(site.rng, *plan, high)])
    return site.erect("house", mesh, at, plan, turn)


def _edge(site: Site, kind: str, points: Float64) -> None:
    """A hedge, wall or fence along a (n, 2) line."""
    rng, line = site.rng, site.ground_line(points)
    if kind == "hedge":
        site.items.append(("hedge", hedge(rng, line, *rng.uniform([0.7, 0.5], [2.8, 1.3]))))
    elif kind == "shrubs":
        site.items.append(("shrubs", shrubs(rng, line)))
    elif kind == "wall":
        site.items.append(("wall", garden_wall(rng, line)))
    elif kind == "fence":
        site.items.append(("fence", fence(rng, line)))


def _front_edge(site: Site, front: Frontage, begin: float, end: float) -> None:
    """What bounds the front garden, with a gate or a drive left open."""
    rng = site.rng
    kinds = ["hedge", "shrubs", "wall", "fence", "bushes", "none"]
    lush = np.array([0.4, 0.2, 0.12, 0.12, 0.12, 0.04])
    bare = np.array([0.12, 0.1, 0.34, 0.24, 0.05, 0.15])
    kind = str(rng.choice(kinds, p=site.green * lush + (1 - site.green) * bare))
    border = rng.random() < 0.3 + 0.6 * site.green
    end = min(end, front.street.length - 2.0)
    gate = rng.uniform(begin, max(begin, end))
    opening = rng.uniform(0.6, 2.0)
    stretches = [(begin + 0.2, gate - opening), (gate + opening, end - 0.2)]
    for low, high in stretches:
        if high - low < 1.5 or kind == "none":
            continue
        s = np.linspace(low, high, max(2, int((high - low) / 1.5) + 1))
        points, _ = front.at(s, front.pavement + 0.35)
        if kind == "bushes":
            for point in points[:: int(rng.integers(1, 3))]:
                site.stand("bush", bush(rng), point, float(rng.uniform(0, 6)), 0.8)
        elif site.clear_line(points, 1.0):
            _edge(site, kind, points)
        behind, _ = front.at(s, front.pavement + 1.4)
        if border and site.clear_line(behind, 1.5):
            _edge(site, "shrubs", behind)
    if rng.random() < 0.3:
        by_gate = gate + rng.uniform(-1, 1) * opening
        at, yaw = front.at(by_gate, front.pavement + rng.uniform(0.1, 0.9))
        site.stand("bin", wheelie_bin(site.like("bin")), at, float(yaw + rng.normal(0, 0.5)), 0.6)


def _front_garden(site: Site, lot: Lot) -> None:
    front, setback, middle = lot.front, lot.setback, (lot.begin + lot.end) / 2
    rng = site.rng
    for _ in range(int(rng.integers(0, 3 + round((2 + lot.setback) * 1.6 * site.green)))):
        along = middle + rng.uniform(-0.5, 0.5) * lot.house_width
        at, yaw = front.at(along, front.pavement + rng.uniform(0.9, max(1.0, setback - 0.7)))
        pick = rng.random()
        if pick < 0.5:
            site.stand("bush", bush(rng), at, float(rng.uniform(0, 6)), 1.0)
        elif pick < 0.75:
            site.stand("bush", trimmed_box_bush(site.like("box bush")), at, float(yaw), 0.8)
        else:
            site.stand("tree", town_tree(rng, 3.0, 5.0 + 1.5 * setback), at, float(yaw), 0.8)


def _divider(site: Site, front: Frontage, s: float, depth: float) -> None:
    kinds = ["hedge", "shrubs", "wall", "fence", "none"]
    kind = str(site.rng.choice(kinds, p=[0.25, 0.15, 0.2, 0.25, 0.15]))
    reach = np.linspace(0.6, depth, max(2, int(depth / 1.5)))
    points, _ = front.at(np.full(len(reach), s + 0.1), front.pavement + reach)
    points = site.clear_start(points, 1.0)
    if kind != "none" and len(points) >= 2:
        _edge(site, kind, points)


def _beside(site: Site, lot: Lot) -> None:
    """A drive beside the house: a garage at its end, or just a car."""
    rng, front, gap = site.rng, lot.front, lot.gap
    s = lot.end - gap / 2
    if rng.random() < 0.4:
        built = garage(rng)
        if built.width < gap - 0.3:
            _place(site, front, built, s, front.pavement + lot.setback + rng.uniform(3.0, 8.0))
    at, yaw = front.at(s, front.pavement + 3.0)
    if site.roads.clearance(at) > 3 and site.ground.claim(at, (2.2, 5.2), float(yaw)):
        site.parking.append((*at, float(yaw) + np.pi / 2, 5.0, 0.55))
