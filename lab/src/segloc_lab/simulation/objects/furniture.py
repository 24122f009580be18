"""What stands in rooms and halls, and their walls and ceilings."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from segloc.types import Float64

from .mesh import (
    SOLID,
    Mesh,
    above,
    boxes,
    ellipsoid,
    glass,
    join,
    polar,
    quads,
    scraps,
    tubes,
    xyz,
)

_PIECE_M = 1.0
"""Longest piece of a wall: what stands beside it is kept clear of the corners of its pieces."""

_CONCRETE, _PLASTER, _STEEL = 0.45, 0.65, 0.3


def wall(
    start: ArrayLike,
    end: ArrayLike,
    span: tuple[float, float],
    openings: Sequence[tuple[float, float, float, float]] = (),
    *,
    thick: float = 0.2,
) -> Mesh:
    """A wall between two points of the plan.

    Parameters
    ----------
    start, end : (2,) array
        Its middle line, metres.
    span : (float, float)
        Heights of its foot and its top.
    openings : sequence of (from, to, low, top)
        Metres along the wall, and heights; apart from each other.
    """
    a, b = np.asarray(start, dtype=float), np.asarray(end, dtype=float)
    long, (low, high) = float(np.linalg.norm(b - a)), span
    edges = [0.0, *(s for hole in sorted(openings) for s in hole[:2]), long]
    spans = [(s, t, low, high) for s, t in zip(edges[::2], edges[1::2], strict=True)]
    spans += [(s, t, low, bottom) for s, t, bottom, _ in openings]
    spans += [(s, t, top, high) for s, t, _, top in openings]
    blocks = np.array([
        (x, x + step, bottom, top)
        for s, t, bottom, top in spans
        if t - s > 0.02 and top - bottom > 0.02
        for step in [(t - s) / max(1, round((t - s) / _PIECE_M))]
        for x in np.arange(s, t - step / 2, step)
    ]).reshape(-1, 4)  # fmt: skip
    x0, x1, z0, z1 = blocks.T
    bricks = boxes(xyz((x0 + x1) / 2, 0, (z0 + z1) / 2), xyz(x1 - x0, thick, z1 - z0), _PLASTER)
    return bricks.moved([*a, 0.0], float(np.arctan2(*(b - a)[::-1])))


def panes(start: ArrayLike, end: ArrayLike, span: tuple[float, float]) -> Mesh:
    """Glass between mullions, 1.2 m apart, from one point of the plan to another."""
    a, b = np.asarray(start, dtype=float), np.asarray(end, dtype=float)
    long, (low, high) = float(np.linalg.norm(b - a)), span
    x = np.linspace(0, long, max(2, round(long / 1.2) + 1))
    post = boxes(xyz(x, 0, (low + high) / 2), [0.06, 0.08, high - low], _STEEL)
    rail = boxes([[long / 2, 0, z] for z in (low + 0.03, high - 0.03)], [long, 0.07, 0.06], _STEEL)
    side = np.stack([x[:-1], x[1:], x[1:], x[:-1]], axis=1)
    sheet = glass(quads(xyz(side, 0, [low, low, high, high]), 0.0))
    return join([post, rail, sheet]).moved([*a, 0.0], float(np.arctan2(*(b - a)[::-1])))


def slab(low: ArrayLike, high: ArrayLike, z: float, holes: Float64, reflectance: float) -> Mesh:
    """A level rectangle of the plan at height z, less rectangles (n, 4): x0, y0, x1, y1."""
    (x0, y0), (x1, y1) = np.asarray(low, dtype=float), np.asarray(high, dtype=float)
    xs = np.unique(np.concatenate([[x0, x1], holes[:, 0], holes[:, 2]]))
    ys = np.unique(np.concatenate([[y0, y1], holes[:, 1], holes[:, 3]]))
    left, bottom = np.meshgrid(xs[:-1], ys[:-1])
    right, top = np.meshgrid(xs[1:], ys[1:])
    cells = np.stack([left, bottom, right, top], axis=-1).reshape(-1, 4)
    middle = (cells[:, :2] + cells[:, 2:]) / 2
    open_ = ((middle[:, None] > holes[:, :2]) & (middle[:, None] < holes[:, 2:])).all(axis=2)
    kept = cells[~open_.any(axis=1)]
    return quads(xyz(kept[:, [0, 2, 2, 0]], kept[:, [1, 1, 3, 3]], z), reflectance)


def pillar(shape: str, size: float, high: float) -> Mesh:
    """A "square", "round" or "steel" (H profile) pillar on a plinth, ``size`` metres wide."""
    if shape == "round":
        shaft = tubes([[0, 0, -0.2]], [[0, 0, high]], [size / 2, size / 2], _CONCRETE, sides=14)
    elif shape == "steel":
        web = [[0, 0, high / 2], [0, -size / 2, high / 2], [0, size / 2, high / 2]]
        wide = np.array([[0.03, size, high], [size, 0.03, high], [size, 0.03, high]])
        shaft = boxes(web, wide, _STEEL)
    else:
        shaft = boxes(above(high / 2 - 0.1), [size, size, high + 0.2], _CONCRETE)
    return join([shaft, boxes(above(0.1), [size + 0.16, size + 0.16, 0.24], 0.6)])


def beams(
    first: ArrayLike, last: ArrayLike, along: ArrayLike, pitch: float, size: tuple[float, float]
) -> Mesh:
    """Girders between two points (x, y, z of their tops), again and again, ``pitch`` apart.

    ``along`` is the (3,) way from the first girder to the last; ``size`` is width and depth.
    """
    a, b, way = (np.asarray(v, dtype=float) for v in (first, last, along))
    count = int(np.linalg.norm(way) / pitch + 1e-6)
    shift = np.arange(count + 1)[:, None] * way / np.linalg.norm(way) * pitch
    long = np.abs(b - a)
    wide = np.where(long > 1e-9, long, size[0])
    wide[2] = size[1]
    return boxes((a + b) / 2 + shift - above(size[1] / 2), wide, _STEEL)


def stair_flight(wide: float, run: float, rise: float) -> Mesh:
    """A flight of stairs that climbs ``rise`` over ``run`` along +x, its foot at the origin."""
    steps = 9
    k = np.arange(steps) + 0.5
    tread = xyz(k * run / steps, 0, (k + 0.5) * rise / steps - 0.08)
    parts = [boxes(tread, [run / steps, wide, 0.16], _CONCRETE)]
    for y in (-wide / 2, wide / 2):
        foot = np.array([[0.1, y, 0.1], [run - 0.1, y, rise]])
        parts.append(tubes(foot, foot + above(0.9), [0.02, 0.02], _STEEL, sides=5))
        rail = foot + above(0.9)
        parts.append(tubes(rail[:1], rail[1:], [0.025, 0.025], _STEEL, sides=5))
    return join(parts)


_WOOD, _CARTON, _FOIL = 0.4, 0.45, 0.6


def pallet_load(rng: np.random.Generator) -> Mesh:
    """A pallet of 1.2 x 0.8 m and what is on it: cartons, one crate, sacks, or barrels."""
    slats = boxes([[0, y, 0.12] for y in (-0.34, 0, 0.34)], [1.2, 0.12, 0.05], _WOOD)
    feet = boxes([[x, 0, 0.05] for x in (-0.5, 0, 0.5)], [0.12, 0.8, 0.1], _WOOD)
    high, pick = float(rng.uniform(0.25, 1.2)), rng.random()
    if pick < 0.35:
        goods = boxes(above(0.15 + high / 2), [rng.uniform(0.9, 1.2), 0.78, high], _FOIL)
    elif pick < 0.8:
        goods = _cartons(rng, high)
    else:
        foot = np.array([[x, y, 0.15] for x in (-0.4, 0, 0.4) for y in (-0.2, 0.2)])
        chosen = foot[rng.random(len(foot)) < 0.85]
        goods = tubes(chosen, chosen + above(0.4 + 0.5 * high), [0.18, 0.18], 0.3, sides=8)
    return join([slats, feet, goods])


def _cartons(rng: np.random.Generator, high: float) -> Mesh:
    """Layers of cartons, the top one not full, none quite in line."""
    nx, ny = (int(k) for k in rng.integers([2, 1], [4, 3]))
    layers = max(1, round(high / rng.uniform(0.22, 0.45)))
    size = np.array([1.16 / nx, 0.76 / ny, high / layers])
    steps = np.stack(np.meshgrid(*(np.arange(k) for k in (nx, ny, layers)), indexing="ij"), -1)
    grid = steps.reshape(-1, 3).astype(float)
    grid = grid[(grid[:, 2] < layers - 1) | (rng.random(len(grid)) < 0.7)]
    center = (grid + 0.5) * size - [0.58, 0.38, -0.15]
    center[:, :2] += rng.normal(0, 0.012, (len(center), 2))
    return boxes(center, size * [0.97, 0.97, 1.0], _CARTON)


def rack(bays: int, bay_m: float, levels: Float64, depth_m: float) -> Mesh:
    """Pallet racking along +x from the origin, its middle at y = 0.

    Parameters
    ----------
    bay_m : float
        Length of each bay, metres.
    levels : (n,) float64
        Heights of the beams, metres.
    """
    x = bay_m * np.arange(bays + 1)
    top = float(levels[-1]) + 1.1
    post = np.array([[a, s * depth_m / 2, top / 2 - 0.1] for a in x for s in (-1, 1)])
    parts = [boxes(post, [0.1, 0.09, top + 0.2], _STEEL)]
    beam = [[bays * bay_m / 2, s * depth_m / 2, z] for z in levels for s in (-1, 1)]
    parts.append(boxes(beam, [bays * bay_m, 0.05, 0.13], _STEEL))
    slat = [[a + k * bay_m, 0, z] for z in levels for k in (0.25, 0.5, 0.75) for a in x[:-1]]
    parts.append(boxes(slat, [0.1, depth_m, 0.05], _STEEL))
    z = np.arange(0.2, top - 0.6, 1.2)
    low = np.array([[a, -depth_m / 2, k] for a in x for k in z])
    parts.append(tubes(low, low + [0, depth_m, 0.6], [0.02, 0.02], _STEEL, sides=4))
    return join(parts)


def dock_door(rng: np.random.Generator, wide: float, high: float) -> Mesh:
    """A sectional door in the plane y = 0, seen from -y, with rubber buffers and a leveller."""
    each = high / max(1, round(high / 0.5))
    raised = float(rng.choice([0.0, 0.0, 0.0, 0.4]))
    z = np.arange(each / 2, high, each)
    z = z[z > raised * high]
    leaf = boxes(xyz(0, 0.02 * (-1.0) ** np.arange(len(z)), z), [wide, 0.05, each], 0.6)
    side = wide / 2 * np.array([-1, 1])
    jambs = boxes(xyz(side + [-0.1, 0.1], -0.08, high / 2), [0.16, 0.2, high], _STEEL)
    drum = boxes([0, -0.2, high + 0.15], [wide + 0.3, 0.4, 0.35], _STEEL)
    stops = xyz(side + [-0.45, 0.45], -0.35, 0.45)
    posts = tubes(stops - above(0.6), stops + above(0.6), 0.09, 0.6)
    return join([leaf, jambs, drum, posts])


def fork_lift(rng: np.random.Generator) -> Mesh:
    """A counterbalanced fork lift truck towards +x, its mast up or down, maybe with a load."""
    up = float(rng.uniform(0.05, 1.8)) if rng.random() < 0.4 else 0.1
    body = boxes([[-0.55, 0, 0.65], [-1.05, 0, 0.75]], [[1.3, 1.1, 0.8], [0.5, 1.1, 1.0]], 0.5)
    foot = np.array([[x, y, 1.0] for x in (-1.1, 0.0) for y in (-0.5, 0.5)])
    cab = [tubes(foot, foot + above(1.1), [0.04, 0.04], _STEEL, sides=5)]
    cab.append(boxes([-0.55, 0, 2.12], [1.2, 1.1, 0.06], _STEEL))
    mast = boxes([[0.25, y, 1.1 + up / 2] for y in (-0.35, 0.35)], [0.12, 0.1, 2.2 + up], _STEEL)
    forks = boxes([[0.85, y, up] for y in (-0.25, 0.25)], [1.1, 0.12, 0.06], _STEEL)
    wheels = np.array([[x, y, 0.3] for x in (-1.0, 0.1) for y in (-0.52, 0.52)])
    tyres = tubes(wheels - [0, 0.1, 0], wheels + [0, 0.1, 0], 0.3, 0.1)
    parts = [body, *cab, mast, forks, tyres]
    if rng.random() < 0.4:
        parts.append(pallet_load(rng).moved([0.95, 0, up], np.pi / 2))
    return join(parts)


def cage(rng: np.random.Generator) -> Mesh:
    """One to five roll cages side by side along y, some with parcels; most rays pass."""
    parts = []
    for k in range(int(rng.integers(1, 6))):
        corner = np.array([[x, y, 0.1] for x in (-0.4, 0.4) for y in (-0.33, 0.33)])
        bars = [tubes(corner, corner + above(1.6), [0.02, 0.02], _STEEL, sides=4)]
        wire = np.array([[x, y, 0.2] for x in np.linspace(-0.35, 0.35, 6) for y in (-0.33, 0.33)])
        bars.append(tubes(wire, wire + above(1.45), [0.006, 0.006], _STEEL, sides=3))
        bars.append(boxes([0, 0, 0.2], [0.8, 0.66, 0.03], _STEEL))
        full = float(rng.uniform(0.0, 1.3))
        if full > 0.3:
            bars.append(boxes([0, 0, 0.22 + full / 2], [0.7, 0.58, full], _CARTON))
        parts.append(join(bars).moved([rng.normal(0, 0.05), 0.75 * k, 0], rng.normal(0, 0.06)))
    return join(parts)


def conveyor(rng: np.random.Generator, long: float) -> Mesh:
    """A belt on legs along x, parcels on it."""
    high = float(rng.uniform(0.7, 1.1))
    bed = boxes([[0, 0, high], [0, -0.4, high + 0.08], [0, 0.4, high + 0.08]],
                [[long, 0.7, 0.1], [long, 0.06, 0.2], [long, 0.06, 0.2]], _STEEL)  # fmt: skip
    legs = [[x, y, high / 2] for x in np.arange(-long / 2, long / 2, 2.0) for y in (-0.35, 0.35)]
    count = int(long / 3)
    size = rng.uniform([0.2, 0.2, 0.1], [0.6, 0.5, 0.5], (count, 3))
    x, y = rng.uniform(-long / 2, long / 2, count), rng.normal(0, 0.08, count)
    parcels = boxes(xyz(x, y, high + 0.05 + size[:, 2] / 2), size, _CARTON)
    return join([bed, boxes(legs, [0.06, 0.06, high], _STEEL), parcels])


def machine(rng: np.random.Generator) -> Mesh:
    """A press, a packing machine or a tank: blocks on blocks, a pipe or a chimney."""
    size = rng.uniform([1.2, 1.0, 1.0], [4.0, 2.4, 2.2])
    parts = [boxes(above(size[2] / 2), size, 0.5)]
    for _ in range(int(rng.integers(1, 4))):
        small = size * rng.uniform(0.25, 0.7, 3)
        at = rng.uniform(-0.3, 0.3, 2) * size[:2]
        parts.append(boxes([*at, size[2] + small[2] / 2], small, float(rng.uniform(0.2, 0.6))))
    side = rng.uniform([0.4, 0.3, 0.9], [0.8, 0.6, 1.5])
    parts.append(boxes([0, size[1] / 2 + side[1] / 2, side[2] / 2], side, 0.4))
    foot = np.array([*rng.uniform(-0.4, 0.4, 2) * size[:2], size[2]])
    parts.append(tubes(foot[None], foot[None] + above(rng.uniform(0.5, 2.0)), [0.15, 0.12], _STEEL))
    return join(parts)


_VENEER, _PLASTIC, _LEAF = 0.45, 0.35, 0.5


def desk(rng: np.random.Generator) -> Mesh:
    """A desk along y with what stands on it; one sits at its -x side."""
    wide, deep, high = rng.uniform([1.2, 0.7, 0.7], [1.9, 0.9, 0.78])
    parts = [boxes(above(high), [deep, wide, 0.04], _VENEER)]
    foot = [[s * 0.4 * deep, t * 0.45 * wide, high / 2] for s in (-1, 1) for t in (-1, 1)]
    parts.append(boxes(foot, [0.06, 0.06, high], _STEEL))
    if rng.random() < 0.6:
        parts.append(boxes([0, 0.3 * wide, high / 2 - 0.05], [0.6, 0.4, high - 0.12], _VENEER))
    for y in rng.uniform(-0.3, 0.3, int(rng.integers(0, 3))) * wide:
        parts.append(boxes([0.15, y, high + 0.3], [0.05, rng.uniform(0.45, 0.7), 0.36], 0.2))
    if rng.random() < 0.5:
        parts.append(boxes([0.45 * deep, 0, high + 0.2], [0.03, wide, 0.45], 0.5))
    return join(parts)


def chair(rng: np.random.Generator) -> Mesh:
    """A swivel chair or one with four legs, facing +x."""
    seat = float(rng.uniform(0.42, 0.52))
    size = [[0.46, 0.46, 0.07], [0.06, 0.42, 0.5]]
    parts = [boxes([[0, 0, seat], [-0.22, 0, seat + 0.35]], size, _PLASTIC)]
    if rng.random() < 0.6:
        tip = polar(0.3, np.arange(5) * 2 * np.pi / 5) + above(0.06)
        parts.append(tubes(above(0.12), tip, [0.03, 0.02], _STEEL, sides=4))
        parts.append(tubes([above(0.1)], [above(seat)], [0.03, 0.03], _STEEL, sides=6))
    else:
        foot = np.array([[x, y, 0.0] for x in (-0.2, 0.2) for y in (-0.2, 0.2)])
        parts.append(tubes(foot, foot + above(seat), [0.015, 0.015], _STEEL, sides=4))
    return join(parts)


def cupboard(rng: np.random.Generator) -> Mesh:
    """A cupboard or a row of lockers against a wall at its -x side."""
    deep, wide = rng.uniform([0.35, 0.8], [0.6, 2.4])
    high = float(rng.choice([0.75, 1.2, 1.6, 2.0])) + float(rng.uniform(-0.05, 0.05))
    parts = [boxes([0, 0, high / 2], [deep, wide, high], 0.5)]
    gaps = np.arange(-wide / 2, wide / 2, rng.uniform(0.3, 0.5))
    parts.append(boxes([[deep / 2, y, high / 2] for y in gaps], [0.02, 0.02, high], 0.4))
    if rng.random() < 0.4:
        size = rng.uniform([0.2, 0.2, 0.1], [0.3, 0.5, 0.4])
        parts.append(boxes([0, rng.uniform(-0.3, 0.3) * wide, high + size[2] / 2], size, 0.4))
    return join(parts)


def lockers(rng: np.random.Generator) -> Mesh:
    """Flat lockers or a cabinet against a corridor's wall at their -x side."""
    deep, wide, high = rng.uniform([0.2, 0.6, 1.0], [0.4, 1.6, 2.0])
    gaps = np.arange(-wide / 2, wide / 2, 0.3)
    doors = boxes([[deep - 0.2, y, high / 2] for y in gaps], [0.02, 0.02, high], 0.4)
    return join([boxes([deep / 2 - 0.2, 0, high / 2], [deep, wide, high], 0.45), doors])


