"""What people put up in parks and fields: statues, fountains, swings, gates, troughs."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from segloc.types import Float64

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
    polygon,
    quads,
    rectangle,
    scraps,
    tubes,
    xyz,
)
from .vegetation import boulder, wall_along

_STEEL, _WOOD, _PAINT, _STONE = 0.3, 0.4, 0.6, 0.45
_SIGN = 0.95
_SQUARE = rectangle([0, 0], (1, 1), 0)


def lamp(rng: np.random.Generator) -> Mesh:
    """A street lamp, 3.5 to 9 m, with its arm along +x."""
    tall = rng.uniform(3.5, 9.0)
    foot = tubes(above(-0.2), above(rng.uniform(0.6, 1.3)), rng.uniform(0.08, 0.13), _STEEL)
    mast = tubes(above(0), above(tall), [0.075, 0.045], _STEEL)
    if tall < 5:
        size = rng.uniform(0.2, 0.32)
        globe = ellipsoid(above(tall + 0.1), [size, size, rng.uniform(0.2, 0.4)], _PAINT)
        return join([foot, mast, globe])
    reach = rng.uniform(0.4, 2.2)
    tip = [reach, 0, tall + rng.uniform(0, 0.6)]
    arm = tubes(above(tall), tip, [0.045, 0.035], _STEEL, sides=5)
    box = rng.uniform([0.5, 0.15, 0.08], [0.9, 0.32, 0.18])
    return join([foot, mast, arm, boxes([tip[0] + 0.2, 0, tip[2]], box, _PAINT)])


def utility_pole(rng: np.random.Generator) -> Mesh:
    """A wooden pole with a cross-arm or two."""
    tall = rng.uniform(6.5, 9.5)
    pole = tubes([[0, 0, -0.3]], [[0, 0, tall]], [rng.uniform(0.12, 0.18), 0.09], _WOOD)
    count = int(rng.integers(1, 4))
    heights = tall - rng.uniform(0.2, 1.6, count)
    parts = [pole, boxes(xyz(0, 0, heights), [0.1, rng.uniform(0.8, 2.2), 0.1], _WOOD)]
    if rng.random() < 0.4:
        parts.append(tubes([[0.3, 0, tall - 2.4]], [[0.3, 0, tall - 1.5]], 0.24, _STEEL))
    return join(parts).leaning(*rng.normal(0, 0.015, 2))


def traffic_sign(rng: np.random.Generator) -> Mesh:
    """A post with one to three plates that face +x."""
    tall = rng.uniform(2.0, 3.3)
    parts = [tubes([[0, 0, -0.2]], [[0, 0, tall]], rng.uniform(0.025, 0.045), _STEEL, sides=6)]
    top = tall
    for _ in range(int(rng.integers(1, 4))):
        sides = int(rng.choice([3, 4, 8, 16]))
        size = rng.uniform(0.28, 0.45)
        angle = (np.arange(sides) + 0.5) * 2 * np.pi / sides - np.pi / 2
        flat = rng.uniform(0.5, 1.0) if sides == 4 else 1.0
        y, z = size * np.cos(angle), size * flat * np.sin(angle)
        parts.append(polygon(xyz(0.05, y, z + top - size), _SIGN))
        top -= 2.1 * size * flat
        if top < 1.4:
            break
    return join(parts).moved([0, 0, 0], float(rng.normal(0, 0.12)))


def name_sign(rng: np.random.Generator) -> Mesh:
    """A wide board on two posts, facing +x."""
    wide, high, top = rng.uniform([1.0, 0.4, 1.2], [2.6, 1.4, 3.2])
    foot = np.array([[0, -0.4 * wide, -0.2], [0, 0.4 * wide, -0.2]])
    posts = tubes(foot, foot + above(top + 0.2), 0.04, _STEEL, sides=6)
    return join([posts, boxes([0.06, 0, top - high / 2], [0.04, wide, high], _SIGN)])


def traffic_light(rng: np.random.Generator) -> Mesh:
    """A mast with signal heads, sometimes one on an arm over the road (+x)."""
    tall = rng.uniform(3.0, 3.6)
    mast = tubes([[0, 0, -0.2]], [[0, 0, tall]], 0.07, _STEEL)
    parts = [mast, boxes([0.16, 0, tall - 0.5], [0.22, 0.3, 0.95], _STEEL)]
    if rng.random() < 0.5:
        high, reach = rng.uniform(5.2, 6.2), rng.uniform(2.0, 4.5)
        bend = [[0, 0, tall], [0, 0, high], [reach, 0, high]]
        parts.append(tubes(bend[:2], bend[1:], 0.06, _STEEL))
        parts.append(boxes([reach, 0, high - 0.2], [0.25, 0.35, 1.0], _STEEL))
    return join(parts)


def cabinet(rng: np.random.Generator) -> Mesh:
    """A utility cabinet, or two side by side."""
    size = rng.uniform([0.3, 0.5, 0.8], [0.55, 1.5, 1.7])
    parts = [boxes([0, 0, size[2] / 2 - 0.1], size + above(0.2), 0.5)]
    parts.append(boxes([0, 0, size[2] + 0.02], size * [1.12, 1.06, 0] + [0, 0, 0.06], 0.5))
    if rng.random() < 0.35:
        small = size * rng.uniform(0.5, 0.9)
        parts.append(boxes([0, (size[1] + small[1]) / 2 + 0.1, small[2] / 2 - 0.1], small, 0.5))
    return join(parts)


def wheelie_bin(rng: np.random.Generator) -> Mesh:
    """A wheeled bin with a sloping lid."""
    wide, deep, high = rng.uniform([0.45, 0.5, 0.9], [0.75, 0.8, 1.15])
    levels = [(0.05, 0.78), (0.85 * high, 1.0), (0.9 * high, 1.12), (high, 0.85)]
    return loft([at_height(_SQUARE * k * [deep, wide], z) for z, k in levels], 0.3)


def skip_container(rng: np.random.Generator) -> Mesh:
    """A large bin for glass, paper or rubble."""
    long, wide, high = rng.uniform([1.2, 1.0, 1.0], [3.4, 1.8, 1.9])
    square = _SQUARE * [wide, long]
    flare = rng.uniform(0.75, 1.0)
    return loft([at_height(square * flare, 0.0), at_height(square, high)], 0.35)


def litter_bin(rng: np.random.Generator) -> Mesh:
    """A round bin on a short post."""
    r, low, high = rng.uniform([0.18, 0.1, 0.7], [0.28, 0.4, 1.1])
    z = above(-0.1), above(low), above(high)
    return tubes(z[:2], z[1:], [[0.04, 0.04], [r, r]], 0.3)


def bollards(rng: np.random.Generator) -> Mesh:
    """A row of two to five bollards along y."""
    count = int(rng.integers(2, 6))
    foot = xyz(0, (np.arange(count) - count / 2) * rng.uniform(1.2, 2.0), -0.2)
    radius = rng.uniform(0.05, 0.14)
    return tubes(foot, foot + above(rng.uniform(0.8, 1.3)), [radius, radius], 0.4)


def bench(rng: np.random.Generator) -> Mesh:
    """A bench that faces +x."""
    long, high = rng.uniform([1.4, 0.42], [2.2, 0.5])
    slats = [[0, 0, high], [-0.26, 0, high + 0.25], [-0.29, 0, high + 0.42]]
    sizes = [[0.42, long, 0.06], [0.05, long, 0.12], [0.05, long, 0.12]]
    legs = [[0, side * 0.4 * long, high / 2] for side in (-1, 1)]
    return join([boxes(slats, sizes, _WOOD), boxes(legs, [0.4, 0.08, high], _STEEL)])


def bus_shelter(rng: np.random.Generator) -> Mesh:
    """A shelter open towards +x: posts, roof, glass back that mostly loses the beam."""
    long, deep, high = rng.uniform([2.6, 1.2, 2.2], [4.8, 1.7, 2.6])
    foot = np.array([[x, y, -0.1] for x in (-deep / 2, deep / 3) for y in (-long / 2, 0, long / 2)])
    posts = tubes(foot, foot + above(high), 0.05, _STEEL, sides=6)
    roof = boxes([0, 0, high + 0.05], [deep + 0.5, long + 0.3, 0.14], _STEEL)
    back = glass(boxes([-deep / 2, 0, high / 2 + 0.1], [0.03, long, high - 0.5], 0.0))
    end = boxes([0, long / 2, high / 2], [deep * 0.8, 0.1, high - 0.4], 0.5)
    seat = boxes([-deep / 3, 0, 0.5], [0.3, 0.7 * long, 0.06], _WOOD)
    return join([posts, roof, back, end, seat])


def person(rng: np.random.Generator) -> Mesh:
    """Somebody who stands or walks towards +x."""
    tall = rng.normal(1.7, 0.1)
    stride, swing = rng.uniform(0.02, 0.32), rng.uniform(0.05, 0.3)
    hip, shoulder = 0.5 * tall, 0.82 * tall
    hand = 0.47 * tall
    starts = [[stride, 0.1, 0], [-stride, -0.1, 0], [0, 0.22, shoulder], [0, -0.22, shoulder]]
    ends = [[0, 0.09, hip], [0, -0.09, hip], [-swing, 0.27, hand], [swing, -0.27, hand]]
    limbs = tubes(starts, ends, [[0.06, 0.09]] * 2 + [[0.06, 0.04]] * 2, 0.4, sides=6)
    torso = ellipsoid([0, 0, 0.66 * tall], [0.13, 0.22, 0.2 * tall], 0.4)
    head = ellipsoid([0.02, 0, 0.93 * tall], [0.1, 0.08, 0.125], 0.5, rings=4)
    return join([limbs, torso, head])


def garden_wall(rng: np.random.Generator, line: Float64) -> Mesh:
    """A wall over a (n, 3) ground line, with piers and sometimes a railing on top."""
    high, thick = rng.uniform([0.5, 0.15], [1.9, 0.32])
    piers = line[:: max(2, int(rng.integers(3, 7)))]
    size = [thick + 0.16, thick + 0.16, high + rng.uniform(0.1, 0.35) + 0.3]
    parts = [wall_along(line, high, thick, _STONE)]
    parts.append(boxes(piers + above(size[2] / 2 - 0.3), size, _STONE))
    if high < 0.9 and rng.random() < 0.5:
        parts.append(_railing(rng, line + above(high), rng.uniform(0.4, 0.9)))
    return join(parts)


def fence(rng: np.random.Generator, line: Float64) -> Mesh:
    """A fence over a (n, 3) ground line: boards with gaps, or posts with rails."""
    high = rng.uniform(0.8, 1.9)
    if rng.random() < 0.4:
        return _railing(rng, line, high)
    posts = tubes(line - above(0.2), line + above(high), 0.05, _WOOD, sides=5)
    pitch = rng.uniform(0.1, 0.18)
    board = rng.uniform(0.6, 1.0) * pitch
    parts = [posts]
    for a, b in pairwise(line):
        t = (np.arange(max(1, int(np.linalg.norm(b - a) / pitch))) * pitch) / np.linalg.norm(b - a)
        low = a + t[:, None] * (b - a) + above(0.08)
        wide = (b - a) / np.linalg.norm(b - a) * board
        up = xyz(0, 0, high - 0.1 + rng.normal(0, 0.01, len(low)))
        corners = np.stack([low, low + wide, low + wide + up, low + up], axis=1)
        parts.append(quads(corners, _WOOD))
    return join(parts)


def _railing(rng: np.random.Generator, line: Float64, high: float) -> Mesh:
    posts = tubes(line - above(0.2), line + above(high), 0.035, _STEEL, sides=5)
    a, b = line[:-1], line[1:]
    low, top = above(0.2 * high), above(0.95 * high)
    rails = [tubes(a + z, b + z, 0.025, _STEEL, sides=4) for z in (low, top)]
    t = np.linspace(0, 1, 12, endpoint=False)[None, :, None]
    feet = (a[:, None] + t * (b - a)[:, None]).reshape(-1, 3)
    bars = tubes(feet + low, feet + top, rng.uniform(0.01, 0.02), _STEEL, sides=3)
    return join([posts, *rails, bars])


FURNITURE: tuple[tuple[str, Callable[[np.random.Generator], Mesh], float, float], ...] = (
    ("traffic sign", traffic_sign, 0.34, 0.3),
    ("cabinet", cabinet, 0.14, 0.6),
    ("litter bin", litter_bin, 0.14, 0.4),
    ("bollards", bollards, 0.08, 0.4),
    ("bench", bench, 0.1, 0.8),
    ("name sign", name_sign, 0.08, 0.5),
    ("bus shelter", bus_shelter, 0.05, 1.6),
    ("container", skip_container, 0.07, 1.4),
)
"""Kind, maker, share, and distance from the kerb of what stands on pavements."""


_LEAF = 0.5


def statue(rng: np.random.Generator) -> Mesh:
    """A figure, an urn, an obelisk or a rough stone on a stepped plinth."""
    wide, tall = rng.uniform([0.7, 0.8], [1.8, 2.8])
    steps = int(rng.integers(1, 4))
    k = np.arange(steps)
    size = xyz(wide + 0.7 * (steps - k), wide + 0.7 * (steps - k), 0.2)
    center = xyz(0, 0, 0.1 + 0.2 * k)
    foot = 0.2 * steps
    block = boxes([0, 0, foot + tall / 2], [wide, wide, tall], _STONE)
    cap = boxes([0, 0, foot + tall], [1.2 * wide, 1.2 * wide, 0.15], _STONE)
    top, pick = above(foot + tall + 0.05), rng.random()
    if pick < 0.4:
        ornament = person(rng).scaled(rng.uniform(1.1, 1.7))
    elif pick < 0.6:
        r = wide * np.array([0.25, 0.15, 0.2, 0.45, 0.5, 0.3]) * rng.uniform(0.8, 1.2, 6)
        ornament = _turned(r, np.array([0.0, 0.15, 0.3, 0.6, 0.9, 1.1]) * rng.uniform(0.7, 1.4))
    elif pick < 0.8:
        high = rng.uniform(1.5, 4.5)
        r = wide * np.array([0.55, 0.38, 0.02])
        ornament = _turned(r, np.array([0.0, 0.9 * high, high]), sides=4)
    else:
        ornament = boulder(rng).scaled(rng.uniform(1.0, 1.8))
    return join([boxes(center, size, _STONE), block, cap, ornament.moved(top)])


def fountain(rng: np.random.Generator) -> Mesh:
    """A basin with a rim and bowls on a stem."""
    radius, rim = rng.uniform([1.4, 0.35], [3.2, 0.8])
    sides = int(rng.choice([6, 8, 12, 16]))
    rings = np.array([1.0, 1.05, 1.05, 0.9, 0.88]) * radius
    parts, z = [_turned(rings, [-0.2, 0.0, rim, rim, 0.1], sides)], 0.0
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
    side, rim = wide / 2 * np.array([-1, -1, 1, 1]), np.array([0.2, 0.0, 0.0, 0.2])
    bed = xyz(x[:, None], side, z[:, None] + rim)
    feet = np.array([[x, y, -0.1] for x in (-0.9, 0) for y in (-wide / 2, wide / 2)])
    posts = tubes(feet, feet + above(tall + 1.0), 0.045, _STEEL, sides=6)
    deck = boxes([-0.45, 0, tall + 0.1], [0.9, wide, 0.08], _WOOD)
    k = np.arange(int(tall / 0.3))
    rungs = boxes(xyz(-0.95, 0, 0.3 + 0.3 * k), [0.1, wide, 0.05], _STEEL)
    parts = [loft(bed, 0.5, closed=False), posts, deck, rungs]
    if rng.random() < 0.5:
        parts.append(_turned([0.9, 0.05], [tall + 1.1, tall + 1.9], 4))
    return join(parts)


def climbing_frame(rng: np.random.Generator) -> Mesh:
    """A lattice of bars, boxy or a dome."""
    count = rng.integers([2, 2, 2], [4, 4, 4])
    pitch = rng.uniform(0.6, 0.9)
    grid = np.stack(np.meshgrid(*(np.arange(n + 1) for n in count), indexing="ij"), -1) * pitch
    grid[..., :2] -= count[:2] * pitch / 2
    if rng.random() < 0.5:
        grid[..., :2] *= 1 - 0.45 * (grid[..., 2:] / grid[..., 2].max()) ** 2
    ends = ((grid[:-1], grid[1:]), (grid[:, :-1], grid[:, 1:]), (grid[:, :, :-1], grid[:, :, 1:]))
    return join(tubes(a.reshape(-1, 3), b.reshape(-1, 3), 0.025, _STEEL, sides=4) for a, b in ends)


def bandstand(rng: np.random.Generator) -> Mesh:
    """A roof on posts over a raised floor."""
    radius, tall = rng.uniform([2.2, 2.4], [4.0, 3.4])
    sides = int(rng.choice([6, 8]))
    floor = rng.uniform(0.2, 0.7)
    angle = (np.arange(sides) + 0.5) * 2 * np.pi / sides
    feet = polar(radius, angle, floor)
    posts = tubes(feet, feet + above(tall), 0.08, _WOOD, sides=6)
    base = _turned(np.array([1.1, 1.1, 0.01]) * radius, [-0.2, floor, floor], sides)
    heights = floor + tall + np.array([-0.1, rng.uniform(0.6, 1.2), rng.uniform(1.3, 2.2)])
    roof = _turned(np.array([1.25, 0.5, 0.05]) * radius, heights, sides)
    near = np.roll(feet, -1, axis=0)
    rails = tubes(feet[1:] + above(0.9), near[1:] + above(0.9), 0.04, _WOOD, sides=4)
    return join([base, posts, roof, rails])


def picnic_table(rng: np.random.Generator) -> Mesh:
    """A table with a bench on either side."""
    long = rng.uniform(1.5, 2.4)
    middle = [[0, 0, 0.75], [-0.7, 0, 0.45], [0.7, 0, 0.45]]
    size = [[0.75, long, 0.06], [0.28, long, 0.05], [0.28, long, 0.05]]
    x, y = np.array([-1.0, 1.0, -1.0, 1.0]), np.repeat([-0.35 * long, 0.35 * long], 2)
    legs = tubes(xyz(0.75 * x, y, 0), xyz(0.25 * x, y, 0.75), 0.05, _WOOD, sides=4)
    return join([boxes(middle, size, _WOOD), legs])


def flower_bed(rng: np.random.Generator, length: float, width: float) -> Mesh:
    """A raised bed of plants in rows or drifts, some of them high."""
    edge = rng.uniform(0.08, 0.35)
    rim = boxes([0, 0, edge / 2 - 0.1], [length, width, edge + 0.2], _STONE)
    n = int(length * width * rng.uniform(45, 90))
    xy = rng.uniform(-0.46, 0.46, (n, 2)) * [length, width]
    drift = np.sin(rng.uniform(1, 4) * xy[:, 0] + rng.uniform(0, 6))
    drift *= np.cos(rng.uniform(1, 4) * xy[:, 1])
    tall = rng.uniform(0.25, 0.9) * (1 + 0.6 * drift)
    center = np.column_stack([xy, edge + tall * rng.uniform(0.1, 1.0, n)])
    return join([rim, scraps(rng, center, rng.uniform(0.06, 0.11), _LEAF)])


def gate(rng: np.random.Generator) -> Mesh:
    """A field gate along y between two posts, ajar or shut."""
    wide, high = rng.uniform([1.2, 1.0], [3.6, 1.35])
    posts = tubes([[0, 0, -0.2], [0, wide, -0.2]], [[0, 0, 1.5], [0, wide, 1.5]], 0.1, _WOOD)
    turn = rng.choice([0.0, rng.uniform(0.2, 1.4)])
    end = wide * np.array([np.sin(turn), np.cos(turn), 0.0])
    foot = xyz(0, 0, np.linspace(0.25, high, int(rng.integers(4, 7))))
    bars = tubes(foot, foot + end, 0.03, _WOOD, sides=4)
    brace = tubes([[0, 0, 0.25]], [end + above(high)], 0.03, _WOOD, sides=4)
    return join([posts, bars, brace]).moved([0, -wide / 2, 0])


def post_row(rng: np.random.Generator, line: Float64) -> Mesh:
    """Fence posts over a (n, 3) ground line, leaning each its own way, with wires or rails."""
    high = rng.uniform(0.9, 1.5)
    top = line + above(high) + at_height(rng.normal(0, 0.07, (len(line), 2)), 0)
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
    wide, long, high = size
    middle = [[s * wide / 2, 0, high / 2] for s in (-1, 1)]
    middle += [[0, s * long / 2, high / 2] for s in (-1, 1)]
    walls = boxes(middle, [[0.06, long, high]] * 2 + [[wide, 0.06, high]] * 2, _STEEL)
    return join([walls, boxes([0, 0, 0.5 * high], [wide, long, 0.05], 0.2)])


def bale(rng: np.random.Generator) -> Mesh:
    """A round bale of hay on its side, or a stack of them."""
    radius, wide = rng.uniform([0.55, 1.0], [0.8, 1.5])
    spots = [[0.0, radius]]
    if rng.random() < 0.3:
        spots += [[2 * radius, radius], [radius, 2.7 * radius]]
    starts = np.array([[x, -wide / 2, z] for x, z in spots])
    return tubes(starts, starts + [0, wide, 0], radius, 0.45, sides=14)


def _turned(radii: ArrayLike, heights: ArrayLike, sides: int = 10) -> Mesh:
    """A body of revolution about z."""
    angle = (np.arange(sides) + 0.5) * 2 * np.pi / sides
    return loft(polar(np.asarray(radii)[:, None], angle, np.asarray(heights)[:, None]), _STONE)
