"""What halls hold: racks with goods, dock doors, fork lifts, cages, conveyors."""

from __future__ import annotations

import numpy as np

from segloc.types import Float64

from .mesh import Mesh, above, boxes, join, tubes

_STEEL, _WOOD, _CARTON, _FOIL = 0.3, 0.4, 0.45, 0.6


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
    bays : int
    bay_m : float
        Length of each bay, metres.
    levels : (n,) float64
        Heights of the beams, metres.
    depth_m : float
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
    leaf = boxes(
        np.column_stack([0 * z, 0.02 * (-1.0) ** np.arange(len(z)), z]), [wide, 0.05, each], 0.6
    )
    jambs = boxes(
        [[s * (wide / 2 + 0.1), -0.08, high / 2] for s in (-1, 1)], [0.16, 0.2, high], _STEEL
    )
    drum = boxes([0, -0.2, high + 0.15], [wide + 0.3, 0.4, 0.35], _STEEL)
    stops = [[s * (wide / 2 + 0.45), -0.35, 0.45] for s in (-1, 1)]
    posts = tubes(np.array(stops) - above(0.6), np.array(stops) + above(0.6), [0.09, 0.09], 0.6)
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
    wheels = [[x, y, 0.3] for x in (-1.0, 0.1) for y in (-0.52, 0.52)]
    tyres = tubes(np.array(wheels) - [0, 0.1, 0], np.array(wheels) + [0, 0.1, 0], [0.3, 0.3], 0.1)
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
    at = np.column_stack([rng.uniform(-long / 2, long / 2, count), rng.normal(0, 0.08, count)])
    parcels = boxes(np.column_stack([at, high + 0.05 + size[:, 2] / 2]), size, _CARTON)
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
