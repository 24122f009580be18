"""Industrial plant: tanks, silos, pipe racks, gantries, towers with open stairs, masts."""

from __future__ import annotations

import numpy as np

from segloc.types import Float64

from .buildings import Building
from .mesh import Mesh, above, boxes, ellipsoid, join, quads, tubes

_STEEL, _CONCRETE, _CLAD = 0.3, 0.45, 0.55
_RAIL = 1.1  # height of handrails, metres


def handrail(corners: Float64) -> Mesh:
    """Posts and two rails along a (n, 3) line."""
    a, b = corners[:-1], corners[1:]
    posts = tubes(corners, corners + above(_RAIL), [0.025, 0.025], _STEEL, sides=4)
    rails = [
        tubes(a + above(z), b + above(z), [0.022, 0.022], _STEEL, sides=4)
        for z in (0.5 * _RAIL, _RAIL)
    ]
    return join([posts, *rails])


def ladder(foot: Float64, high: float) -> Mesh:
    """A ladder up from (3,) ``foot``, its stiles apart along y, with hoops above 2.5 m."""
    stile = np.array([[0, -0.22, 0], [0, 0.22, 0]]) + foot
    rung = np.arange(0.3, high, 0.3)[:, None] * [0, 0, 1]
    parts = [
        tubes(stile, stile + above(high), [0.025, 0.025], _STEEL, sides=4),
        tubes(rung + stile[0], rung + stile[1], [0.015, 0.015], _STEEL, sides=4),
    ]
    angle = np.linspace(-1.9, 1.9, 7)
    hoop = np.column_stack([0.38 + 0.38 * np.cos(angle), 0.38 * np.sin(angle), 0 * angle])
    for z in np.arange(2.5, high, 0.9):
        ring = foot + hoop + above(z)
        parts.append(tubes(ring[:-1], ring[1:], [0.02, 0.02], _STEEL, sides=3))
    return join(parts)


def upright_tank(rng: np.random.Generator) -> Building:
    """A tank with a conical roof, railing and ladder; sometimes within a bund wall."""
    r, high = rng.uniform([1.1, 2.2], [4.2, 9.0])
    paint = float(rng.uniform(0.3, 0.7))
    rise = rng.uniform(0.05, 0.3) * r
    shell = tubes(
        [[0, 0, -0.4], [0, 0, high]], [[0, 0, high], [0, 0, high + rise]], [[r, r], [r, 0.05]],
        paint, sides=28,
    )  # fmt: skip
    seams = np.arange(1.5, high, rng.uniform(1.2, 2.2))[:, None] * [0, 0, 1]
    parts = [shell, tubes(seams, seams + above(0.06), [r + 0.03, r + 0.03], paint, sides=28)]
    angle = np.linspace(0, 2 * np.pi, int(6 * r))
    edge = np.column_stack([r * np.cos(angle), r * np.sin(angle), np.full(len(angle), high)])
    parts.append(handrail(edge * [0.95, 0.95, 1]))
    parts.append(ladder(np.array([r + 0.08, 0, 0]), high + 0.9))
    nozzle = np.array([[0, -r + 0.1, z] for z in rng.uniform(0.4, 1.2, 2)])
    parts.append(tubes(nozzle, nozzle - [0, 0.6, 0], [0.12, 0.12], _STEEL))
    size = 2 * r + 1.6
    if rng.random() < 0.45:
        size += rng.uniform(1.0, 3.0)
        parts.append(_bund(size - 0.3, float(rng.uniform(0.5, 1.1))))
    return Building(join(parts).moved([0, 0, 0], float(rng.uniform(0, 6))), size, size)


def _bund(size: float, high: float) -> Mesh:
    half = size / 2
    middle = [[half, 0], [-half, 0], [0, half], [0, -half]]
    long = [[0.2, size], [0.2, size], [size, 0.2], [size, 0.2]]
    at = np.column_stack([middle, np.full(4, high / 2 - 0.2)])
    return boxes(at, np.column_stack([long, np.full(4, high + 0.4)]), _CONCRETE)


