"""Shipping containers, drums, pallets, barriers and heaps: what lies about on yards."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from segloc.types import Float64

from .mesh import Mesh, above, boxes, join, loft, triangles, tubes

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
        z = np.broadcast_to(np.linspace(0.12, high - 0.1, 7), inward.T.shape).T
        y = side * (wide / 2 - 0.03 - inward)
        sheet = np.stack([np.broadcast_to(x, z.shape), y, z], axis=-1)
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
    corner = np.array([[sx * (long / 2 - 0.08), sy * (wide / 2 - 0.08)] for sx, sy in _SIGNS])
    posts = boxes(np.column_stack([corner, np.full(4, high / 2)]), [0.16, 0.16, high], paint)
    rails = [
        boxes([0, side * (wide / 2 - 0.05), z], [long, 0.1, 0.14], paint)
        for side in (-1, 1)
        for z in (0.07, high - 0.06)
    ]
    sills = boxes(
        [[side * (long / 2 - 0.05), 0, z] for side in (-1, 1) for z in (0.07, high - 0.06)],
        [0.1, wide, 0.14],
        paint,
    )
    decks = boxes([[0, 0, 0.12], [0, 0, high - 0.04]], [long - 0.1, wide - 0.1, 0.03], paint)
    return join([posts, *rails, sills, decks])


_SIGNS = ((-1, -1), (1, -1), (1, 1), (-1, 1))


def _container_doors(
    rng: np.random.Generator, long: float, wide: float, high: float, paint: float
) -> Mesh:
    leaf = wide / 2 - 0.1
    shut = rng.random() < 0.6
    parts = []
    for side in (-1, 1):
        door = boxes([0, -side * leaf / 2, high / 2], [0.05, leaf, high - 0.25], paint)
        y = -side * leaf * np.array([0.3, 0.7])
        foot = np.column_stack([np.full(2, 0.06), y, np.full(2, 0.15)])
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
    foot = np.column_stack([at - at.mean(axis=0) + rng.normal(0, 0.02, at.shape), np.zeros(count)])
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
    at = rng.uniform(-0.6, 0.6, (count, 2))
    return boxes(np.column_stack([at, size[:, 2] / 2]), size, _WOOD)


def barriers(rng: np.random.Generator) -> Mesh:
    """One to five concrete barriers end to end along x."""
    high, wide = rng.uniform([0.75, 0.45], [1.1, 0.65])
    long = rng.uniform(1.5, 3.0)
    profile = np.array([[-0.5, 0], [-0.5, 0.1], [-0.2, 0.4], [-0.14, 1.0]])
    ring = np.concatenate([profile, profile[::-1] * [-1, 1]]) * [wide, high]
    one = loft([np.column_stack([np.full(8, x), ring]) for x in (-long / 2, long / 2)], _CONCRETE)
    count = int(rng.integers(1, 6))
    return join(
        one.moved(
            [(k - count / 2) * (long + 0.06), rng.normal(0, 0.05), -0.03], rng.normal(0, 0.03)
        )
        for k in range(count)
    )


def cones(rng: np.random.Generator) -> Mesh:
    """A row of three to eight traffic cones along x."""
    count = int(rng.integers(3, 9))
    high = rng.uniform(0.5, 1.0)
    at = np.zeros((count, 3))
    at[:, 0] = (np.arange(count) - count / 2) * rng.uniform(0.8, 2.0)
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
    rings = [
        np.column_stack(
            [k * reach * wave * np.cos(angle), k * reach * wave * np.sin(angle), np.full(12, z)]
        )
        for k, z in ((1.0, -0.2), (0.7, 0.3 * high), (0.4, 0.65 * high), (0.1, 0.85 * high))
    ]
    count = int(30 * reach)
    out = np.sqrt(rng.uniform(0, 1, count)) * reach
    turn = rng.uniform(0, 2 * np.pi, count)
    lift = 0.85 * high * np.clip(1 - out / reach, 0, 1)
    center = np.column_stack([out * np.cos(turn), out * np.sin(turn), lift])
    size = rng.uniform(0.1, 0.9, (count, 1)) * rng.uniform([0.5, 0.4, 0.15], [1.2, 1.0, 0.6])
    beams = int(rng.integers(0, 5))
    foot = center[:beams]
    tip = foot + rng.normal(0, 1, (beams, 3)) * [1.0, 1.0, 0.4] + above(0.8)
    return join(
        [
            loft(rings, _CONCRETE),
            tumbled(rng, center, size, _CONCRETE),
            tubes(foot, tip, [0.07, 0.07], _RUST, sides=4),
        ]
    )
