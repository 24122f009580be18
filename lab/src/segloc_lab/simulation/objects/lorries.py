"""Lorries and fire engines, parked: cabs, bodies of several kinds, wheels."""

from __future__ import annotations

import numpy as np

from .mesh import Mesh, boxes, glass, join, loft, tubes

_TYRE, _STEEL = 0.08, 0.3


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
    ends = [np.column_stack([side[:, 0], np.full(5, s * half), side[:, 1]]) for s in (-1, 1)]
    pane = np.array([[x0 + 0.5, 1.6], [x1 - 0.25, 1.6], [x1 - slant - 0.15, high - 0.35]])
    pane = np.concatenate([pane, [[x0 + 0.5, high - 0.35]]])
    windows = [
        loft(
            [
                np.column_stack([pane[:, 0], np.full(4, s * (half + d)), pane[:, 1]])
                for d in (0, 0.015)
            ],
            0.0,
        )
        for s in (-1, 1)
    ]
    mirrors = boxes([[x1 - 0.1, s * (half + 0.22), 1.9] for s in (-1, 1)], [0.12, 0.2, 0.5], _STEEL)
    return join([loft(ends, paint), *(glass(window) for window in windows), mirrors])


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
    tank = tubes([[rear + 0.1, 0, 1.0 + r]], [[front - 0.2, 0, 1.0 + r]], [r, r], 0.6, sides=18)
    back = tubes(
        [[rear + 0.1, 0, 1.0 + r]], [[rear - 0.05, 0, 1.0 + r]], [r, 0.7 * r], 0.6, sides=18
    )
    walk = boxes([(front + rear) / 2, 0, 1.02 + 2 * r], [0.8 * (front - rear), 0.5, 0.06], _STEEL)
    return join([tank, back, walk])
