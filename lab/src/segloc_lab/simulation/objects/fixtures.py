"""What people put up in parks and fields: statues, fountains, swings, gates, troughs."""

from __future__ import annotations

import numpy as np

from segloc.types import Float64

from .mesh import Mesh, above, boxes, ellipsoid, join, loft, scraps, tubes
from .street import person
from .undergrowth import boulder

_STONE, _STEEL, _WOOD, _LEAF = 0.45, 0.3, 0.4, 0.5


def statue(rng: np.random.Generator) -> Mesh:
    """A figure, an urn, an obelisk or a rough stone on a stepped plinth."""
    wide, tall = rng.uniform([0.7, 0.8], [1.8, 2.8])
    steps = int(rng.integers(1, 4))
    k = np.arange(steps)[:, None]
    size = np.hstack([wide + 0.7 * (steps - k), wide + 0.7 * (steps - k), np.full((steps, 1), 0.2)])
    center = np.hstack([np.zeros((steps, 2)), 0.1 + 0.2 * k])
    foot = 0.2 * steps
    block = boxes([0, 0, foot + tall / 2], [wide, wide, tall], _STONE)
    cap = boxes([0, 0, foot + tall], [1.2 * wide, 1.2 * wide, 0.15], _STONE)
    top, pick = above(foot + tall + 0.05), rng.random()
    if pick < 0.4:
        ornament = _scaled(person(rng), rng.uniform(1.1, 1.7))
    elif pick < 0.6:
        r = wide * np.array([0.25, 0.15, 0.2, 0.45, 0.5, 0.3]) * rng.uniform(0.8, 1.2, 6)
        ornament = _turned(r, np.array([0.0, 0.15, 0.3, 0.6, 0.9, 1.1]) * rng.uniform(0.7, 1.4))
    elif pick < 0.8:
        high = rng.uniform(1.5, 4.5)
        r = wide * np.array([0.55, 0.38, 0.02])
        ornament = _turned(r, np.array([0.0, 0.9 * high, high]), sides=4)
    else:
        ornament = _scaled(boulder(rng), rng.uniform(1.0, 1.8))
    return join([boxes(center, size, _STONE), block, cap, ornament.moved(top)])


def fountain(rng: np.random.Generator) -> Mesh:
    """A basin with a rim and bowls on a stem."""
    radius, rim = rng.uniform([1.4, 0.35], [3.2, 0.8])
    sides = int(rng.choice([6, 8, 12, 16]))
    basin = _turned(
        np.array([1.0, 1.05, 1.05, 0.9, 0.88]) * radius,
        np.array([-0.2, 0.0, rim, rim, 0.1]),
        sides,
    )
    parts, z = [basin], 0.0
    for bowl in radius * np.cumprod(rng.uniform(0.4, 0.65, int(rng.integers(1, 4)))):
        stem = rng.uniform(0.5, 1.0)
        r = bowl * np.array([0.3, 0.2, 0.25, 1.0, 0.95])
        heights = z + stem * np.array([0.0, 0.4, 0.8, 1.0, 0.95])
        parts.append(_turned(r, heights, 12))
        z += stem
    parts.append(ellipsoid([0, 0, z + 0.2], [0.15, 0.15, 0.3], _STONE, rings=4))
    return join(parts)


def swings(rng: np.random.Generator) -> Mesh:
    """A swing frame along y with seats."""
    long, tall = rng.uniform([2.6, 1.9], [6.0, 2.7])
    ends = np.array([-long / 2, long / 2])
    feet = np.array([[s * 0.45 * tall, y, -0.1] for y in ends for s in (-1, 1)])
    tops = np.array([[0.0, y, tall] for y in ends for _ in (-1, 1)])
    legs = tubes(feet, tops, 0.05, _STEEL, sides=6)
    beam = tubes([[0, ends[0], tall]], [[0, ends[1], tall]], 0.055, _STEEL, sides=6)
    parts = [legs, beam]
    for y in np.arange(ends[0] + 0.8, ends[1] - 0.5, 1.1):
        ropes = np.array([[0.0, y + d, tall] for d in (-0.22, 0.22)])
        low = ropes + [rng.normal(0, 0.08), 0, 0.45 - tall]
        parts += [tubes(ropes, low, 0.012, _STEEL, sides=3)]
        parts += [boxes(low.mean(axis=0), [0.2, 0.5, 0.05], _WOOD)]
    return join(parts)