def lying_tank(rng: np.random.Generator) -> Building:
    """A pressure vessel along x on saddles, with a walkway or valves on top."""
    r, long = rng.uniform([0.6, 3.0], [1.6, 11.0])
    long = max(long, 2 * r + 0.02)
    z = r + rng.uniform(0.4, 1.6)
    x = long / 2 - r
    paint = float(rng.uniform(0.4, 0.75))
    parts = [tubes([[-x, 0, z]], [[x, 0, z]], [r, r], paint, sides=20)]
    parts += [ellipsoid([s * x, 0, z], [0.6 * r, r, r], paint, rings=7) for s in (-1, 1)]
    saddles = [[s * 0.65 * x, 0, z / 2 - 0.3] for s in (-1, 1)]
    parts.append(boxes(saddles, [0.4, 1.6 * r, z + 0.2], _CONCRETE))
    top = np.column_stack([rng.uniform(-x, x, 4), np.zeros(4), np.full(4, z + r - 0.1)])
    parts.append(tubes(top, top + above(0.5), [0.12, 0.12], _STEEL))
    if rng.random() < 0.5:
        edge = np.array([[-x, -0.4, z + r], [0, -0.4, z + r], [x, -0.4, z + r]])
        parts += [handrail(edge), ladder(np.array([-x, r + 0.1, 0.0]), z + r)]
    return Building(join(parts), long + 0.4, 2 * r + 1.0)


def silos(rng: np.random.Generator) -> Building:
    """One to four silos on legs in a row along x, with hoppers and a walkway above."""
    count = int(rng.integers(1, 5))
    r, high, leg = rng.uniform([0.9, 4.0, 1.5], [1.9, 9.0, 3.5])
    pitch = 2 * r + rng.uniform(0.3, 1.0)
    x = (np.arange(count) - (count - 1) / 2) * pitch
    foot = np.column_stack([x, np.zeros((count, 2))])
    paint = float(rng.uniform(0.4, 0.7))
    parts = [
        tubes(foot + above(leg), foot + above(leg + high), [r, r], paint, sides=20),
        tubes(foot + above(leg - 0.7 * r), foot + above(leg), [0.2, r], paint, sides=20),
        tubes(foot + above(leg + high), foot + above(leg + high + 0.4), [r, 0.1], paint, sides=20),
    ]
    turn = np.pi / 4 + np.arange(4) * np.pi / 2
    around = np.column_stack([r * np.cos(turn), r * np.sin(turn), np.zeros(4)])
    legs = (foot[:, None] + around).reshape(-1, 3)
    parts.append(tubes(legs - above(0.3), legs + above(leg + 0.5), [0.1, 0.1], _STEEL))
    cross = (foot[:, None] + np.roll(around, 1, 0)).reshape(-1, 3)
    parts.append(tubes(legs, cross + above(leg), [0.03, 0.03], _STEEL, sides=4))
    ends = np.array([[x[0] - r, 0, leg + high + 0.4], [x[-1] + r, 0, leg + high + 0.4]])
    parts.append(handrail(ends))
    parts.append(ladder(np.array([x[-1] + r + 0.1, 0, 0]), leg + high + 1.0))
    return Building(join(parts), (count - 1) * pitch + 2 * r + 1.2, 2 * r + 0.6)


def pipe_rack(rng: np.random.Generator) -> Building:
    """Portal frames along x that carry pipes of many sizes on one or two levels."""
    bays = int(rng.integers(2, 7))
    pitch, wide, high = rng.uniform([3.5, 1.6, 2.6], [6.0, 4.0, 5.5])
    long = bays * pitch
    levels = [high] if rng.random() < 0.4 else [high, high + rng.uniform(1.0, 1.8)]
    x = np.linspace(-long / 2, long / 2, bays + 1)
    foot = np.array([[a, s * wide / 2, -0.3] for a in x for s in (-1, 1)])
    parts = [boxes(foot + above((levels[-1] + 0.6) / 2), [0.2, 0.2, levels[-1] + 0.6], _STEEL)]
    for z in levels:
        beam = np.column_stack([x, np.zeros(len(x)), np.full(len(x), z)])
        parts.append(boxes(beam, [0.18, wide + 0.2, 0.2], _STEEL))
        count = int(rng.integers(2, 8))
        y = np.sort(rng.uniform(-wide / 2 + 0.15, wide / 2 - 0.15, count))
        r = rng.uniform(0.04, 0.2, count)
        begin = np.column_stack([np.full(count, -long / 2 - 0.3), y, z + 0.1 + r])
        end = begin * [-1, 1, 1]
        drop = rng.random(count) < 0.3
        end[drop, 0] = x[rng.integers(1, len(x), drop.sum())] - 0.5
        parts.append(tubes(begin, end, np.column_stack([r, r]), _CLAD))
        parts.append(tubes(end[drop], end[drop] * [1, 1, 0], np.column_stack([r, r])[drop], _CLAD))
    if rng.random() < 0.6:
        brace = foot[:2] + above(0.3)
        parts.append(
            tubes(brace, brace + [pitch, 0, levels[0] - 0.3], [0.05, 0.05], _STEEL, sides=4)
        )
    return Building(join(parts), long + 1.0, wide + 0.6)


