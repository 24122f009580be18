"""Industrial buildings: halls with roller doors, concrete training houses with open windows."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from segloc.types import Float64

from .buildings import Building
from .mesh import Mesh, above, boxes, glass, join, loft, quads, tubes
from .plant import handrail

_CONCRETE, _STEEL, _DARK = 0.45, 0.3, 0.2


def hall(rng: np.random.Generator) -> Building:
    """A hall clad in folded sheet: roller doors, a strip of windows, downpipes, roof vents."""
    width, depth, high = rng.uniform([12.0, 10.0, 4.5], [34.0, 24.0, 9.0])
    paint = float(rng.uniform(0.3, 0.7))
    pitch = float(rng.uniform(0.25, 0.9))
    fold = float(rng.uniform(0.02, 0.07))
    corners = [(-width / 2, -depth / 2), (width / 2, -depth / 2)]
    corners += [(width / 2, depth / 2), (-width / 2, depth / 2)]
    parts = []
    for k, (x, y) in enumerate(corners):
        long = width if k % 2 == 0 else depth
        doors = _doors(rng, long, high) if k % 2 == 0 or rng.random() < 0.3 else np.zeros((0, 3))
        side = _clad_wall(rng, long, high, pitch, fold, paint, doors)
        parts.append(side.moved([x, y, 0], k * np.pi / 2))
    parts.append(_hall_roof(rng, width, depth, high, paint))
    return Building(join(parts), width, depth)


def _doors(rng: np.random.Generator, long: float, high: float) -> Float64:
    """Roller doors (n, 3) in a wall: from, to, height of the opening."""
    wide = rng.uniform(3.0, 5.0)
    room = int(long / (wide + 1.2))
    count = int(rng.integers(1, room + 1)) if room else 0
    first = rng.uniform(0.6, long - count * (wide + 1.2) + 0.6) if count else 0.0
    begin = first + np.arange(count) * (wide + 1.2)
    top = np.full(count, rng.uniform(3.2, min(5.0, high - 0.6)))
    return np.column_stack([begin, begin + wide, top])


def _clad_wall(
    rng: np.random.Generator,
    long: float,
    high: float,
    pitch: float,
    fold: float,
    paint: float,
    doors: Float64,
) -> Mesh:
    """A wall in the plane y = 0 that looks towards -y, from x = 0 to ``long``."""
    edges = np.concatenate([[0.0], doors[:, :2].reshape(-1), [long]]).reshape(-1, 2)
    spans = [(a, b, -0.6, high) for a, b in edges if b - a > 0.05]
    spans += [(a, b, top, high) for a, b, top in doors]
    parts = []
    for a, b, low, top in spans:
        n = max(4, int((b - a) / pitch) * 4)
        x = np.linspace(a, b, n)
        y = np.where(np.arange(n) % 4 > 1, fold, 0.0)
        parts.append(_sheet(x, y, low, top, paint))
    parts += [_roller_door(rng, a, b, top, paint) for a, b, top in doors]
    if high > 5.6 and rng.random() < 0.6:
        parts.append(_window_strip(long, high - rng.uniform(0.8, 1.4)))
    pipes = np.arange(0.3, long, rng.uniform(6, 12))[:, None] * [1, 0, 0] + [0, -0.1, -0.3]
    parts.append(tubes(pipes, pipes + above(high + 0.3), [0.06, 0.06], _STEEL, sides=6))
    return join(parts)


def _roller_door(rng: np.random.Generator, a: float, b: float, top: float, paint: float) -> Mesh:
    """A door from x = a to b, closed or raised, with jambs, bollards and sometimes a canopy."""
    raised = top * rng.choice([0.0, 0.0, 0.35, 0.9])
    slats = np.arange(raised, top + 0.01, 0.16)
    y = 0.25 + 0.02 * (np.arange(len(slats)) % 2)
    line = np.column_stack([np.zeros(len(slats)), y, slats])
    jambs = [[[x, 0, -0.2], [x, 0.3, -0.2], [x, 0.3, top], [x, 0, top]] for x in (a, b)]
    posts = np.array([[x + s * 0.35, -0.6, -0.2] for x, s in ((a, -1), (b, 1))])
    parts = [
        loft([line + [a, 0, 0], line + [b, 0, 0]], 0.5, closed=False),
        quads(jambs, paint),
        tubes(posts, posts + above(1.2), [0.09, 0.09], 0.6),
    ]
    if rng.random() < 0.3:
        parts.append(boxes([(a + b) / 2, -0.6, top + 0.2], [b - a + 0.6, 1.2, 0.1], _STEEL))
    return join(parts)


def _window_strip(long: float, low: float) -> Mesh:
    """Panes side by side under the eaves."""
    n = int(long / 1.6)
    x = (np.arange(n) + 0.5) * long / n
    pane = np.array([[-0.6, 0], [0.6, 0], [0.6, 0.6], [-0.6, 0.6]])
    corner = np.zeros((n, 4, 3))
    corner[..., 0] = x[:, None] + pane[:, 0]
    corner[..., 1], corner[..., 2] = -0.02, low + pane[:, 1]
    return glass(quads(corner, 0.0))


def _sheet(x: Float64, y: Float64, low: float, top: float, paint: float) -> Mesh:
    foot = np.column_stack([x, y, np.full(len(x), low)])
    return loft(np.stack([foot, foot + above(top - low)], axis=1), paint, closed=False)


def _hall_roof(
    rng: np.random.Generator, width: float, depth: float, high: float, paint: float
) -> Mesh:
    bays = int(rng.choice([1, 1, 2, 3]))
    saw = rng.random() < 0.3
    edge = np.linspace(-depth / 2, depth / 2, bays + 1)
    rise = np.tan(np.radians(rng.uniform(6, 20))) * depth / bays / 2
    parts = []
    for a, b in pairwise(edge):
        ridge = b - 0.02 if saw else (a + b) / 2
        line = np.array([[a, high], [ridge, high + rise], [b, high]])
        ends = [np.column_stack([np.full(3, s * width / 2), line]) for s in (-1, 1)]
        parts.append(loft(ends, paint))
    count = int(rng.integers(1, 6))
    at = np.column_stack(
        [rng.uniform(-0.4, 0.4, (count, 2)) * [width, depth], np.full(count, high)]
    )
    parts.append(tubes(at, at + above(rise + rng.uniform(0.5, 2.5)), [0.25, 0.25], _STEEL))
    return join(parts)


def training_house(rng: np.random.Generator) -> Building:
    """A bare concrete house for fire drill: window holes, inner walls, stairs outside."""
    width, depth = rng.uniform([5.0, 5.0], [14.0, 10.0])
    floors = int(rng.integers(1, 6)) if width < 9 else int(rng.integers(1, 4))
    rise = float(rng.uniform(2.6, 3.2))
    top = floors * rise
    corners = [(-width / 2, -depth / 2), (width / 2, -depth / 2)]
    corners += [(width / 2, depth / 2), (-width / 2, depth / 2)]
    parts = [
        _pierced_wall(rng, width if k % 2 == 0 else depth, floors, rise).moved(
            [*c, 0], k * np.pi / 2
        )
        for k, c in enumerate(corners)
    ]
    slabs = np.column_stack([np.zeros((floors + 1, 2)), rise * np.arange(floors + 1)])
    parts.append(boxes(slabs, [width - 0.05, depth - 0.05, 0.2], _CONCRETE))
    inner = rng.uniform(-0.25, 0.25, (floors, 1)) * [width, 0]
    middle = np.column_stack([inner, slabs[:-1, 2] + rise / 2])
    parts.append(boxes(middle, [0.15, depth - 0.5, rise], _CONCRETE))
    if rng.random() < 0.5:
        rim = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1], [-1, -1]]) * [width / 2, depth / 2]
        parts.append(handrail(np.column_stack([rim * 0.97, np.full(5, top)])))
    else:
        parts.append(
            boxes([[0, s * depth / 2, top + 0.4] for s in (-1, 1)], [width, 0.2, 0.8], 0.4)
        )
    if floors > 1:
        parts.append(_outer_stairs(width, depth, floors, rise))
    if rng.random() < 0.4:
        size = rng.uniform([2.0, 2.0, 2.0], [0.5 * width, 0.6 * depth, 3.0])
        parts.append(boxes([*rng.uniform(-0.2, 0.2, 2), top + size[2] / 2], size, _CONCRETE))
    return Building(join(parts), width + (2.6 if floors > 1 else 0.0), depth)


def _outer_stairs(width: float, depth: float, floors: int, rise: float) -> Mesh:
    parts, x = [], width / 2 + 0.65
    for k in range(floors - 1):
        t = np.linspace(0, 1, 15)[:, None]
        way = (1 - 2 * (k % 2)) * (t - 0.5) * (depth - 1.0)
        step = np.hstack([np.full_like(t, x), way, (k + t) * rise])
        parts.append(boxes(step, [1.2, 0.3, 0.06], _STEEL))
        parts.append(handrail(step[[0, 7, 14]] + [0.6, 0, 0]))
    posts = np.array([[x + 0.55, s * (depth / 2 - 0.4), -0.2] for s in (-1, 1)])
    parts.append(tubes(posts, posts + above((floors - 1) * rise), [0.07, 0.07], _STEEL))
    return join(parts)


def _pierced_wall(rng: np.random.Generator, long: float, floors: int, rise: float) -> Mesh:
    """A wall 0.25 m thick with holes for windows, and for a door or two."""
    thick = 0.25
    columns = max(1, int(long / rng.uniform(2.2, 3.8)))
    u = np.linspace(0, long, columns + 1)
    parts = [boxes([long / 2, thick / 2, -0.4], [long, thick, 0.8], _CONCRETE)]
    for floor in range(floors):
        z = floor * rise
        for a, b in pairwise(u):
            kind = rng.random()
            middle = (a + b) / 2
            if kind < 0.25 or b - a < 1.2:
                parts.append(
                    boxes([middle, thick / 2, z + rise / 2], [b - a, thick, rise], _CONCRETE)
                )
                continue
            door = kind > 0.85 and floor == 0
            half = 0.5 if door else rng.uniform(0.4, 0.42 * (b - a))
            low, high = (0.0, 2.1) if door else (rng.uniform(0.7, 1.1), rng.uniform(1.9, 2.3))
            strips = [(a, middle - half, 0.0, rise), (middle + half, b, 0.0, rise)]
            strips += [(middle - half, middle + half, high, rise)]
            strips += [(middle - half, middle + half, 0.0, low)] if low > 0 else []
            span = np.array(strips)
            center = np.column_stack(
                [span[:, :2].mean(1), np.full(len(span), thick / 2), z + span[:, 2:].mean(1)]
            )
            size = np.column_stack(
                [span[:, 1] - span[:, 0], np.full(len(span), thick), span[:, 3] - span[:, 2]]
            )
            parts.append(boxes(center, size, _CONCRETE))
            if rng.random() < 0.25 and not door:
                shutter = [middle + 1.4 * half, -0.05, z + (low + high) / 2]
                parts.append(boxes(shutter, [0.8 * half, 0.05, high - low], _DARK))
    return join(parts)
