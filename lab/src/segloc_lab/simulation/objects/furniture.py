"""What offices hold: desks, chairs, cupboards, shelves, doors, and what hangs on walls."""

from __future__ import annotations

import numpy as np

from .mesh import Mesh, above, boxes, ellipsoid, join, scraps, tubes

_STEEL, _WOOD, _PLASTIC, _LEAF = 0.3, 0.45, 0.35, 0.5
_SOLID = 0


def desk(rng: np.random.Generator) -> Mesh:
    """A desk along y with what stands on it; one sits at its -x side."""
    wide, deep, high = rng.uniform([1.2, 0.7, 0.7], [1.9, 0.9, 0.78])
    parts = [boxes(above(high), [deep, wide, 0.04], _WOOD)]
    foot = [
        [x, y, high / 2] for x in (-0.4 * deep, 0.4 * deep) for y in (-0.45 * wide, 0.45 * wide)
    ]
    parts.append(boxes(foot, [0.06, 0.06, high], _STEEL))
    if rng.random() < 0.6:
        parts.append(boxes([0, 0.3 * wide, high / 2 - 0.05], [0.6, 0.4, high - 0.12], _WOOD))
    for y in rng.uniform(-0.3, 0.3, int(rng.integers(0, 3))) * wide:
        parts.append(boxes([0.15, y, high + 0.3], [0.05, rng.uniform(0.45, 0.7), 0.36], 0.2))
    if rng.random() < 0.5:
        parts.append(boxes([0.45 * deep, 0, high + 0.2], [0.03, wide, 0.45], 0.5))
    return join(parts)


def chair(rng: np.random.Generator) -> Mesh:
    """A swivel chair or one with four legs, facing +x."""
    seat = float(rng.uniform(0.42, 0.52))
    parts = [
        boxes(
            [[0, 0, seat], [-0.22, 0, seat + 0.35]],
            [[0.46, 0.46, 0.07], [0.06, 0.42, 0.5]],
            _PLASTIC,
        )
    ]
    if rng.random() < 0.6:
        angle = np.arange(5) * 2 * np.pi / 5
        tip = 0.3 * np.column_stack([np.cos(angle), np.sin(angle), 0 * angle]) + above(0.06)
        parts.append(tubes(np.tile(above(0.12), (5, 1)), tip, [0.03, 0.02], _STEEL, sides=4))
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
    boards = boxes([[0, 0, z] for z in levels], [deep, wide, 0.025], _WOOD)
    ends = boxes([[0, s * wide / 2, high / 2] for s in (-1, 1)], [deep, 0.025, high], _WOOD)
    back = boxes([-deep / 2, 0, high / 2], [0.01, wide, high], _WOOD)
    rows = []
    for z in levels[:-1]:
        full = float(rng.uniform(0.0, 0.95)) * wide
        size = [0.7 * deep, full, rng.uniform(0.2, 0.3)]
        if full > 0.1:
            rows.append(
                boxes([0, (full - wide) / 2, z + size[2] / 2], size, float(rng.uniform(0.2, 0.7)))
            )
    return join([boards, ends, back, *rows])


def table(rng: np.random.Generator) -> Mesh:
    """A table to meet at, oblong or round."""
    high = float(rng.uniform(0.7, 0.76))
    if rng.random() < 0.35:
        radius = float(rng.uniform(0.45, 0.75))
        top = tubes([above(high - 0.04)], [above(high)], [radius, radius], _WOOD, sides=16)
        return join([top, tubes([[0, 0, 0]], [above(high)], [0.2, 0.05], _STEEL)])
    wide, deep = rng.uniform([1.4, 0.8], [3.2, 1.3])
    foot = [
        [x, y, high / 2] for x in (-0.4 * deep, 0.4 * deep) for y in (-0.42 * wide, 0.42 * wide)
    ]
    return join(
        [boxes(above(high), [deep, wide, 0.04], _WOOD), boxes(foot, [0.07, 0.07, high], _STEEL)]
    )


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
    stem = tubes([above(0.3)], [above(0.9 * tall)], [0.02, 0.01], _WOOD, sides=5)
    at = rng.normal(0, 1, (int(120 * tall), 3)) * [wide, wide, 0.25 * tall] + above(0.75 * tall)
    return join([pot, stem, scraps(rng, at, 0.06, _LEAF, _SOLID)])


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
        fins = boxes(
            [[0.06, y, 0.45] for y in np.arange(-wide / 2, wide / 2, 0.07)], [0.1, 0.03, 0.6], 0.6
        )
        return join([fins, boxes([0.06, 0, 0.74], [0.1, wide, 0.03], 0.6)])
    return boxes([0.12, 0, rng.uniform(1.0, 1.5)], [0.22, rng.uniform(0.4, 0.8), 0.8], 0.5)