def slide(rng: np.random.Generator) -> Mesh:
    """A slide towards +x with its ladder and platform."""
    tall, wide = rng.uniform([1.2, 0.45], [2.4, 0.8])
    long = tall * rng.uniform(1.3, 1.9)
    s = np.linspace(0, 1, 6)
    x, z = long * s, tall * (1 - s) ** 1.2 + 0.15
    bed = np.stack(
        [np.column_stack([x, np.full(6, y), z + dz]) for y, dz in
         ((-wide / 2, 0.2), (-wide / 2, 0.0), (wide / 2, 0.0), (wide / 2, 0.2))],
        axis=1,
    )  # fmt: skip
    corners = np.array([[-0.9, -wide / 2], [-0.9, wide / 2], [0, -wide / 2], [0, wide / 2]])
    feet = np.column_stack([corners, np.full(4, -0.1)])
    posts = tubes(feet, feet + above(tall + 1.0), 0.045, _STEEL, sides=6)
    deck = boxes([-0.45, 0, tall + 0.1], [0.9, wide, 0.08], _WOOD)
    k = np.arange(int(tall / 0.3))
    rungs = boxes(np.column_stack([-0.95 - 0 * k, 0 * k, 0.3 + 0.3 * k]), [0.1, wide, 0.05], _STEEL)
    parts = [loft(bed, 0.5, closed=False), posts, deck, rungs]
    if rng.random() < 0.5:
        roof = np.array([[-0.45, 0, tall + 1.9]])
        parts.append(_turned(np.array([0.9, 0.05]), np.array([tall + 1.1, roof[0, 2]]), 4))
    return join(parts)


def climbing_frame(rng: np.random.Generator) -> Mesh:
    """A lattice of bars, boxy or a dome."""
    count = rng.integers([2, 2, 2], [4, 4, 4])
    pitch = rng.uniform(0.6, 0.9)
    grid = np.stack(np.meshgrid(*(np.arange(n + 1) for n in count), indexing="ij"), -1) * pitch
    grid[..., :2] -= count[:2] * pitch / 2
    if rng.random() < 0.5:
        grid[..., :2] *= 1 - 0.45 * (grid[..., 2:] / grid[..., 2].max()) ** 2
    bars = [
        tubes(a.reshape(-1, 3), b.reshape(-1, 3), 0.025, _STEEL, sides=4)
        for a, b in (
            (grid[:-1], grid[1:]),
            (grid[:, :-1], grid[:, 1:]),
            (grid[:, :, :-1], grid[:, :, 1:]),
        )
    ]
    return join(bars)


def bandstand(rng: np.random.Generator) -> Mesh:
    """A roof on posts over a raised floor."""
    radius, tall = rng.uniform([2.2, 2.4], [4.0, 3.4])
    sides = int(rng.choice([6, 8]))
    floor = rng.uniform(0.2, 0.7)
    angle = (np.arange(sides) + 0.5) * 2 * np.pi / sides
    feet = np.column_stack([radius * np.cos(angle), radius * np.sin(angle), np.full(sides, floor)])
    posts = tubes(feet, feet + above(tall), 0.08, _WOOD, sides=6)
    base = _turned(np.array([1.1, 1.1, 0.01]) * radius, np.array([-0.2, floor, floor]), sides)
    eaves = floor + tall
    roof = _turned(
        np.array([1.25, 0.5, 0.05]) * radius,
        eaves + np.array([-0.1, rng.uniform(0.6, 1.2), rng.uniform(1.3, 2.2)]),
        sides,
    )
    near = np.roll(feet, -1, axis=0)
    rails = tubes(feet[1:] + above(0.9), near[1:] + above(0.9), 0.04, _WOOD, sides=4)
    return join([base, posts, roof, rails])


def picnic_table(rng: np.random.Generator) -> Mesh:
    """A table with a bench on either side."""
    long = rng.uniform(1.5, 2.4)
    tops = boxes(
        [[0, 0, 0.75], [-0.7, 0, 0.45], [0.7, 0, 0.45]],
        [[0.75, long, 0.06], [0.28, long, 0.05], [0.28, long, 0.05]],
        _WOOD,
    )
    y = np.repeat([-0.35 * long, 0.35 * long], 2)
    x = np.array([-1.0, 1.0, -1.0, 1.0])
    legs = tubes(
        np.column_stack([0.75 * x, y, np.zeros(4)]),
        np.column_stack([0.25 * x, y, np.full(4, 0.75)]),
        0.05,
        _WOOD,
        sides=4,
    )
    return join([tops, legs])


