"""Buildings: blocks with four facades, wings, roofs with chimneys and dormers, garages, sheds."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from segloc.types import Float64

from .mesh import Mesh, above, boxes, glass, join, quads, rectangle, triangles, tubes, xyz

_TRIM, _WOOD, _STEEL, _CURTAIN = 0.6, 0.4, 0.3, 0.45


@dataclass(frozen=True)
class FacadeStyle:
    """What the facades of one house share; lengths in metres."""

    floor_height: float
    base: float
    pitch: float
    window: tuple[float, float]
    sill: float
    recess: float
    blank: float
    balconies: float
    shutters: bool
    reflectance: float

    @staticmethod
    def draw(rng: np.random.Generator, *, flats: bool) -> FacadeStyle:
        """A style at random; ``flats`` for blocks of flats rather than houses."""
        pitch = float(rng.uniform(2.4, 4.2))
        wide = float(rng.uniform(0.35, 0.62)) * pitch
        return FacadeStyle(
            floor_height=float(rng.uniform(2.6, 3.1)),
            base=float(rng.uniform(0.1, 0.9)),
            pitch=pitch,
            window=(wide, float(rng.uniform(1.05, 1.6))),
            sill=float(rng.uniform(0.65, 0.95)),
            recess=float(rng.uniform(0.1, 0.32)),
            blank=float(rng.uniform(0.05, 0.3)),
            balconies=float(rng.choice([0.0, 0.35, 0.8]) if flats else rng.choice([0.0, 0.12])),
            shutters=bool(rng.random() < 0.25),
            reflectance=float(rng.uniform(0.3, 0.75)),
        )


def facade(
    rng: np.random.Generator, style: FacadeStyle, width: float, floors: int, *, front: bool
) -> Mesh:
    """One facade of a house with ``floors`` storeys; the front one has a door and more relief."""
    columns = max(1, int(width / style.pitch))
    u = np.linspace(0, width, columns + 1)
    z = style.base + style.floor_height * np.arange(floors + 1)
    cell = np.stack(np.meshgrid(np.arange(columns), np.arange(floors)), axis=-1).reshape(-1, 2)
    rect = np.stack([u[cell[:, 0]], u[cell[:, 0] + 1], z[cell[:, 1]], z[cell[:, 1] + 1]], axis=1)
    blank = rng.random(len(cell)) < (style.blank if front else min(0.8, style.blank + 0.25))
    hole = _openings(rng, style, rect)
    parts: list[Mesh] = []
    if front:
        door = int(rng.integers(columns))
        blank[door] = False
        middle = rect[door, :2].mean()
        hole[door] = [middle - 0.55, middle + 0.55, z[0], z[0] + rng.uniform(2.0, 2.3)]
        parts.append(_entrance(rng, style, float(middle), width))
    plinth = np.array([[0, width, -0.8, style.base]])
    parts.append(quads(_rect_rows(plinth, 0.0), style.reflectance))
    parts.append(quads(_rect_rows(rect[blank], 0.0), style.reflectance))
    clear = rng.random(len(cell)) < 0.45
    if front:
        clear[door] = False
    parts.append(_wall_with_holes(style, rect[~blank], hole[~blank], clear[~blank]))
    if style.shutters:
        parts.append(_shutters(hole[~blank & (hole[:, 2] > z[0])]))
    upper = ~blank & (cell[:, 1] > 0) & (rng.random(len(cell)) < style.balconies)
    if front and upper.any():
        parts.append(_balconies(rng, rect[upper]))
    if front and width > 7 and rng.random() < 0.3:
        parts.append(_bay(rng, style, width, floors))
    return join(parts)


def _openings(rng: np.random.Generator, style: FacadeStyle, rect: Float64) -> Float64:
    """Window openings (n, 4) u0, u1, z0, z1 in cells (n, 4)."""
    n = len(rect)
    usual = style.window[0] * rng.choice([1.0, 1.0, 0.6, 1.3], n)
    wide = np.minimum(usual, rect[:, 1] - rect[:, 0] - 0.3)
    middle = rect[:, :2].mean(axis=1) + rng.normal(0, 0.06, n)
    low = rect[:, 2] + style.sill * rng.choice([1.0, 1.0, 1.0, 0.15], n)
    high = np.minimum(rect[:, 2] + style.sill + style.window[1], rect[:, 3] - 0.15)
    return np.stack([middle - wide / 2, middle + wide / 2, low, high], axis=1)


def _rect_rows(rect: NDArray[np.float64], y: float) -> Float64:
    u0, u1, z0, z1 = rect.T
    return xyz(np.stack([u0, u1, u1, u0], axis=1), y, np.stack([z0, z0, z1, z1], axis=1))


def _wall_with_holes(
    style: FacadeStyle, rect: Float64, hole: Float64, clear: NDArray[np.bool_]
) -> Mesh:
    """Wall about openings; behind those that are not ``clear``, a curtain or a door leaf."""
    u0, u1, z0, z1 = rect.T
    a0, a1, b0, b1 = hole.T
    around = [(u0, a0, z0, z1), (a1, u1, z0, z1), (a0, a1, z0, b0), (a0, a1, b1, z1)]
    wall = [quads(_rect_rows(np.stack(strip, axis=1), 0.0), style.reflectance) for strip in around]
    face, pane = _rect_rows(hole, 0.0), _rect_rows(hole, style.recess)
    reveal = np.stack([face, np.roll(face, -1, 1), np.roll(pane, -1, 1), pane], axis=2)
    middle = (a0 + a1) / 2
    ledges = boxes(xyz(middle, -0.04, b0 - 0.04), xyz(a1 - a0 + 0.16, 0.16, 0.07), _TRIM)
    bars = boxes(xyz(middle, style.recess - 0.03, (b0 + b1) / 2), xyz(0.07, 0.06, b1 - b0), _TRIM)
    windows = [glass(quads(pane[clear], 0.0)), quads(pane[~clear], _CURTAIN)]
    return join([*wall, quads(reveal, style.reflectance), *windows, ledges, bars])


def _shutters(hole: Float64) -> Mesh:
    a0, a1, b0, b1 = hole.T
    wide = 0.45 * (a1 - a0)
    size, sides = xyz(wide, 0.06, b1 - b0), (a0 - 0.55 * wide, a1 + 0.55 * wide)
    return join(boxes(xyz(side, -0.04, (b0 + b1) / 2), size, _WOOD) for side in sides)


def _balconies(rng: np.random.Generator, rect: Float64) -> Mesh:
    deep, high = rng.uniform([0.8, 0.85], [1.6, 1.1])
    solid = rng.random() < 0.5
    wide = (rect[:, 1] - rect[:, 0]) * rng.uniform(0.7, 0.98)
    x, z = rect[:, :2].mean(axis=1), rect[:, 2]
    parts = [boxes(xyz(x, -deep / 2, z), xyz(wide, deep, 0.18), 0.5)]
    if solid:
        parts.append(boxes(xyz(x, -deep, z + high / 2), xyz(wide, 0.08, high), 0.5))
        for side in (-1, 1):
            end = xyz(x + side * wide / 2, -deep / 2, z + high / 2)
            parts.append(boxes(end, [0.08, deep, high], 0.5))
    else:
        parts.append(boxes(xyz(x, -deep, z + high), xyz(wide, 0.05, 0.06), 0.5))
        for t in np.linspace(-0.5, 0.5, 12):
            bar = xyz(x + t * wide, -deep, z + high / 2)
            parts.append(boxes(bar, [0.03, 0.03, high], 0.5))
    return join(parts)


def _bay(rng: np.random.Generator, style: FacadeStyle, width: float, floors: int) -> Mesh:
    """A bay window with slanted cheeks, over one or more storeys."""
    wide, deep = rng.uniform([1.8, 0.5], [3.4, 1.1])
    middle = rng.uniform(wide / 2 + 0.3, width - wide / 2 - 0.3)
    top = style.base + style.floor_height * int(rng.integers(1, floors + 1)) - 0.2
    half, cheek = wide / 2, 0.28 * wide
    x = np.array([-half, -half + cheek, half - cheek, half]) + middle
    y = np.array([0, -deep, -deep, 0])
    side = np.array([[k, k + 1, k + 1, k] for k in range(3)])

    def band(low: float, high: float, reflectance: float, inward: float = 0.0) -> Mesh:
        return quads(xyz(x[side], y[side] + inward, [low, low, high, high]), reflectance)

    parts, low = [], -0.8
    for floor in range(round((top + 0.2 - style.base) / style.floor_height)):
        sill = style.base + floor * style.floor_height + 0.75
        parts.append(band(low, sill, style.reflectance))
        parts.append(glass(band(sill, sill + 1.3, 0.0, 0.08)))
        low = sill + 1.3
    parts.append(band(low, top, style.reflectance))
    parts.append(quads(xyz(x, y, top), 0.35))
    return join(parts)


def _entrance(rng: np.random.Generator, style: FacadeStyle, middle: float, width: float) -> Mesh:
    """Steps up to the door, and a canopy or a porch over it."""
    rise = style.base
    steps = max(1, int(np.ceil(rise / 0.18)))
    k = np.arange(steps)
    center = xyz(middle, -0.15 - 0.15 * k, rise / 2 * (1 - k / steps) - 0.3)
    size = xyz(1.6, 0.3 + 0.3 * k, rise * (1 - k / steps) + 0.6)
    parts = [boxes(center, size, 0.45)]
    kind = rng.choice(["none", "canopy", "porch"], p=[0.35, 0.35, 0.3])
    deep, wide, high = rng.uniform([0.7, 1.4, 2.4], [1.9, 3.0, 2.8])
    if kind != "none":
        parts.append(boxes([middle, -deep / 2, rise + high], [wide, deep, 0.15], 0.4))
    if kind == "porch":
        foot = np.array([[middle + s * 0.45 * wide, -deep + 0.1, -0.4] for s in (-1, 1)])
        radius = rng.uniform(0.06, 0.16)
        parts.append(tubes(foot, foot + above(rise + high + 0.4), [radius, radius], _TRIM))
        z = rise + high + np.array([0.9, 0.9, 0, 0])
        for s in (-1, 1):
            x = middle + s * wide / 2 * np.array([0, 0, 1, 1])
            parts.append(quads(xyz(x, [-deep, 0, 0, -deep], z), 0.35))
    if width > 6 and rng.random() < 0.7:
        pipe = np.array([[rng.choice([0.25, width - 0.25]), -0.09, -0.4]])
        top = style.base + style.floor_height
        parts.append(tubes(pipe, pipe + above(top + 2.0), [0.05, 0.05], _STEEL, sides=6))
    return join(parts)


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
        storeys = max(1, floors - int(rng.integers(2)))
        wing = _block(rng, style, wing_width, wing_depth, storeys, flat=False)
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
    parts = []
    for k, (x, y) in enumerate(rectangle([0, 0], (width, depth), 0.0)):
        side = facade(rng, style, (width, depth)[k % 2], floors, front=k == 0)
        parts.append(side.moved([x, y, 0], k * np.pi / 2))
    eaves = style.base + floors * style.floor_height
    pitched = ["gable", "gable across", "hip"]
    kind = "flat" if flat else str(rng.choice(pitched, p=[0.45, 0.25, 0.3]))
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
        y, z = [-depth / 2, depth / 2, 0], [eaves, eaves, high]
        parts.append(triangles([xyz(s * width / 2, y, z) for s in (-1, 1)], wall))
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
    x, y = rng.uniform(-0.45, 0.45) * width, rng.uniform(-0.6, 0.6)
    return boxes([x, y, high - 0.5 + size[2] / 4], size, 0.35)


def _dormers(
    rng: np.random.Generator, width: float, depth: float, eaves: float, rise: float
) -> Mesh:
    count = int(rng.integers(1, max(2, int(width / 3.5)) + 1))
    x = (np.arange(count) + 0.5) / count * 0.8 * width - 0.4 * width
    wide, high = rng.uniform([1.0, 1.1], [1.8, 1.6])
    deep = 0.45 * depth
    y = -depth / 2 + 0.12 * depth + deep / 2
    return boxes(xyz(x, y, eaves + 0.1 * rise + high / 2), [wide, deep, high], 0.45)


def garage(rng: np.random.Generator) -> Building:
    """A garage with a recessed door."""
    width, depth, high = rng.uniform([2.8, 5.0, 2.3], [6.2, 6.5, 2.9])
    wall = float(rng.uniform(0.35, 0.7))
    shell = boxes([0, 0.1, high / 2 - 0.4], [width, depth - 0.2, high + 0.8], wall)
    lintel = boxes([0, -depth / 2 + 0.1, high - 0.15], [width, 0.2, 0.3], wall)
    middle = [[s * (width / 2 - 0.15), -depth / 2 + 0.1, high / 2 - 0.4] for s in (-1, 1)]
    piers = boxes(middle, [0.3, 0.2, high + 0.8], wall)
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
