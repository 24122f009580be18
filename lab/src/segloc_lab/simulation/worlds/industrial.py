"""An industrial estate or training ground: plant, halls, containers, open yards."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from typing import TypeAlias

import numpy as np

from segloc.types import Float64

from ..objects import fixtures, works
from ..objects.buildings import Building, shed
from ..objects.mesh import Mesh, above, boxes, join, quads, tubes
from ..objects.vegetation import bush, shrubs
from ..objects.vehicles import vehicle
from .layout import Frontage, Site, check_world, lay_kerb, paved_site, town_tree
from .roads import street_network
from .world import World, remember

_MARGIN, _BLOCK = 34.0, 62.0

Maker: TypeAlias = Callable[[np.random.Generator], Mesh]

STRUCTURES: tuple[tuple[str, Callable[[np.random.Generator], Building], float], ...] = (
    ("hall", works.hall, 0.2),
    ("training house", works.training_house, 0.2),
    ("tank", works.upright_tank, 0.14),
    ("vessel", works.lying_tank, 0.12),
    ("silo", works.silos, 0.08),
    ("pipe rack", works.pipe_rack, 0.12),
    ("stair tower", works.stair_tower, 0.09),
    ("gantry", works.gantry, 0.05),
)
"""Kind, maker and share of what is put up along roads and within blocks."""

CLUTTER: tuple[tuple[str, Maker, float, float], ...] = (
    ("pallets", works.pallets, 0.2, 1.5),
    ("drums", works.drums, 0.17, 2.2),
    ("barrier", works.barriers, 0.15, 6.0),
    ("rubble", works.rubble, 0.13, 6.0),
    ("container", fixtures.skip_container, 0.1, 3.4),
    ("cabinet", fixtures.cabinet, 0.07, 1.4),
    ("traffic sign", fixtures.traffic_sign, 0.06, 0.5),
    ("name sign", fixtures.name_sign, 0.05, 2.0),
    ("bush", bush, 0.07, 1.6),
)
"""Kind, maker, share and size in metres of what lies about on yards."""


@remember
def industrial(seed: int, *, size_m: float = 330.0) -> World:
    """An industrial estate of about ``size_m`` metres square; a function of its seed alone."""
    check_world(seed, size_m, 130.0, 2000.0)
    rng = np.random.default_rng([seed, 15_485_863])
    roads = street_network(rng, size_m, margin_m=_MARGIN, block_m=_BLOCK, half_width=(3.6, 5.6))
    paved = float(rng.uniform(4.0, 14.0))
    site = paved_site(rng, roads, size_m, slope=0.015, paved_m=paved)
    fronts = [
        Frontage(street, side, float(rng.uniform(1.0, 4.0)), "plant")
        for street in roads.streets
        for side in (1, -1)
    ]
    shares = rng.dirichlet(12 * np.array([share for _, _, share in STRUCTURES]))
    for front in fronts:
        if rng.random() < 0.7:
            lay_kerb(site, front)
        _roadside(site, front)
        _build_along(site, front, shares)
    _fill_blocks(site, size_m, shares)
    for front in fronts:
        _fence_along(site, front)
        _parking(site, front)
    _scatter(site, size_m)
    return site.world("industrial", seed)


def _roadside(site: Site, front: Frontage) -> None:
    """Lamps or masts, drains, people on foot."""
    rng, length = site.rng, front.street.length
    masts = rng.random() < 0.4
    for s in np.arange(rng.uniform(6, 25), length - 6, rng.uniform(26, 45)):
        at, yaw = front.at(s, rng.uniform(0.4, 0.9))
        make, kind = (works.light_mast, "mast") if masts else (fixtures.lamp, "lamp")
        site.stand(kind, make(rng), at, float(yaw) - np.pi / 2, 0.7)
    for s in np.arange(rng.uniform(3, 12), length - 3, rng.uniform(9, 22)):
        at, yaw = front.at(s, -0.3)
        site.items.append(("drain", _drain(site, at, float(yaw))))
    walkers = rng.uniform(3, max(4.0, length - 3), int(length / 9))
    site.people.extend(front.at(walkers, rng.uniform(0.4, 4.0, len(walkers)))[0])


def _drain(site: Site, at: Float64, yaw: float) -> Mesh:
    """A grating that stands a little proud of the road."""
    bars = np.linspace(-0.25, 0.25, 6)[:, None] * [1, 0, 0] + [0, 0, 0.02]
    grate = join([boxes(bars, [0.04, 0.4, 0.06], 0.2), boxes([0, 0, 0], [0.6, 0.5, 0.04], 0.1)])
    return grate.moved([*at, float(site.terrain.height(*at))], yaw)


def _draw(rng: np.random.Generator, shares: Float64) -> tuple[str, Building]:
    kind, make, _ = STRUCTURES[int(rng.choice(len(STRUCTURES), p=shares))]
    return kind, make(rng)


def _build_along(site: Site, front: Frontage, shares: Float64) -> None:
    """Structures and rows of containers side by side along a road."""
    rng, s = site.rng, float(site.rng.uniform(4, 12))
    while s < front.street.length - 8:
        if rng.random() < 0.28:
            s += _container_row(site, front, s)
            continue
        kind, built = _draw(rng, shares)
        beyond = front.pavement + float(rng.uniform(0.5, 9.0))
        at, yaw = front.at(s + built.width / 2, beyond + built.depth / 2)
        turn = float(yaw + rng.normal(0, 0.03))
        placed = site.erect(kind, built.mesh, at, (built.width, built.depth), turn)
        s += built.width + rng.uniform(1.5, 9.0) if placed else rng.uniform(4.0, 8.0)


def _container_row(site: Site, front: Frontage, s: float) -> float:
    """One to five containers, end on or side on; returns how much of the road they take."""
    rng = site.rng
    count = int(rng.integers(1, 6))
    across = rng.random() < 0.5
    step = 2.44 + rng.uniform(0.1, 2.0) if across else 6.06 + rng.uniform(0.2, 3.0)
    beyond = front.pavement + rng.uniform(0.8, 6.0) + (6.1 if across else 1.3)
    for k in range(count):
        at, yaw = front.at(s + step * (k + 0.5), beyond + rng.normal(0, 0.25))
        turn = float(yaw + rng.normal(0, 0.03) + (np.pi / 2 if across else 0.0))
        _container(site, at, turn)
    return count * step + float(rng.uniform(0.5, 6.0))


def _container(site: Site, at: Float64, yaw: float) -> bool:
    mesh = works.container_stack(site.rng)
    low, high = mesh.triangles.min(axis=(0, 1)), mesh.triangles.max(axis=(0, 1))
    reach = 2 * float(max(abs(low[0]), high[0]))
    return site.erect("shipping container", mesh, at, (reach, 2.6), yaw, clearance=0.8)


def _fill_blocks(site: Site, size_m: float, shares: Float64) -> None:
    """Structures and containers away from the roads."""
    rng = site.rng
    for at in rng.uniform(6, size_m - 6, (int(size_m**2 / 260), 2)):
        if site.roads.clearance(at) < 6:
            continue
        yaw = float(rng.choice([0.0, np.pi / 2]) + rng.normal(0, 0.08))
        if rng.random() < 0.35:
            _container(site, at, yaw)
            continue
        kind, built = _draw(rng, shares)
        site.erect(kind, built.mesh, at, (built.width, built.depth), yaw, margin=2.0)


def _fence_along(site: Site, front: Frontage) -> None:
    """A mesh fence or shrubs on part of a frontage."""
    rng, length = site.rng, front.street.length
    if rng.random() < 0.45:
        return
    begin = rng.uniform(3, 0.6 * length)
    s = np.arange(begin, min(length - 3, begin + rng.uniform(10, 50)), 2.5)
    points, _ = front.at(s, front.pavement + rng.uniform(0.2, 0.5))
    points = site.clear_start(points, 0.6)
    if len(points) < 3:
        return
    line = site.ground_line(points)
    if rng.random() < 0.75:
        site.items.append(("mesh fence", mesh_fence(rng, line)))
    else:
        site.items.append(("shrubs", shrubs(rng, line)))


def mesh_fence(rng: np.random.Generator, line: Float64) -> Mesh:
    """Posts and rails with wire mesh, over a (n, 3) ground line; most rays pass."""
    high = float(rng.uniform(1.7, 2.6))
    parts = [tubes(line - above(0.2), line + above(high), [0.04, 0.04], 0.3, sides=6)]
    rail = line + above(high - 0.03)
    parts.append(tubes(rail[:-1], rail[1:], [0.025, 0.025], 0.3, sides=4))
    if rng.random() < 0.4:
        parts.append(tubes(line + above(high), line + [0.25, 0, high + 0.35], [0.03, 0.03], 0.3))
    pitch, wire = rng.uniform([0.07, 0.014], [0.13, 0.022])
    for a, b in pairwise(line):
        way, up = b - a, above(high - 0.08)
        count = int(np.linalg.norm(way) / pitch)
        foot = a + above(0.05) + (np.arange(count)[:, None] + rng.random((count, 1))) / count * way
        wide = way / np.linalg.norm(way) * wire
        strip = np.stack([foot, foot + wide, foot + wide + up, foot + up], axis=1)
        parts.append(quads(strip, 0.35))
    return join(parts)


def _parking(site: Site, front: Frontage) -> None:
    """Lorries and cars by the road and on aprons beside it."""
    rng, length = site.rng, front.street.length
    for s in np.arange(10.0, length - 10.0, rng.uniform(8.0, 22.0)):
        large = rng.random() < 0.5
        size = (10.8, 2.7) if large else (5.4, 2.1)
        beside = rng.random() < 0.7
        at, yaw = front.at(s, rng.uniform(2.0, 9.0) if beside else (0.1 if large else -0.6))
        turn = float(yaw) + (np.pi / 2 if beside and rng.random() < 0.4 else 0.0)
        if not site.ground.free(at, size, turn):
            continue
        if beside and (site.roads.clearance(at) < 0.5 * max(size) * abs(np.sin(turn - yaw)) + 1.3):
            continue
        site.ground.claim(at, size, turn)
        site.parking.append((*at, turn, size[0] - 0.4, float(rng.uniform(0.4, 0.8))))


def _scatter(site: Site, size_m: float) -> None:
    """Pallets, drums, heaps, wrecks, sheds and rows of trees where there is room."""
    rng = site.rng
    shares = rng.dirichlet(15 * np.array([share for _, _, share, _ in CLUTTER]))
    for at in rng.uniform(4, size_m - 4, (int(size_m**2 / 60), 2)):
        clear, yaw = float(site.roads.clearance(at)), float(rng.uniform(0, 2 * np.pi))
        if clear < 0.8:
            continue
        pick = rng.random()
        if pick < 0.6:
            kind, make, _, size = CLUTTER[int(rng.choice(len(CLUTTER), p=shares))]
            site.stand(kind, make(rng), at, yaw, size)
        elif pick < 0.7 and clear > 1.5:
            _container(site, at, yaw)
        elif pick < 0.78:
            wreck, plan = vehicle(rng, 6.2)
            site.erect("wreck", wreck, at, plan, yaw, clearance=0.5)
        elif pick < 0.82:
            small = shed(rng)
            site.erect("shed", small.mesh, at, (small.width, small.depth), yaw, margin=0.3)
        elif clear > 8 or pick > 0.95:
            site.stand("tree", town_tree(rng, 3.0, 14.0), at, yaw, 1.2)
