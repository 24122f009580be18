"""What grows and lies between trees: thickets, ferns, grass, logs, stumps, brushwood, stones."""

from __future__ import annotations

import numpy as np

from segloc.types import Float64

from .mesh import Mesh, above, join, polygon, quads, scraps
from .trees import limbs

_LEAF, _WOOD, _STONE = 0.5, 0.35, 0.4


def thicket(rng: np.random.Generator, radius: float, height: float, detail: float = 1.0) -> Mesh:
    """A mound of brambles or scrub over uneven lobes, with canes inside."""
    count = int(rng.integers(3, 8))
    turn, out = rng.uniform(0, 2 * np.pi, count), radius * rng.uniform(0, 0.75, count)
    size = np.stack(
        [radius * rng.uniform(0.3, 0.7, count), height * rng.uniform(0.4, 1.0, count)], axis=1
    )
    size[0, 1] = height
    foot = np.stack([out * np.cos(turn), out * np.sin(turn), np.zeros(count)], axis=1)
    dense = detail * rng.uniform(14, 28)
    many = np.maximum(8, dense * size[:, 0] * (size[:, 0] + 2 * size[:, 1])).astype(int)
    of = np.repeat(np.arange(count), many)
    way = rng.normal(size=(len(of), 3))
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    way[:, 2] = np.abs(way[:, 2])
    depth = rng.uniform(0.05, 1.0, (len(of), 1)) ** 0.4
    spread = np.stack([size[of, 0], size[of, 0], size[of, 1]], axis=1)
    center = foot[of] + way * depth * spread + rng.normal(0, 0.05, (len(of), 3))
    leaves = scraps(rng, center, rng.uniform(0.08, 0.13) / np.sqrt(detail), _LEAF)
    picked = center[rng.integers(0, len(center), min(len(center), 4 * count))]
    start = np.column_stack([0.5 * picked[:, :2], np.full(len(picked), -0.1)])
    canes = np.stack([start, 0.5 * (start + picked) + above(0.1), picked], axis=1)
    return join([leaves, limbs(canes, np.array([0.015, 0.012, 0.006]), _WOOD, 3)])


def fern(rng: np.random.Generator) -> Mesh:
    """A clump of fronds that arch outwards, 0.4 to 1.3 m high."""
    count, tall = int(rng.integers(5, 14)), rng.uniform(0.4, 1.3)
    turn = rng.uniform(0, 2 * np.pi, count)
    s = np.tile(np.linspace(0.15, 1.0, 8), count)
    of = np.repeat(turn, 8)
    reach = np.repeat(tall * rng.uniform(0.5, 1.0, count), 8) * s
    rise = tall * np.sin(s * np.repeat(rng.uniform(1.5, 2.4, count), 8))
    center = np.stack([reach * np.cos(of), reach * np.sin(of), rise], axis=1)
    return scraps(rng, center + rng.normal(0, 0.04, center.shape), 0.11, _LEAF)


def grass(rng: np.random.Generator) -> Mesh:
    """A patch of tall grass or rushes."""
    count, tall = int(rng.integers(25, 90)), rng.uniform(0.35, 1.1)
    foot = np.column_stack(
        [rng.normal(0, rng.uniform(0.15, 0.6), (count, 2)), np.full(count, -0.05)]
    )
    up = rng.uniform(0.5, 1.0, count) * tall
    tip = foot + np.column_stack([rng.normal(0, 0.3, (count, 2)) * up[:, None], up])
    side = rng.normal(0, 0.025, (count, 3)) * [1, 1, 0]
    blades = np.stack([foot - side, foot + side, tip + 0.4 * side, tip - 0.4 * side], axis=1)
    return quads(blades, _LEAF)


def log(rng: np.random.Generator, ground: Float64) -> Mesh:
    """A fallen trunk over (n, 3) ground points along it, with stubs of branches."""
    radius = rng.uniform(0.12, 0.42)
    taper = np.linspace(1.0, rng.uniform(0.4, 0.8), len(ground))
    line = ground + above(0.6 * radius)
    line[:, 2] = 0.5 * line[:, 2] + 0.5 * np.linspace(line[0, 2], line[-1, 2], len(line))
    rough = rng.normal(1, 0.07, (1, len(line), 8))
    trunk = limbs(line[None], radius * taper[None], _WOOD, 8, rough)
    ends = [_cut(line[k], line[k] - line[k - 1 if k else 1], radius * taper[k]) for k in (0, -1)]
    count = int(rng.integers(2, 9))
    foot = line[rng.integers(0, len(line), count)]
    way = rng.normal(0, 1, (count, 3))
    way[:, 2] = np.abs(way[:, 2])
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    tips = foot + way * rng.uniform(0.3, 1.6, (count, 1))
    stubs = limbs(np.stack([foot, tips], axis=1), radius * np.array([0.35, 0.12]), _WOOD, 4)
    return join([trunk, *ends, stubs])


