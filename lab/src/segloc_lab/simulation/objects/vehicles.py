"""Parked cars and vans: lofted bodies with glass, wheels and mirrors, each of its own size."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from segloc.types import Float64

from .mesh import Mesh, boxes, glass, join, loft, tubes, xyz

_TYRE = 0.08
_LORRY = 7.5  # where a lorry fits, there mostly is one; metres
_STEEL = 0.3


@dataclass(frozen=True)
class _Shape:
    """A body type: size ranges, and heights (share of the total) along its length.

    ``belt`` and ``roof`` are (position from the front, height) tables; where the roof lies above
    the belt line there is glass.
    """

    size: tuple[tuple[float, float], tuple[float, float], tuple[float, float]]
    belt: tuple[tuple[float, float], ...]
    roof: tuple[tuple[float, float], ...]
    windows: tuple[float, float]


_SHAPES = {
    "hatchback": _Shape(
        ((3.6, 4.2), (1.62, 1.76), (1.42, 1.56)),
        ((0, 0.42), (0.03, 0.52), (0.25, 0.64), (0.9, 0.66), (0.98, 0.62), (1, 0.4)),
        ((0, 0.42), (0.03, 0.52), (0.25, 0.64), (0.42, 0.97), (0.6, 1), (0.84, 0.95),
         (0.98, 0.62), (1, 0.4)),
        (0.25, 0.98),
    ),
    "saloon": _Shape(
        ((4.4, 5.0), (1.74, 1.88), (1.4, 1.5)),
        ((0, 0.4), (0.03, 0.5), (0.27, 0.63), (0.83, 0.66), (0.97, 0.64), (1, 0.42)),
        ((0, 0.4), (0.03, 0.5), (0.27, 0.63), (0.42, 0.97), (0.55, 1), (0.7, 0.93), (0.83, 0.66),
         (0.97, 0.64), (1, 0.42)),
        (0.27, 0.83),
    ),
    "estate": _Shape(
        ((4.4, 4.9), (1.74, 1.86), (1.43, 1.55)),
        ((0, 0.4), (0.03, 0.5), (0.26, 0.62), (0.93, 0.65), (0.99, 0.6), (1, 0.4)),
        ((0, 0.4), (0.03, 0.5), (0.26, 0.62), (0.4, 0.97), (0.55, 1), (0.88, 0.95), (0.99, 0.6),
         (1, 0.4)),
        (0.26, 0.99),
    ),
    "suv": _Shape(
        ((4.3, 4.9), (1.8, 1.95), (1.62, 1.82)),
        ((0, 0.42), (0.02, 0.56), (0.25, 0.63), (0.94, 0.66), (0.99, 0.6), (1, 0.42)),
        ((0, 0.42), (0.02, 0.56), (0.25, 0.63), (0.37, 0.96), (0.55, 1), (0.9, 0.96),
         (0.99, 0.6), (1, 0.42)),
        (0.25, 0.99),
    ),
    "van": _Shape(
        ((4.9, 6.2), (1.9, 2.06), (1.95, 2.7)),
        ((0, 0.3), (0.02, 0.38), (0.12, 0.45), (0.3, 0.5), (1, 0.5)),
        ((0, 0.3), (0.02, 0.38), (0.12, 0.45), (0.25, 0.93), (0.33, 1), (0.98, 1), (1, 0.97)),
        (0.12, 0.34),
    ),
    "pickup": _Shape(
        ((4.9, 5.4), (1.8, 1.95), (1.7, 1.85)),
        ((0, 0.4), (0.02, 0.55), (0.26, 0.6), (0.62, 0.62), (1, 0.62)),
        ((0, 0.4), (0.02, 0.55), (0.26, 0.6), (0.36, 0.97), (0.45, 1), (0.6, 0.97), (0.64, 0.62),
         (1, 0.62)),
        (0.26, 0.64),
    ),
}  # fmt: skip
_ODDS = {"hatchback": 0.3, "saloon": 0.17, "estate": 0.2, "suv": 0.16, "van": 0.12, "pickup": 0.05}


def vehicle(rng: np.random.Generator, longest: float = 6.2) -> tuple[Mesh, tuple[float, float]]:
    """A vehicle on its wheels, centred on the origin, front towards +x, with length and width."""
    if longest >= _LORRY and rng.random() < 0.8:
        return lorry(rng, longest)
    names = [name for name, shape in _SHAPES.items() if shape.size[0][0] < longest]
    odds = np.array([_ODDS[name] for name in names])
    shape = _SHAPES[names[int(rng.choice(len(names), p=odds / odds.sum()))]]
    low, high = np.array(shape.size).T
    length, width, height = rng.uniform(low, np.minimum(high, [longest, 9.0, 9.0]))
    paint = float(rng.choice([0.12, 0.3, 0.5, 0.75]))
    clear = rng.uniform(0.16, 0.24)
    parts = _body(shape, length, width, height, clear, paint)
    parts.append(_wheels(rng, length, width, float(rng.uniform(0.29, 0.37))))
    if rng.random() < 0.25 and height < 1.9:
        parts.append(_roof_load(rng, length, width, height))
    return join(parts), (float(length), float(width))


def _body(
    shape: _Shape, length: float, width: float, height: float, clear: float, paint: float
) -> list[Mesh]:
    stations = np.unique([x for table in (shape.belt, shape.roof) for x, _ in table])
    belt = np.interp(stations, *np.array(shape.belt).T) * height
    roof = np.interp(stations, *np.array(shape.roof).T) * height
    x = length * (0.5 - stations)
    bulge = 1 - 0.22 * np.abs(2 * stations - 1) ** 5
    wide = 0.5 * width * bulge
    narrow = wide - 0.22 * np.maximum(roof - belt, 0)
    lower = _sections(x, np.full_like(x, clear), wide * 0.96, belt, wide)
    inside = (stations >= shape.windows[0]) & (stations <= shape.windows[1])
    tall = roof > belt + 1e-6
    cabin = np.flatnonzero(inside | tall)
    upper = _sections(x[cabin], belt[cabin], wide[cabin], roof[cabin], narrow[cabin])
    box = np.flatnonzero(tall & (stations >= shape.windows[1]))
    parts = [loft(lower, paint), glass(loft(upper, 0.0))]
    top = _sections(x[cabin], roof[cabin] - 0.05, narrow[cabin], roof[cabin] + 0.01, narrow[cabin])
    parts.append(loft(top, paint))
    if len(box) > 1:
        solid = _sections(x[box], belt[box], wide[box] + 0.01, roof[box], narrow[box] + 0.01)
        parts.append(loft(solid, paint))
    ahead, aside = length * (0.5 - shape.windows[0] - 0.08), 0.5 * width + 0.09
    mirrors = [[ahead, y, float(belt.max()) + 0.08] for y in (aside, -aside)]
    parts.append(boxes(mirrors, [0.12, 0.18, 0.14], paint))
    return parts


def _sections(x: Float64, z0: Float64, half0: Float64, z1: Float64, half1: Float64) -> Float64:
    """Cross-sections (n, 4, 3): a trapezoid from (z0, half width 0) to (z1, half width 1)."""
    y = np.stack([half0, half1, -half1, -half0], axis=1)
    return xyz(x[:, None], y, np.stack([z0, z1, z1, z0], axis=1))


def _wheels(rng: np.random.Generator, length: float, width: float, radius: float) -> Mesh:
    front, rear = rng.uniform(0.29, 0.33, 2) * length
    y = 0.5 * width - 0.02
    hub = np.array([[x, side * y, radius] for x in (front, -rear) for side in (-1, 1)])
    inner = hub - [0.0, 0.2, 0.0] * np.sign(hub[:, 1:2])
    return tubes(inner, hub, [radius, radius], _TYRE, sides=12)


def _roof_load(rng: np.random.Generator, length: float, width: float, height: float) -> Mesh:
    size = [rng.uniform(0.3, 0.5) * length, rng.uniform(0.3, 0.6) * width, rng.uniform(0.12, 0.4)]
    return boxes([-0.05 * length, rng.uniform(-0.2, 0.2), height + 0.08 + size[2] / 2], size, 0.3)


def bicycle(rng: np.random.Generator) -> Mesh:
    """A parked bicycle, about 1.7 m long, along x."""
    r, base = rng.uniform(0.3, 0.36), rng.uniform(0.95, 1.1)
    angle = np.linspace(0, 2 * np.pi, 13)
    rim = xyz(np.cos(angle), 0, np.sin(angle) + 1) * r
    wheels = [rim + [side * base / 2, 0, 0] for side in (-1, 1)]
    seat, bars, crank = np.array([[-0.2, 0, 0.95], [0.38, 0, 1.0], [0.0, 0, 0.32]])
    rear, front = np.array([[-base / 2, 0, r], [base / 2, 0, r]])
    frame = [(seat, crank), (seat, bars), (crank, bars), (rear, seat), (rear, crank), (front, bars)]
    along, across = np.array([[0.13, 0, 0], [0, 0.28, 0]])
    grip = [(bars - across, bars + across), (seat - along, seat + along)]
    starts = np.concatenate([*(w[:-1] for w in wheels), [a for a, _ in frame + grip]])
    ends = np.concatenate([*(w[1:] for w in wheels), [b for _, b in frame + grip]])
    upright = tubes(starts, ends, 0.022, 0.3, sides=4)
    return upright.leaning(0.0, float(rng.uniform(-0.12, 0.12)))


def lorry(rng: np.random.Generator, longest: float) -> tuple[Mesh, tuple[float, float]]:
    """A lorry or fire engine on its wheels, centred, front towards +x, with length and width."""
    length = float(rng.uniform(6.6, max(6.7, min(longest, 10.5))))
    width = float(rng.uniform(2.2, 2.5))
    paint = float(rng.uniform(0.2, 0.7))
    kind = str(rng.choice(["fire engine", "box", "flat", "tanker"], p=[0.4, 0.25, 0.2, 0.15]))
    crew = kind == "fire engine" and rng.random() < 0.6
    cab = rng.uniform(2.6, 3.1) if crew else rng.uniform(1.7, 2.2)
    parts = [_cab(rng, length, width, cab, paint)]
    front, rear = length / 2 - cab - 0.1, -length / 2
    middle = [(front + rear) / 2, 0, 0.75]
    parts.append(boxes(middle, [front - rear, 0.5 * width, 0.3], _STEEL))
    make = {"fire engine": _pump, "box": _box, "flat": _flat, "tanker": _tanker}[kind]
    parts.append(make(rng, rear, front, width, paint))
    axles = [length / 2 - 1.3, -length / 2 + rng.uniform(1.4, 2.2)]
    if length > 8.8:
        axles.append(axles[1] + 1.35)
    hub = np.array([[x, s * (width / 2 - 0.05), 0.5] for x in axles for s in (-1, 1)])
    inner = hub - [0.0, 0.35, 0.0] * np.sign(hub[:, 1:2])
    parts.append(tubes(inner, hub, [0.5, 0.5], _TYRE, sides=14))
    return join(parts), (length, width)


def _cab(rng: np.random.Generator, length: float, width: float, cab: float, paint: float) -> Mesh:
    high, slant = rng.uniform([2.5, 0.05], [3.1, 0.35])
    x1, x0, half = length / 2, length / 2 - cab, width / 2
    side = np.array([[x0, 0.5], [x0, high], [x1 - slant, high], [x1, 1.5], [x1, 0.5]])
    ends = [xyz(side[:, 0], s * half, side[:, 1]) for s in (-1, 1)]
    pane = np.array([[x0 + 0.5, 1.6], [x1 - 0.25, 1.6], [x1 - slant - 0.15, high - 0.35]])
    pane = np.concatenate([pane, [[x0 + 0.5, high - 0.35]]])
    windows = [
        glass(loft([xyz(pane[:, 0], s * (half + d), pane[:, 1]) for d in (0, 0.015)], 0.0))
        for s in (-1, 1)
    ]
    mirrors = boxes([[x1 - 0.1, s * (half + 0.22), 1.9] for s in (-1, 1)], [0.12, 0.2, 0.5], _STEEL)
    return join([loft(ends, paint), *windows, mirrors])


def _pump(rng: np.random.Generator, rear: float, front: float, width: float, paint: float) -> Mesh:
    """The body of a fire engine: recessed lockers, a ladder and boxes on the roof."""
    high, middle, long = rng.uniform(2.5, 3.0), (front + rear) / 2, front - rear
    parts = [boxes([middle, 0, 0.6 + (high - 0.6) / 2], [long, width - 0.3, high - 0.6], 0.5)]
    for z in (0.7, high - 0.1):
        parts.append(boxes([middle, 0, z], [long, width, 0.2], paint))
    x = np.linspace(rear + 0.05, front - 0.05, int(rng.integers(3, 6)))
    ribs = [[a, s * (width / 2 - 0.08), 0.6 + high / 2 - 0.3] for a in x for s in (-1, 1)]
    parts.append(boxes(ribs, [0.12, 0.16, high - 0.7], paint))
    for y in rng.uniform(-0.4, 0.4, 2)[:, None] * width + [-0.25, 0.25]:
        rail = np.array([[rear - 0.4, v, high + 0.25] for v in y])
        parts.append(tubes(rail, rail + [long + 0.6, 0, 0], [0.04, 0.04], _STEEL, sides=5))
    rungs = np.linspace(rear, front, 14)[:, None] * [1, 0, 0] + [0, 0, high + 0.25]
    parts.append(boxes(rungs, [0.04, 0.6, 0.04], _STEEL))
    return join(parts)


def _box(rng: np.random.Generator, rear: float, front: float, width: float, paint: float) -> Mesh:
    high = rng.uniform(2.1, 2.8)
    size = [front - rear, width + 0.05, high]
    return boxes([(front + rear) / 2, 0, 0.95 + high / 2], size, float(rng.uniform(0.4, 0.75)))


def _flat(rng: np.random.Generator, rear: float, front: float, width: float, paint: float) -> Mesh:
    """A flatbed with a headboard, sides, and whatever it carries."""
    middle, long = (front + rear) / 2, front - rear
    parts = [boxes([middle, 0, 1.05], [long, width, 0.15], 0.4)]
    parts.append(boxes([front - 0.05, 0, 1.6], [0.08, width, 1.1], paint))
    if rng.random() < 0.5:
        board = [[middle, s * (width / 2 - 0.03), 1.3] for s in (-1, 1)]
        parts.append(boxes(board, [long, 0.05, 0.45], paint))
    for _ in range(int(rng.integers(0, 4))):
        size = rng.uniform([0.6, 0.6, 0.4], [2.0, 1.8, 1.5])
        at = [middle + rng.uniform(-0.3, 0.3) * long, rng.uniform(-0.2, 0.2), 1.12 + size[2] / 2]
        parts.append(boxes(at, size, 0.4))
    return join(parts)


def _tanker(
    rng: np.random.Generator, rear: float, front: float, width: float, paint: float
) -> Mesh:
    r = rng.uniform(0.75, 1.0)
    end = [rear + 0.1, 0, 1.0 + r]
    tank = tubes(end, [front - 0.2, 0, 1.0 + r], r, 0.6, sides=18)
    back = tubes(end, [rear - 0.05, 0, 1.0 + r], [r, 0.7 * r], 0.6, sides=18)
    walk = boxes([(front + rear) / 2, 0, 1.02 + 2 * r], [0.8 * (front - rear), 0.5, 0.06], _STEEL)
    return join([tank, back, walk])
