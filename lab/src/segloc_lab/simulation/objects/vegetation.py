"""Trees, bushes and hedges: wood as tubes, foliage as many small scraps that rays partly pass."""

from __future__ import annotations

import numpy as np

from segloc.types import Float64

from .mesh import SOLID, Mesh, boxes, join, loft, scraps, tubes

_BARK = 0.35
_LEAF = 0.5


def tree(rng: np.random.Generator, height: float | None = None) -> Mesh:
    """A tree with its foot at the origin: leaning trunk, forked branches, a crown of lobes."""
    tall = float(rng.uniform(4.5, 12.0)) if height is None else height
    if rng.random() < 0.18:
        return _conifer(rng, tall)
    trunk = rng.uniform(0.22, 0.42) * tall
    radius = rng.uniform(0.016, 0.028) * tall
    fork = np.array([*rng.normal(0, 0.04, 2) * tall, trunk])
    count = int(rng.integers(4, 9))
    angle = np.cumsum(rng.uniform(0.6, 1.4, count)) * 2 * np.pi / count
    reach = rng.uniform(0.10, 0.26, count) * tall
    rise = rng.uniform(0.25, 0.95, count) * (tall - trunk) * 0.8
    tips = fork + np.stack([reach * np.cos(angle), reach * np.sin(angle), rise], axis=1)
    starts = np.array([0.0, 0.0, -0.3]) + (fork - [0, 0, -0.3]) * rng.uniform(0.8, 1.0, (count, 1))
    wood = join(
        [
            tubes([[0.0, 0.0, -0.3]], fork, [radius, 0.75 * radius], _BARK),
            tubes(starts, tips, [0.45 * radius, 0.12 * radius], _BARK, sides=5),
        ]
    )
    size = (
        rng.uniform(0.11, 0.2)
        * tall
        * np.array([1.0, 1.0, 0.8])
        * rng.uniform(0.7, 1.3, (count, 3))
    )
    return join([wood, _crown(rng, tips, size, rng.uniform(6, 15), 0.18)])


def _conifer(rng: np.random.Generator, tall: float) -> Mesh:
    radius = 0.014 * tall
    base = rng.uniform(0.05, 0.2) * tall
    wide = rng.uniform(0.14, 0.24) * tall
    n = int(60 * wide * tall * rng.uniform(0.7, 1.2))
    up = 1 - np.sqrt(rng.uniform(0, 1, n))
    layer = 1 - 0.3 * np.abs(np.sin(up * rng.uniform(15, 30)))
    reach = wide * (1 - up) * layer * np.sqrt(rng.uniform(0.04, 1, n))
    turn = rng.uniform(0, 2 * np.pi, n)
    center = np.stack(
        [reach * np.cos(turn), reach * np.sin(turn), base + up * (tall - base)], axis=1
    )
    trunk = tubes([[0.0, 0.0, -0.3]], [[0.0, 0.0, 0.95 * tall]], [radius, 0.02], _BARK)
    return join([trunk, scraps(rng, center, 0.13, _LEAF, SOLID)])


def _crown(
    rng: np.random.Generator, centers: Float64, radii: Float64, dense: float, size: float
) -> Mesh:
    """Leaves in ellipsoidal lobes, thicker towards the skin; ``dense`` scraps a square metre."""
    area = 4 * np.pi * np.prod(radii, axis=1) ** (2 / 3)
    counts = np.maximum(12, (dense * area).astype(int))
    lobe = np.repeat(np.arange(len(centers)), counts)
    way = rng.normal(size=(len(lobe), 3))
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    depth = rng.uniform(0.02, 1.0, (len(lobe), 1)) ** 0.45
    return scraps(rng, centers[lobe] + way * depth * radii[lobe], size, _LEAF)