def gantry(rng: np.random.Generator) -> Building:
    """A travelling crane: two portals, a girder along x, a trolley with a hook."""
    span, high, deep = rng.uniform([7.0, 5.0, 2.5], [14.0, 9.0, 4.0])
    feet = np.array([[s * span / 2, t * deep / 2, 0] for s in (-1, 1) for t in (-1, 1)])
    tops = feet * [1, 0.3, 0] + above(high)
    parts = [tubes(feet - above(0.2), tops, [0.18, 0.14], _STEEL)]
    parts.append(boxes([[0, s * 0.15 * deep, high] for s in (-1, 1)], [span + 1, 0.3, 0.7], 0.6))
    parts.append(boxes([[s * span / 2, 0, 0.25] for s in (-1, 1)], [0.5, deep + 0.8, 0.5], 0.6))
    x = rng.uniform(-0.35, 0.35) * span
    parts.append(boxes([x, 0, high + 0.6], [1.4, 0.4 * deep, 0.7], _STEEL))
    hook = rng.uniform(1.0, 0.7 * high)
    parts.append(tubes([[x, 0, hook]], [[x, 0, high]], [0.03, 0.03], _STEEL, sides=4))
    parts.append(boxes([x, 0, hook], [0.3, 0.3, 0.5], _STEEL))
    return Building(join(parts), span + 1.2, deep + 1.2)


def stair_tower(rng: np.random.Generator) -> Building:
    """A steel tower of two to six open floors, zigzag stairs on one side."""
    floors = int(rng.integers(2, 7))
    wide, deep, rise = rng.uniform([2.6, 3.2, 2.5], [5.5, 6.0, 3.1])
    top = floors * rise
    corner = np.array([[sx * wide / 2, sy * deep / 2, 0.0] for sx in (-1, 1) for sy in (-1, 1)])
    roofed = rng.random() < 0.4
    parts = [tubes(corner - above(0.3), corner + above(top + 2.4 * roofed), 0.11, _STEEL)]
    levels = rise * np.arange(1, floors + 1)
    decks = np.column_stack([np.zeros((floors, 2)), levels])
    parts.append(boxes(decks, [wide, deep, 0.08], _STEEL))
    edge = np.array([[1, -1], [-1, -1], [-1, 1], [1, 1]]) * [wide / 2, deep / 2]
    for z in levels:
        parts.append(handrail(np.column_stack([edge, np.full(4, z)])))
    stairs = 1.0
    for k in range(floors):
        t = np.linspace(0, 1, int(rise / 0.19))[:, None]
        way = (1 - 2 * (k % 2)) * (t - 0.5) * (deep - 0.8)
        step = np.hstack([np.full_like(t, wide / 2 + stairs / 2), way, (k + t) * rise])
        parts.append(boxes(step, [stairs, 0.27, 0.05], _STEEL))
        parts.append(handrail(step[[0, len(t) // 2, -1]] + [stairs / 2, 0, 0]))
    a = corner[:2] + above(0.1)
    for k in range(floors):
        if rng.random() < 0.8:
            low = a + above(k * rise)
            parts.append(tubes(low, low[::-1] + above(rise), [0.04, 0.04], _STEEL, sides=4))
    if roofed:
        parts.append(boxes([0, 0, top + 2.4], [wide + 0.6, deep + 0.6, 0.12], _STEEL))
    wall = np.array([[-1, -1], [-1, 1]]) * [wide / 2, deep / 2]
    for z in levels[rng.random(floors) < 0.35]:
        low = np.column_stack([wall, np.full(2, z - rise)])
        parts.append(quads(np.concatenate([low, low[::-1] + above(rise)]), _CLAD))
    return Building(join(parts).moved([-stairs / 2, 0, 0]), wide + stairs + 0.3, deep + 0.3)


def light_mast(rng: np.random.Generator) -> Mesh:
    """A mast of 8 to 18 m with floodlights on a crossbar along y."""
    tall, wide = rng.uniform([8.0, 1.0], [18.0, 3.5])
    parts = [
        boxes([0, 0, 0.1], [0.8, 0.8, 0.5], _CONCRETE),
        tubes([[0, 0, 0]], [[0, 0, tall]], [0.18, 0.07], _STEEL, sides=10),
        boxes([0, 0, tall], [0.1, wide, 0.1], _STEEL),
    ]
    y = np.linspace(-wide / 2, wide / 2, int(rng.integers(2, 6)))
    heads = np.column_stack([np.full(len(y), 0.25), y, np.full(len(y), tall - 0.2)])
    parts.append(boxes(heads, rng.uniform([0.25, 0.3, 0.3], [0.4, 0.5, 0.5]), 0.6))
    if tall > 12:
        parts.append(ladder(np.array([0.2, 0, 0]), tall))
    return join(parts)