def shelf(rng: np.random.Generator) -> Mesh:
    """An open shelf with binders against a wall at its -x side."""
    wide, high, deep = rng.uniform([0.8, 1.2, 0.28], [1.8, 2.1, 0.42])
    levels = np.linspace(0.08, high, int(high / 0.36))
    boards = boxes([[0, 0, z] for z in levels], [deep, wide, 0.025], _VENEER)
    ends = boxes([[0, s * wide / 2, high / 2] for s in (-1, 1)], [deep, 0.025, high], _VENEER)
    back = boxes([-deep / 2, 0, high / 2], [0.01, wide, high], _VENEER)
    rows = []
    for z in levels[:-1]:
        full = float(rng.uniform(0.0, 0.95)) * wide
        size = [0.7 * deep, full, rng.uniform(0.2, 0.3)]
        if full > 0.1:
            at = [0, (full - wide) / 2, z + size[2] / 2]
            rows.append(boxes(at, size, float(rng.uniform(0.2, 0.7))))
    return join([boards, ends, back, *rows])


def table(rng: np.random.Generator) -> Mesh:
    """A table to meet at, oblong or round."""
    high = float(rng.uniform(0.7, 0.76))
    if rng.random() < 0.35:
        radius = float(rng.uniform(0.45, 0.75))
        top = tubes([above(high - 0.04)], [above(high)], [radius, radius], _VENEER, sides=16)
        return join([top, tubes([[0, 0, 0]], [above(high)], [0.2, 0.05], _STEEL)])
    wide, deep = rng.uniform([1.4, 0.8], [3.2, 1.3])
    foot = [[s * 0.4 * deep, t * 0.42 * wide, high / 2] for s in (-1, 1) for t in (-1, 1)]
    top = boxes(above(high), [deep, wide, 0.04], _VENEER)
    return join([top, boxes(foot, [0.07, 0.07, high], _STEEL)])