def flower_bed(rng: np.random.Generator, length: float, width: float) -> Mesh:
    """A raised bed of plants in rows or drifts, some of them high."""
    edge = rng.uniform(0.08, 0.35)
    rim = boxes([0, 0, edge / 2 - 0.1], [length, width, edge + 0.2], _STONE)
    n = int(length * width * rng.uniform(45, 90))
    xy = rng.uniform(-0.46, 0.46, (n, 2)) * [length, width]
    drift = np.sin(rng.uniform(1, 4) * xy[:, 0] + rng.uniform(0, 6)) * np.cos(
        rng.uniform(1, 4) * xy[:, 1]
    )
    tall = rng.uniform(0.25, 0.9) * (1 + 0.6 * drift)
    center = np.column_stack([xy, edge + tall * rng.uniform(0.1, 1.0, n)])
    return join([rim, scraps(rng, center, rng.uniform(0.06, 0.11), _LEAF)])


def gate(rng: np.random.Generator) -> Mesh:
    """A field gate along y between two posts, ajar or shut."""
    wide, high = rng.uniform([1.2, 1.0], [3.6, 1.35])
    posts = tubes([[0, 0, -0.2], [0, wide, -0.2]], [[0, 0, 1.5], [0, wide, 1.5]], 0.1, _WOOD)
    turn = rng.choice([0.0, rng.uniform(0.2, 1.4)])
    end = wide * np.array([np.sin(turn), np.cos(turn), 0.0])
    z = np.linspace(0.25, high, int(rng.integers(4, 7)))
    foot = np.zeros((len(z), 3))
    foot[:, 2] = z
    bars = tubes(foot, foot + end, 0.03, _WOOD, sides=4)
    brace = tubes([[0, 0, 0.25]], [end + above(high)], 0.03, _WOOD, sides=4)
    return join([posts, bars, brace]).moved([0, -wide / 2, 0])


def post_row(rng: np.random.Generator, line: Float64) -> Mesh:
    """Fence posts over a (n, 3) ground line, leaning each its own way, with wires or rails."""
    high = rng.uniform(0.9, 1.5)
    top = (
        line + above(high) + np.column_stack([rng.normal(0, 0.07, (len(line), 2)), 0 * line[:, 0]])
    )
    radius = rng.uniform(0.04, 0.09)
    posts = tubes(line - above(0.2), top, [radius, 0.9 * radius], _WOOD, sides=6)
    parts, thick = [posts], 0.04 if rng.random() < 0.4 else 0.006
    for z in np.linspace(0.35, 0.95, int(rng.integers(2, 4))):
        at = line + (top - line) * z
        parts.append(tubes(at[:-1], at[1:], thick, _WOOD if thick > 0.01 else _STEEL, sides=3))
    return join(parts)


def trough(rng: np.random.Generator) -> Mesh:
    """A water trough for cattle."""
    size = rng.uniform([0.5, 1.2, 0.45], [1.0, 3.0, 0.8])
    walls = boxes(
        [[s * size[0] / 2, 0, size[2] / 2] for s in (-1, 1)]
        + [[0, s * size[1] / 2, size[2] / 2] for s in (-1, 1)],
        [[0.06, size[1], size[2]]] * 2 + [[size[0], 0.06, size[2]]] * 2,
        _STEEL,
    )
    return join([walls, boxes([0, 0, 0.5 * size[2]], [size[0], size[1], 0.05], 0.2)])


def bale(rng: np.random.Generator) -> Mesh:
    """A round bale of hay on its side, or a stack of them."""
    radius, wide = rng.uniform([0.55, 1.0], [0.8, 1.5])
    spots = [[0.0, radius]]
    if rng.random() < 0.3:
        spots += [[2 * radius, radius], [radius, 2.7 * radius]]
    starts = np.array([[x, -wide / 2, z] for x, z in spots])
    return tubes(starts, starts + [0, wide, 0], radius, 0.45, sides=14)


def _turned(radii: Float64, heights: Float64, sides: int = 10) -> Mesh:
    """A body of revolution about z."""
    angle = (np.arange(sides) + 0.5) * 2 * np.pi / sides
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    sections = [
        np.column_stack([r * ring, np.full(sides, z)]) for r, z in zip(radii, heights, strict=True)
    ]
    return loft(sections, _STONE)


def _scaled(mesh: Mesh, factor: float) -> Mesh:
    return Mesh(mesh.triangles * factor, mesh.reflectance, mesh.material)