def bush(rng: np.random.Generator) -> Mesh:
    """A bush at the origin, 0.5 to 2.2 m high, of a few overlapping lobes."""
    count = int(rng.integers(2, 6))
    size = rng.uniform(0.35, 1.1)
    center = rng.normal(0, 0.55, (count, 3)) * size
    radii = size * rng.uniform(0.55, 1.0, (count, 3))
    center[:, 2] = radii[:, 2] * rng.uniform(0.6, 1.1, count)
    return _crown(rng, center, radii, rng.uniform(20, 40), 0.13)


def shrubs(rng: np.random.Generator, line: Float64) -> Mesh:
    """A loose border of shrubs along a (n, 3) ground line, up to 3.5 m high."""
    length = float(np.linalg.norm(np.diff(line, axis=0), axis=1).sum())
    size = rng.uniform(0.5, 1.4)
    count = max(2, int(length * rng.uniform(1.0, 2.0) / size))
    t = np.sort(rng.uniform(0, len(line) - 1, count))
    center = np.stack([np.interp(t, np.arange(len(line)), line[:, k]) for k in range(3)], axis=1)
    radii = size * rng.uniform(0.5, 1.3, (count, 3))
    center[:, :2] += rng.normal(0, 0.4 * size, (count, 2))
    center[:, 2] += radii[:, 2] * rng.uniform(0.5, 1.6, count)
    return _crown(rng, center, radii, rng.uniform(12, 28), 0.14)


def hedge(rng: np.random.Generator, line: Float64, height: float, width: float) -> Mesh:
    """A clipped hedge along a (n, 3) ground line: an opaque heart in a shaggy coat."""
    a, b = line[:-1], line[1:]
    length = np.linalg.norm(b - a, axis=1)
    count = np.maximum(8, (length * (2 * height + width) * rng.uniform(28, 45)).astype(int))
    piece = np.repeat(np.arange(len(a)), count)
    n = len(piece)
    t = rng.uniform(0, 1, (n, 1))
    spine = a[piece] + t * (b - a)[piece]
    side = np.stack([-(b - a)[:, 1], (b - a)[:, 0]], axis=1) / length[:, None]
    wave = 1 + 0.12 * np.sin(0.9 * spine[:, 0] + rng.uniform(0, 6)) * np.cos(1.3 * spine[:, 1])
    around = rng.uniform(0, 2 * height + width, n)
    up = np.clip(np.minimum(around, 2 * height + width - around), 0, height)
    across = np.clip(around - height, 0, width) - width / 2
    shape = spine.copy()
    shape[:, :2] += side[piece] * (across * wave)[:, None]
    shape[:, 2] += up * wave
    inward = np.minimum(rng.exponential(0.12, n), 0.45 * width)
    shape[:, :2] -= side[piece] * (np.sign(across) * inward)[:, None]
    shape += rng.normal(0, rng.uniform(0.04, 0.1), (n, 3))
    coat = scraps(rng, shape, 0.1, _LEAF)
    return join([coat, wall_along(line, 0.8 * height, 0.25 * width, 0.3)])


def wall_along(line: Float64, height: float, width: float, reflectance: float) -> Mesh:
    """A wall of constant height over a (n, 3) ground line, sunk 0.3 m into the ground."""
    step = np.gradient(line[:, :2], axis=0)
    normal = np.stack([-step[:, 1], step[:, 0]], axis=1)
    normal *= 0.5 * width / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-9)
    profile = [(-1, -0.3), (-1, height), (1, height), (1, -0.3)]
    sections = np.stack(
        [np.column_stack([line[:, :2] + side * normal, line[:, 2] + z]) for side, z in profile],
        axis=1,
    )
    return loft(sections, reflectance)


def trimmed_box_bush(rng: np.random.Generator) -> Mesh:
    """A box or cone clipped from yew, as stands beside a door."""
    size = rng.uniform([0.4, 0.4, 0.6], [0.9, 0.9, 1.6])
    n = int(110 * size[0] * size[2])
    center = (rng.uniform(-0.5, 0.5, (n, 3)) * size) + [0, 0, size[2] / 2]
    core = boxes([0, 0, size[2] / 2], 0.8 * size, 0.3)
    return join([core, scraps(rng, center, 0.08, _LEAF, SOLID)])