def sofa(rng: np.random.Generator) -> Mesh:
    """A sofa or an armchair, its back at -x."""
    wide, deep = rng.uniform([0.8, 0.75], [2.2, 0.95])
    back = boxes([-0.4 * deep, 0, 0.45], [0.2 * deep, wide, 0.75], _PLASTIC)
    arms = boxes([[0, s * wide / 2, 0.3] for s in (-1, 1)], [deep, 0.16, 0.55], _PLASTIC)
    return join([boxes([0, 0, 0.25], [deep, wide, 0.35], _PLASTIC), back, arms])


def pot_plant(rng: np.random.Generator) -> Mesh:
    """A plant in a pot, up to man's height; it keeps its leaves."""
    tall, wide = rng.uniform([0.7, 0.15], [1.8, 0.4])
    pot = tubes([[0, 0, 0]], [above(0.35)], [0.15, 0.2], 0.4)
    stem = tubes([above(0.3)], [above(0.9 * tall)], [0.02, 0.01], _VENEER, sides=5)
    at = rng.normal(0, 1, (int(120 * tall), 3)) * [wide, wide, 0.25 * tall] + above(0.75 * tall)
    return join([pot, stem, scraps(rng, at, 0.06, _LEAF, SOLID)])


def printer(rng: np.random.Generator) -> Mesh:
    """A copier, a vending machine or a water cooler against a wall at its -x side."""
    pick = rng.random()
    if pick < 0.5:
        size = rng.uniform([0.55, 0.55, 0.9], [0.7, 0.8, 1.15])
        tray = boxes([0, size[1] / 2 + 0.12, 0.75], [0.4, 0.24, 0.05], _PLASTIC)
        return join([boxes(above(size[2] / 2), size, _PLASTIC), tray])
    if pick < 0.75:
        return boxes(above(0.92), [0.8, rng.uniform(0.7, 1.1), 1.84], 0.4)
    bottle = ellipsoid(above(1.2), [0.14, 0.14, 0.22], 0.3)
    return join([boxes(above(0.5), [0.32, 0.32, 1.0], 0.6), bottle])


