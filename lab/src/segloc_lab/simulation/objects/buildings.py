"""Buildings: blocks with four facades, wings, roofs with chimneys and dormers, garages, sheds."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .facades import FacadeStyle, facade
from .mesh import Mesh, boxes, join, quads, triangles

_TILE, _FLAT = 0.35, 0.25


@dataclass(frozen=True)
class Building:
    """A building with its front (towards -y) at y = -depth / 2, centred on the origin."""

    mesh: Mesh
    width: float
    depth: float


def house(
    rng: np.random.Generator, width: float, depth: float, *, floors: int, flats: bool = False
) -> Building:
    """A house of the given plan; everything else is drawn."""
    style = FacadeStyle.draw(rng, flats=flats)
    parts = [_block(rng, style, width, depth, floors, flat=flats and rng.random() < 0.7)]
    if not flats and width > 9 and rng.random() < 0.4:
        wing_width = rng.uniform(0.35, 0.5) * width
        wing_depth = rng.uniform(2.0, 4.0)
        side = rng.choice([-1, 1])
        wing = _block(
            rng, style, wing_width, wing_depth, max(1, floors - int(rng.integers(2))), flat=False
        )
        at = [side * (width - wing_width) / 2, -(depth + wing_depth) / 2 + 0.05, 0.0]
        # The wing reaches forward; the whole moves back so that the front stays where it was.
        parts = [part.moved([0, wing_depth / 2, 0]) for part in [*parts, wing.moved(at)]]
        depth += wing_depth
    return Building(join(parts), width, depth)


def _block(
    rng: np.random.Generator,
    style: FacadeStyle,
    width: float,
    depth: float,
    floors: int,
    *,
    flat: bool,
) -> Mesh:
    w, d = width / 2, depth / 2
    sides = [
        ((-w, -d), width, 0.0),
        ((w, -d), depth, 0.5),
        ((w, d), width, 1.0),
        ((-w, d), depth, 1.5),
    ]
    parts = [
        facade(rng, style, length, floors, front=k == 0).moved([*corner, 0], turn * np.pi)
        for k, (corner, length, turn) in enumerate(sides)
    ]
    eaves = style.base + floors * style.floor_height
    kind = (
        "flat" if flat else str(rng.choice(["gable", "gable across", "hip"], p=[0.45, 0.25, 0.3]))
    )
    parts.append(_roof(rng, kind, width, depth, eaves, style.reflectance))
    cross = rng.uniform(-0.2, 0.2, 2) * [width, depth]
    rooms = [[cross[0], 0, eaves / 2], [0, cross[1], eaves / 2]]
    walls = [[0.12, depth - 0.8, eaves], [width - 0.8, 0.12, eaves]]
    parts.append(boxes(rooms, walls, 0.6))  # what shows through the windows
    return join(parts)


def _roof(
    rng: np.random.Generator, kind: str, width: float, depth: float, eaves: float, wall: float
) -> Mesh:
    if kind == "flat":
        return _flat_roof(rng, width, depth, eaves, wall)
    if kind == "gable across":
        return _roof(rng, "gable", depth, width, eaves, wall).moved([0, 0, 0], np.pi / 2)
    over = rng.uniform(0.2, 0.6)
    rise = np.tan(np.radians(rng.uniform(25, 48))) * depth / 2
    w, d = width / 2 + over, depth / 2 + over
    drop = rise * over / (depth / 2)
    inset = 0.0 if kind == "gable" else min(0.8 * w, depth / 2)
    low, high = eaves - drop, eaves + rise
    ridge = [[w - inset, 0, high], [-w + inset, 0, high]]
    slopes = [[[-w, -d, low], [w, -d, low], *ridge], [[w, d, low], [-w, d, low], *ridge[::-1]]]
    parts = [quads(slopes, _TILE)]
    if kind == "gable":
        ends = [
            [
                [s * width / 2, -depth / 2, eaves],
                [s * width / 2, depth / 2, eaves],
                [s * width / 2, 0, high],
            ]
            for s in (-1, 1)
        ]
        parts.append(triangles(ends, wall))
    else:
        ends = [[[s * w, -d, low], [s * w, d, low], [s * (w - inset), 0, high]] for s in (-1, 1)]
        parts.append(triangles(ends, _TILE))
    parts += [_chimney(rng, width, high) for _ in range(int(rng.integers(0, 3)))]
    if rng.random() < 0.4 and rise > 2.2:
        parts.append(_dormers(rng, width, depth, eaves, rise))
    return join(parts)


def _flat_roof(
    rng: np.random.Generator, width: float, depth: float, eaves: float, wall: float
) -> Mesh:
    lip = rng.uniform(0.2, 0.7)
    rims = [([0, s * depth / 2, eaves + lip / 2], [width + 0.3, 0.25, lip + 0.2]) for s in (-1, 1)]
    rims += [([s * width / 2, 0, eaves + lip / 2], [0.25, depth + 0.3, lip + 0.2]) for s in (-1, 1)]
    parts = [boxes([c for c, _ in rims], [s for _, s in rims], wall)]
    parts.append(boxes([0, 0, eaves], [width, depth, 0.1], _FLAT))
    count = int(rng.integers(1, 5))
    size = rng.uniform([0.8, 0.8, 0.6], [2.6, 2.6, 2.2], (count, 3))
    at = rng.uniform(-0.3, 0.3, (count, 3)) * [width, depth, 0]
    parts.append(boxes(at + [0, 0, eaves] + size * [0, 0, 0.5], size, 0.4))
    return join(parts)


def _chimney(rng: np.random.Generator, width: float, high: float) -> Mesh:
    size = rng.uniform([0.4, 0.4, 1.2], [0.9, 0.7, 2.4])
    return boxes(
        [rng.uniform(-0.45, 0.45) * width, rng.uniform(-0.6, 0.6), high - 0.5 + size[2] / 4],
        size,
        0.35,
    )


def _dormers(
    rng: np.random.Generator, width: float, depth: float, eaves: float, rise: float
) -> Mesh:
    count = int(rng.integers(1, max(2, int(width / 3.5)) + 1))
    x = (np.arange(count) + 0.5) / count * 0.8 * width - 0.4 * width
    wide, high = rng.uniform([1.0, 1.1], [1.8, 1.6])
    deep = 0.45 * depth
    y = -depth / 2 + 0.12 * depth + deep / 2
    center = np.column_stack([x, np.full(count, y), np.full(count, eaves + 0.1 * rise + high / 2)])
    return boxes(center, [wide, deep, high], 0.45)


def garage(rng: np.random.Generator) -> Building:
    """A garage with a recessed door."""
    width, depth, high = rng.uniform([2.8, 5.0, 2.3], [6.2, 6.5, 2.9])
    wall = float(rng.uniform(0.35, 0.7))
    shell = boxes([0, 0.1, high / 2 - 0.4], [width, depth - 0.2, high + 0.8], wall)
    lintel = boxes([0, -depth / 2 + 0.1, high - 0.15], [width, 0.2, 0.3], wall)
    piers = boxes(
        [[s * (width / 2 - 0.15), -depth / 2 + 0.1, high / 2 - 0.4] for s in (-1, 1)],
        [0.3, 0.2, high + 0.8],
        wall,
    )
    if rng.random() < 0.5:
        roof = boxes([0, 0, high + 0.1], [width + 0.4, depth + 0.4, 0.2], _FLAT)
    else:
        roof = _roof(rng, "gable across", width, depth, high, wall)
    return Building(join([shell, lintel, piers, roof]), width, depth)


def shed(rng: np.random.Generator) -> Building:
    """A garden shed with a sloping or pitched roof."""
    width, depth, high = rng.uniform([1.6, 1.4, 1.8], [4.0, 3.0, 2.3])
    walls = boxes([0, 0, high / 2 - 0.2], [width, depth, high + 0.4], 0.4)
    return Building(join([walls, _roof(rng, "gable", width, depth, high, 0.4)]), width, depth)
