"""Industrial buildings: halls with roller doors, concrete training houses with open windows."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from segloc.types import Float64

from .buildings import Building
from .mesh import (
    Mesh,
    above,
    at_height,
    boxes,
    ellipsoid,
    glass,
    join,
    loft,
    polar,
    quads,
    triangles,
    tubes,
    xyz,
)

_STEEL, _WOOD, _CONCRETE, _RUST = 0.3, 0.4, 0.45, 0.2
_CORRUGATION = np.array([0.0, 0.0, 1.0, 1.0]) * 0.036


def shipping_container(rng: np.random.Generator) -> Mesh:
    """A container of 20 or 40 feet along x: corrugated, dented, its doors open or shut."""
    long = 12.19 if rng.random() < 0.3 else 6.06
    wide, high = 2.44, float(rng.choice([2.59, 2.59, 2.9]))
    paint = float(rng.uniform(0.15, 0.6))
    x = np.linspace(-long / 2 + 0.1, long / 2 - 0.1, int(long / 0.075))
    fold = _CORRUGATION[np.arange(len(x)) % 4]
    parts = []
    for side in (-1, 1):
        inward = fold + _dents(rng, x, high)
        z = np.linspace(0.12, high - 0.1, 7)[:, None]
        sheet = xyz(x, side * (wide / 2 - 0.03 - inward), z)
        parts.append(loft(sheet.transpose(1, 0, 2), paint, closed=False))
    parts.append(_container_frame(long, wide, high, paint))
    parts.append(boxes([-long / 2 + 0.06, 0, high / 2], [0.05, wide - 0.2, high - 0.2], paint))
    parts.append(_container_doors(rng, long, wide, high, paint))
    return join(parts).moved([0, 0, 0.05], np.pi * float(rng.integers(2)))


def _dents(rng: np.random.Generator, x: Float64, high: float) -> Float64:
    """How far the (7, n) points of a side wall are pushed in."""
    z = np.linspace(0, high, 7)[:, None]
    depth = np.zeros((7, len(x)))
    for _ in range(int(rng.integers(0, 4))):
        at = rng.uniform([x[0], 0.3], [x[-1], high - 0.3])
        size = rng.uniform(0.2, 0.7)
        away = (x - at[0]) ** 2 + (z - at[1]) ** 2
        depth += rng.uniform(0.03, 0.14) * np.exp(-away / (2 * size**2))
    return depth


def _container_frame(long: float, wide: float, high: float, paint: float) -> Mesh:
    corner = np.array(_SIGNS) * [long / 2 - 0.08, wide / 2 - 0.08]
    posts = boxes(at_height(corner, high / 2), [0.16, 0.16, high], paint)
    edges = [(side, z) for side in (-1, 1) for z in (0.07, high - 0.06)]
    rails = boxes([[0, s * (wide / 2 - 0.05), z] for s, z in edges], [long, 0.1, 0.14], paint)
    sills = boxes([[s * (long / 2 - 0.05), 0, z] for s, z in edges], [0.1, wide, 0.14], paint)
    decks = boxes([[0, 0, 0.12], [0, 0, high - 0.04]], [long - 0.1, wide - 0.1, 0.03], paint)
    return join([posts, rails, sills, decks])


_SIGNS = ((-1, -1), (1, -1), (1, 1), (-1, 1))


def _container_doors(
    rng: np.random.Generator, long: float, wide: float, high: float, paint: float
) -> Mesh:
    leaf = wide / 2 - 0.1
    shut = rng.random() < 0.6
    parts = []
    for side in (-1, 1):
        door = boxes([0, -side * leaf / 2, high / 2], [0.05, leaf, high - 0.25], paint)
        foot = xyz(0.06, -side * leaf * np.array([0.3, 0.7]), 0.15)
        bars = tubes(foot, foot + above(high - 0.3), [0.02, 0.02], _STEEL, sides=5)
        turn = 0.0 if shut else side * rng.uniform(0.3, 2.6) * (rng.random() < 0.85)
        hinge = [long / 2 - 0.03, side * (wide / 2 - 0.1), 0.0]
        parts.append(join([door, bars]).moved(hinge, float(turn)))
    return join(parts)


def container_stack(rng: np.random.Generator) -> Mesh:
    """One to three containers on top of each other, not quite in line."""
    count = int(rng.choice([1, 2, 3], p=[0.55, 0.33, 0.12]))
    shift = np.column_stack([rng.normal(0, 0.12, count), rng.normal(0, 0.06, count)])
    return join(
        shipping_container(rng).moved([*shift[k], 2.65 * k], float(rng.normal(0, 0.01)))
        for k in range(count)
    )


def pallets(rng: np.random.Generator) -> Mesh:
    """A stack of one to twelve pallets, each a little turned; sometimes with a load."""
    count = int(rng.integers(1, 13))
    slat = np.linspace(-0.5, 0.5, 6)[:, None] * [0.0, 0.7, 0.0]
    top = boxes(slat + above(0.135), [1.2, 0.1, 0.022], _WOOD)
    blocks = [[x, y, 0.06] for x in (-0.52, 0, 0.52) for y in (-0.34, 0, 0.34)]
    one = join([top, boxes(blocks, [0.14, 0.1, 0.11], _WOOD)])
    parts = [
        one.moved([*rng.normal(0, 0.02, 2), 0.145 * k], float(rng.normal(0, 0.04)))
        for k in range(count)
    ]
    if count < 4 and rng.random() < 0.6:
        size = rng.uniform([0.7, 0.5, 0.3], [1.2, 0.8, 1.6])
        parts.append(boxes([0, 0, 0.145 * count + size[2] / 2], size, 0.4))
    return join(parts)


def drums(rng: np.random.Generator) -> Mesh:
    """One to eight oil drums, standing close together, now and then one on its side."""
    count = int(rng.integers(1, 9))
    at = np.stack(np.meshgrid(np.arange(3), np.arange(3)), -1).reshape(-1, 2)[:count] * 0.64
    foot = at_height(at - at.mean(axis=0) + rng.normal(0, 0.02, at.shape), 0.0)
    tip = foot + above(0.88)
    if count > 1 and rng.random() < 0.3:
        foot[-1], tip[-1] = foot[-1] + [0, 0.9, 0.3], foot[-1] + [0.88, 1.0, 0.3]
    radius = rng.uniform(0.28, 0.3)
    hoops = [(foot + (tip - foot) * t, foot + (tip - foot) * (t + 0.03)) for t in (0.33, 0.66)]
    rims = [tubes(a, b, [radius + 0.012] * 2, _STEEL, sides=14) for a, b in hoops]
    return join([tubes(foot, tip, [radius, radius], _STEEL, sides=14), *rims])


def stores(rng: np.random.Generator) -> Mesh:
    """What is left in a corner: drums, pallets, crates, or a coil of pipe."""
    pick = rng.random()
    if pick < 0.35:
        return drums(rng)
    if pick < 0.7:
        return pallets(rng)
    count = int(rng.integers(2, 6))
    size = rng.uniform([0.4, 0.3, 0.3], [1.1, 0.7, 0.9], (count, 3))
    return boxes(at_height(rng.uniform(-0.6, 0.6, (count, 2)), size[:, 2] / 2), size, _WOOD)


def barriers(rng: np.random.Generator) -> Mesh:
    """One to five concrete barriers end to end along x."""
    high, wide = rng.uniform([0.75, 0.45], [1.1, 0.65])
    long = rng.uniform(1.5, 3.0)
    profile = np.array([[-0.5, 0], [-0.5, 0.1], [-0.2, 0.4], [-0.14, 1.0]])
    ring = np.concatenate([profile, profile[::-1] * [-1, 1]]) * [wide, high]
    one = loft([xyz(x, *ring.T) for x in (-long / 2, long / 2)], _CONCRETE)
    count = int(rng.integers(1, 6))
    x = (np.arange(count) - count / 2) * (long + 0.06)
    return join(one.moved([a, rng.normal(0, 0.05), -0.03], rng.normal(0, 0.03)) for a in x)


def cones(rng: np.random.Generator) -> Mesh:
    """A row of three to eight traffic cones along x."""
    count = int(rng.integers(3, 9))
    high = rng.uniform(0.5, 1.0)
    at = xyz((np.arange(count) - count / 2) * rng.uniform(0.8, 2.0), 0, 0)
    at += rng.normal(0, 0.08, (count, 3)) * [1, 1, 0]
    body = tubes(at, at + above(high), [0.3 * high, 0.04], 0.6)
    return join([body, boxes(at + above(0.02), [0.5 * high, 0.5 * high, 0.05], 0.2)])


def tumbled(
    rng: np.random.Generator, centers: ArrayLike, sizes: ArrayLike, reflectance: float
) -> Mesh:
    """Boxes turned every which way: (n, 3) centers and sizes."""
    middle = np.asarray(centers, dtype=float)
    upright = boxes(np.zeros_like(middle), sizes, reflectance).triangles.reshape(len(middle), -1, 3)
    R = Rotation.random(len(middle), random_state=rng).as_matrix()
    return triangles(upright @ R + middle[:, None], reflectance)


def rubble(rng: np.random.Generator) -> Mesh:
    """A heap of broken concrete with beams sticking out, 2 to 7 m across."""
    reach, high = rng.uniform([1.0, 0.6], [3.4, 2.4])
    angle = np.linspace(0, 2 * np.pi, 13)[:-1]
    wave = rng.uniform(0.75, 1.2, 12)
    levels = ((1.0, -0.2), (0.7, 0.3 * high), (0.4, 0.65 * high), (0.1, 0.85 * high))
    rings = [polar(k * reach * wave, angle, z) for k, z in levels]
    count = int(30 * reach)
    out = np.sqrt(rng.uniform(0, 1, count)) * reach
    turn = rng.uniform(0, 2 * np.pi, count)
    lift = 0.85 * high * np.clip(1 - out / reach, 0, 1)
    center = polar(out, turn, lift)
    size = rng.uniform(0.1, 0.9, (count, 1)) * rng.uniform([0.5, 0.4, 0.15], [1.2, 1.0, 0.6])
    beams = int(rng.integers(0, 5))
    foot = center[:beams]
    tip = foot + rng.normal(0, 1, (beams, 3)) * [1.0, 1.0, 0.4] + above(0.8)
    blocks = tumbled(rng, center, size, _CONCRETE)
    return join([loft(rings, _CONCRETE), blocks, tubes(foot, tip, 0.07, _RUST, sides=4)])


_CLAD = 0.55
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
    hoop = [0.38, 0, 0] + polar(0.38, angle)
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
    parts.append(handrail(polar(r, angle, high) * [0.95, 0.95, 1]))
    parts.append(ladder(np.array([r + 0.08, 0, 0]), high + 0.9))
    nozzle = np.array([[0, -r + 0.1, z] for z in rng.uniform(0.4, 1.2, 2)])
    parts.append(tubes(nozzle, nozzle - [0, 0.6, 0], [0.12, 0.12], _STEEL))
    size = 2 * r + 1.6
    if rng.random() < 0.45:
        size += rng.uniform(1.0, 3.0)
        parts.append(_bund(size - 0.3, float(rng.uniform(0.5, 1.1))))
    return Building(join(parts).moved([0, 0, 0], float(rng.uniform(0, 6))), size, size)


def _bund(size: float, high: float) -> Mesh:
    half, tall, z = size / 2, high + 0.4, high / 2 - 0.2
    middle = [[half, 0, z], [-half, 0, z], [0, half, z], [0, -half, z]]
    walls = [[0.2, size, tall]] * 2 + [[size, 0.2, tall]] * 2
    return boxes(middle, walls, _CONCRETE)


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
    top = xyz(rng.uniform(-x, x, 4), 0, z + r - 0.1)
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
    foot = xyz(x, 0, 0)
    paint = float(rng.uniform(0.4, 0.7))
    parts = [
        tubes(foot + above(leg), foot + above(leg + high), [r, r], paint, sides=20),
        tubes(foot + above(leg - 0.7 * r), foot + above(leg), [0.2, r], paint, sides=20),
        tubes(foot + above(leg + high), foot + above(leg + high + 0.4), [r, 0.1], paint, sides=20),
    ]
    turn = np.pi / 4 + np.arange(4) * np.pi / 2
    around = polar(r, turn)
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
        parts.append(boxes(xyz(x, 0, z), [0.18, wide + 0.2, 0.2], _STEEL))
        count = int(rng.integers(2, 8))
        y = np.sort(rng.uniform(-wide / 2 + 0.15, wide / 2 - 0.15, count))
        r = rng.uniform(0.04, 0.2, count)
        begin = xyz(-long / 2 - 0.3, y, z + 0.1 + r)
        end = begin * [-1, 1, 1]
        drop = rng.random(count) < 0.3
        end[drop, 0] = x[rng.integers(1, len(x), drop.sum())] - 0.5
        parts.append(tubes(begin, end, np.column_stack([r, r]), _CLAD))
        parts.append(tubes(end[drop], end[drop] * [1, 1, 0], np.column_stack([r, r])[drop], _CLAD))
    if rng.random() < 0.6:
        brace = foot[:2] + above(0.3)
        tip = brace + [pitch, 0, levels[0] - 0.3]
        parts.append(tubes(brace, tip, [0.05, 0.05], _STEEL, sides=4))
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
    parts.append(boxes(xyz(0, 0, levels), [wide, deep, 0.08], _STEEL))
    edge = np.array([[1, -1], [-1, -1], [-1, 1], [1, 1]]) * [wide / 2, deep / 2]
    parts += [handrail(at_height(edge, z)) for z in levels]
    stairs = 1.0
    for k in range(floors):
        t = np.linspace(0, 1, int(rise / 0.19))
        way = (1 - 2 * (k % 2)) * (t - 0.5) * (deep - 0.8)
        step = xyz(wide / 2 + stairs / 2, way, (k + t) * rise)
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
        low = at_height(wall, z - rise)
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
    heads = xyz(0.25, y, tall - 0.2)
    parts.append(boxes(heads, rng.uniform([0.25, 0.3, 0.3], [0.4, 0.5, 0.5]), 0.6))
    if tall > 12:
        parts.append(ladder(np.array([0.2, 0, 0]), tall))
    return join(parts)


_DARK = 0.2


def hall(rng: np.random.Generator) -> Building:
    """A hall clad in folded sheet: roller doors, a strip of windows, downpipes, roof vents."""
    width, depth, high = rng.uniform([12.0, 10.0, 4.5], [34.0, 24.0, 9.0])
    paint = float(rng.uniform(0.3, 0.7))
    pitch = float(rng.uniform(0.25, 0.9))
    fold = float(rng.uniform(0.02, 0.07))
    parts = []
    for k, corner in enumerate(_SIGNS):
        long = width if k % 2 == 0 else depth
        doors = _doors(rng, long, high) if k % 2 == 0 or rng.random() < 0.3 else np.zeros((0, 3))
        side = _clad_wall(rng, long, high, pitch, fold, paint, doors)
        x, y = np.array(corner) * [width / 2, depth / 2]
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
    line = xyz(0, y, slats)
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
    side, up = np.array([[-0.6, 0.6, 0.6, -0.6], [0, 0, 0.6, 0.6]])
    return glass(quads(xyz(x[:, None] + side, -0.02, low + up), 0.0))


def _sheet(x: Float64, y: Float64, low: float, top: float, paint: float) -> Mesh:
    foot = xyz(x, y, low)
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
        y, z = (a, ridge, b), (high, high + rise, high)
        parts.append(loft([xyz(s * width / 2, y, z) for s in (-1, 1)], paint))
    count = int(rng.integers(1, 6))
    at = at_height(rng.uniform(-0.4, 0.4, (count, 2)) * [width, depth], high)
    parts.append(tubes(at, at + above(rise + rng.uniform(0.5, 2.5)), [0.25, 0.25], _STEEL))
    return join(parts)


def training_house(rng: np.random.Generator) -> Building:
    """A bare concrete house for fire drill: window holes, inner walls, stairs outside."""
    width, depth = rng.uniform([5.0, 5.0], [14.0, 10.0])
    floors = int(rng.integers(1, 6)) if width < 9 else int(rng.integers(1, 4))
    rise = float(rng.uniform(2.6, 3.2))
    top = floors * rise
    parts = []
    for k, corner in enumerate(_SIGNS):
        side = _pierced_wall(rng, width if k % 2 == 0 else depth, floors, rise)
        x, y = np.array(corner) * [width / 2, depth / 2]
        parts.append(side.moved([x, y, 0], k * np.pi / 2))
    z = rise * np.arange(floors + 1)
    parts.append(boxes(xyz(0, 0, z), [width - 0.05, depth - 0.05, 0.2], _CONCRETE))
    inner = rng.uniform(-0.25, 0.25, floors) * width
    parts.append(boxes(xyz(inner, 0, z[:-1] + rise / 2), [0.15, depth - 0.5, rise], _CONCRETE))
    if rng.random() < 0.5:
        rim = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1], [-1, -1]]) * [width / 2, depth / 2]
        parts.append(handrail(at_height(rim * 0.97, top)))
    else:
        edges = [[0, s * depth / 2, top + 0.4] for s in (-1, 1)]
        parts.append(boxes(edges, [width, 0.2, 0.8], 0.4))
    if floors > 1:
        parts.append(_outer_stairs(width, depth, floors, rise))
    if rng.random() < 0.4:
        size = rng.uniform([2.0, 2.0, 2.0], [0.5 * width, 0.6 * depth, 3.0])
        parts.append(boxes([*rng.uniform(-0.2, 0.2, 2), top + size[2] / 2], size, _CONCRETE))
    return Building(join(parts), width + (2.6 if floors > 1 else 0.0), depth)


def _outer_stairs(width: float, depth: float, floors: int, rise: float) -> Mesh:
    parts, x = [], width / 2 + 0.65
    for k in range(floors - 1):
        t = np.linspace(0, 1, 15)
        way = (1 - 2 * (k % 2)) * (t - 0.5) * (depth - 1.0)
        step = xyz(x, way, (k + t) * rise)
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
                center = [middle, thick / 2, z + rise / 2]
                parts.append(boxes(center, [b - a, thick, rise], _CONCRETE))
                continue
            door = kind > 0.85 and floor == 0
            half = 0.5 if door else rng.uniform(0.4, 0.42 * (b - a))
            low, high = (0.0, 2.1) if door else (rng.uniform(0.7, 1.1), rng.uniform(1.9, 2.3))
            strips = [(a, middle - half, 0.0, rise), (middle + half, b, 0.0, rise)]
            strips += [(middle - half, middle + half, high, rise)]
            strips += [(middle - half, middle + half, 0.0, low)] if low > 0 else []
            x0, x1, z0, z1 = np.array(strips).T
            at = xyz((x0 + x1) / 2, thick / 2, z + (z0 + z1) / 2)
            parts.append(boxes(at, xyz(x1 - x0, thick, z1 - z0), _CONCRETE))
            if rng.random() < 0.25 and not door:
                shutter = [middle + 1.4 * half, -0.05, z + (low + high) / 2]
                parts.append(boxes(shutter, [0.8 * half, 0.05, high - low], _DARK))
    return join(parts)