def stump(rng: np.random.Generator) -> Mesh:
    """What is left of a felled or broken tree."""
    radius, tall = rng.uniform(0.15, 0.55), rng.uniform(0.25, 1.3)
    line = np.column_stack([rng.normal(0, 0.02, (5, 2)), [-0.3, 0.05, 0.2, 0.6 * tall, tall]])
    flare = radius * np.array([1.8, 1.4, 1.1, 1.0, 0.95])
    body = limbs(line[None], flare[None], _WOOD, 10, rng.normal(1, 0.1, (1, 5, 10)))
    return join([body, _cut(line[-1], np.array([0.1, 0.0, 1.0]), 0.95 * radius)])


def root_plate(rng: np.random.Generator) -> Mesh:
    """The roots of a tree that the wind has thrown, upright, facing +x."""
    radius = rng.uniform(0.7, 1.8)
    rim = np.linspace(0, 2 * np.pi, 11, endpoint=False)
    reach = radius * rng.uniform(0.7, 1.15, 11)
    disc = np.column_stack(
        [rng.normal(0, 0.08, 11), reach * np.cos(rim), reach * np.sin(rim) + 0.7 * radius]
    )
    back = polygon(disc - [rng.uniform(0.25, 0.6), 0, 0], _WOOD)
    tips = disc * rng.uniform(1.05, 1.3, (11, 1)) + rng.normal(0, 0.1, (11, 3))
    roots = limbs(
        np.stack([0.6 * disc + above(0.3 * radius), tips], axis=1), np.array([0.08, 0.02]), _WOOD, 4
    )
    return join([polygon(disc, _WOOD), back, roots])


def brushwood(rng: np.random.Generator) -> Mesh:
    """A heap of branches."""
    count, wide = int(rng.integers(25, 70)), rng.uniform(0.8, 2.2)
    middle = rng.normal(0, [0.4 * wide, 0.4 * wide, 0.0], (count, 3))
    near = np.exp(-0.5 * np.sum(middle[:, :2] ** 2, axis=1) / (0.4 * wide) ** 2)
    middle[:, 2] = rng.uniform(0.02, rng.uniform(0.5, 1.3), count) * near
    half = rng.normal(0, [0.6, 0.6, 0.12], (count, 3))
    thick = np.column_stack([rng.uniform(0.01, 0.04, count), np.full(count, 0.006)])
    return limbs(np.stack([middle - half, middle + half], axis=1), thick, _WOOD, 3)


def woodpile(rng: np.random.Generator) -> Mesh:
    """Stacked logs along y, as wait beside tracks."""
    radius, long = rng.uniform(0.1, 0.22), rng.uniform(1.8, 5.0)
    rows, wide = int(rng.integers(2, 6)), int(rng.integers(4, 10))
    parts = []
    for row in range(rows):
        x = (np.arange(wide - row) - (wide - row) / 2) * 2.05 * radius
        z = radius * (0.9 + 1.75 * row)
        a = np.column_stack([x, rng.normal(-long / 2, 0.1, len(x)), np.full(len(x), z)])
        b = a + [0, long, 0]
        thick = radius * rng.uniform(0.75, 1.05, (len(x), 1)) * np.array([1.0, 0.9])
        parts.append(limbs(np.stack([a, b], axis=1), thick, _WOOD, 7))
        parts += [_cut(end, np.array([0.0, 1.0, 0.0]), 0.9 * radius) for end in [*a, *b]]
    return join(parts)


def boulder(rng: np.random.Generator) -> Mesh:
    """A stone half sunk into the ground."""
    size = rng.uniform(0.3, 1.1) * rng.uniform(0.6, 1.3, 3)
    latitude = np.linspace(-np.pi / 2, np.pi / 2, 6)
    longitude = np.linspace(0, 2 * np.pi, 9, endpoint=False)
    bumps = rng.normal(1, 0.1, (6, 9))
    bumps[[0, -1]] = 1.0
    flat, high = np.cos(latitude)[:, None] * bumps, np.sin(latitude)[:, None] * bumps
    ring = np.stack([flat * np.cos(longitude), flat * np.sin(longitude), high], axis=2)
    ring = np.concatenate([ring, ring[:, :1]], axis=1) * size + above(0.3 * size[2])
    corners = np.stack([ring[:-1, :-1], ring[:-1, 1:], ring[1:, 1:], ring[1:, :-1]], axis=2)
    return quads(corners, _STONE)


def _cut(center: Float64, normal: Float64, radius: float) -> Mesh:
    """The disc where a trunk was cut or broken."""
    way = normal / np.linalg.norm(normal)
    u = np.cross(way, np.eye(3)[np.argmin(np.abs(way))])
    u /= np.linalg.norm(u)
    angle = np.linspace(0, 2 * np.pi, 8, endpoint=False)[:, None]
    return polygon(center + radius * (np.cos(angle) * u + np.sin(angle) * np.cross(way, u)), _WOOD)