def trolley(rng: np.random.Generator) -> Mesh:
    """A trolley with shelves, a cart of a cleaner, or boxes on a board."""
    wide, high = rng.uniform([0.45, 0.8], [0.7, 1.2])
    foot = np.array([[x, y, 0.08] for x in (-0.4, 0.4) for y in (-wide / 2, wide / 2)])
    posts = tubes(foot, foot + above(high), [0.015, 0.015], _STEEL, sides=4)
    boards = boxes([[0, 0, z] for z in (0.15, high / 2, high)], [0.8, wide, 0.03], 0.4)
    size = rng.uniform([0.2, 0.2, 0.15], [0.7, wide - 0.1, 0.4])
    return join([posts, boards, boxes(above(high + size[2] / 2), size, 0.4)])


def door_leaf(rng: np.random.Generator) -> Mesh:
    """A leaf along +x from its hinge at the origin, shut, ajar or open to the left."""
    turn = 0.0 if rng.random() < 0.45 else float(rng.uniform(0.1, 1.9))
    leaf = boxes([0.44, 0, 1.02], [0.86, 0.045, 2.02], 0.55)
    handle = boxes([[0.8, s * 0.06, 1.05] for s in (-1, 1)], [0.12, 0.03, 0.03], _STEEL)
    return join([leaf, handle]).moved([0, 0, 0], turn)


def wall_things(rng: np.random.Generator) -> Mesh:
    """What hangs on a wall at its -x side: an extinguisher, a board, a radiator, a cabinet."""
    pick = rng.random()
    if pick < 0.3:
        return tubes([[0.08, 0, 0.75]], [[0.08, 0, 1.3]], [0.08, 0.07], 0.3, sides=10)
    if pick < 0.55:
        return boxes([0.02, 0, 1.5], [0.03, rng.uniform(0.6, 2.0), rng.uniform(0.6, 1.1)], 0.7)
    if pick < 0.8:
        wide = float(rng.uniform(0.6, 1.6))
        y = np.arange(-wide / 2, wide / 2, 0.07)
        fins = boxes(xyz(0.06, y, 0.45), [0.1, 0.03, 0.6], 0.6)
        return join([fins, boxes([0.06, 0, 0.74], [0.1, wide, 0.03], 0.6)])
    return boxes([0.12, 0, rng.uniform(1.0, 1.5)], [0.22, rng.uniform(0.4, 0.8), 0.8], 0.5)
