"""Trees, hedges and undergrowth of many species."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from segloc.types import Float64

from .mesh import (
    LEAF,
    SOLID,
    Mesh,
    above,
    at_height,
    boxes,
    grid_quads,
    join,
    loft,
    polar,
    polygon,
    quads,
    scraps,
    tubes,
    xyz,
)

Range = tuple[float, float]


@dataclass(frozen=True)
class Species:
    """What trees of a kind have in common; pairs are the ranges that each tree is drawn from."""

    height: Range  # metres
    girth: Range  # radius of the trunk over its height
    bare: Range  # where the crown begins, as a share of the height
    spread: Range  # radius of the crown over the height
    crown: tuple[float, ...]  # reach of the branches at even steps from its foot to its top
    branches: tuple[int, int]  # their number
    rise: Range = (0.3, 1.0)  # elevation of the lowest and of the highest branches, radians
    droop: float = 0.1  # how far tips sink, as a share of the branch's length
    hang: float = 0.0  # how much twigs hang down: 0 for not at all, 1 for a willow
    leaves: Range = (5.0, 9.0)  # scraps of foliage a metre of twig
    leaf: float = 0.17  # size of a scrap, metres
    stems: tuple[int, int] = (1, 1)  # from one root
    lean: float = 0.03  # standard deviation, rise over run
    forked: float = 0.0  # probability that the trunk divides
    bark: float = 0.35  # reflectance


_DOME = (0.75, 1.0, 1.0, 0.85, 0.5)
_CONE = (1.0, 0.85, 0.6, 0.35, 0.05)
_COLUMN = (0.6, 1.0, 0.9, 0.6, 0.2)
_VASE = (0.4, 0.7, 0.95, 1.0, 0.7)

SPECIES: dict[str, Species] = {
    "oak": Species(
        (9.0, 19.0), (0.022, 0.036), (0.18, 0.36), (0.28, 0.44), _DOME, (11, 22),
        rise=(0.15, 1.1), droop=0.05, forked=0.6, lean=0.04, bark=0.3,
    ),
    "beech": Species(
        (16.0, 27.0), (0.011, 0.019), (0.38, 0.6), (0.16, 0.27), _DOME, (12, 22),
        rise=(0.5, 1.2), forked=0.25, leaves=(5.0, 8.0), bark=0.5,
    ),
    "ash": Species(
        (10.0, 22.0), (0.012, 0.02), (0.25, 0.5), (0.18, 0.3), _VASE, (9, 17),
        rise=(0.6, 1.2), forked=0.45, leaves=(3.0, 6.0), bark=0.4,
    ),
    "lime": Species(
        (10.0, 21.0), (0.015, 0.026), (0.14, 0.28), (0.2, 0.32), _COLUMN, (16, 28),
        rise=(0.2, 1.2), forked=0.3, leaves=(6.0, 10.0), bark=0.3,
    ),
    "birch": Species(
        (8.0, 17.0), (0.006, 0.011), (0.25, 0.5), (0.13, 0.22), _COLUMN, (12, 22),
        rise=(0.6, 1.2), droop=0.3, hang=0.4, leaves=(3.0, 6.0), leaf=0.12,
        stems=(1, 2), lean=0.06, forked=0.15, bark=0.65,
    ),
    "willow": Species(
        (6.0, 14.0), (0.02, 0.035), (0.2, 0.35), (0.35, 0.5), _DOME, (14, 24),
        rise=(0.5, 1.1), droop=0.35, hang=1.0, leaves=(3.5, 6.0), leaf=0.14,
        lean=0.08, forked=0.7, bark=0.3,
    ),
    "spruce": Species(
        (11.0, 24.0), (0.009, 0.014), (0.08, 0.35), (0.12, 0.2), _CONE, (36, 60),
        rise=(-0.25, 0.5), droop=0.15, leaves=(6.0, 9.0), leaf=0.13, lean=0.015,
    ),
    "pine": Species(
        (12.0, 22.0), (0.009, 0.016), (0.5, 0.72), (0.13, 0.22), _DOME, (14, 26),
        rise=(0.0, 0.7), leaves=(5.0, 9.0), leaf=0.14, lean=0.04, forked=0.1,
    ),
    "yew": Species(
        (3.0, 8.0), (0.03, 0.05), (0.04, 0.15), (0.3, 0.5), _DOME, (16, 30),
        rise=(0.2, 1.1), leaves=(9.0, 15.0), leaf=0.12, forked=0.5, bark=0.3,
    ),
    "hawthorn": Species(
        (2.5, 6.0), (0.018, 0.03), (0.1, 0.3), (0.3, 0.5), _DOME, (12, 22),
        rise=(0.2, 1.0), leaves=(7.0, 14.0), leaf=0.1, stems=(1, 4), lean=0.12, forked=0.4,
    ),
    "hazel": Species(
        (2.5, 6.0), (0.007, 0.011), (0.15, 0.3), (0.18, 0.3), _VASE, (14, 26),
        rise=(0.7, 1.2), leaves=(5.0, 9.0), leaf=0.13, stems=(4, 9), lean=0.22,
    ),
    "sapling": Species(
        (1.2, 4.0), (0.005, 0.009), (0.15, 0.4), (0.16, 0.3), _COLUMN, (5, 12),
        rise=(0.4, 1.0), leaves=(5.0, 10.0), leaf=0.11, lean=0.08, bark=0.4,
    ),
    "snag": Species(
        (3.0, 13.0), (0.016, 0.035), (0.25, 0.5), (0.08, 0.22), _VASE, (2, 9),
        rise=(0.0, 0.9), leaves=(0.0, 0.0), lean=0.09, forked=0.3, bark=0.45,
    ),
}  # fmt: skip
"""Broadleaves, conifers, shrubs of tree shape, and dead wood."""

EVERGREEN = frozenset({"spruce", "pine", "yew"})
"""Species that keep their leaves in winter."""


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
    tips = fork + polar(reach, angle, rise)
    starts = above(-0.3) + (fork - above(-0.3)) * rng.uniform(0.8, 1.0, (count, 1))
    stem = tubes(above(-0.3), fork, [radius, 0.75 * radius], _BARK)
    boughs = tubes(starts, tips, [0.45 * radius, 0.12 * radius], _BARK, sides=5)
    wide = rng.uniform(0.11, 0.2) * tall
    size = wide * np.array([1.0, 1.0, 0.8]) * rng.uniform(0.7, 1.3, (count, 3))
    return join([stem, boughs, _crown(rng, tips, size, rng.uniform(6, 15), 0.18)])


def _conifer(rng: np.random.Generator, tall: float) -> Mesh:
    radius = 0.014 * tall
    base = rng.uniform(0.05, 0.2) * tall
    wide = rng.uniform(0.14, 0.24) * tall
    n = int(60 * wide * tall * rng.uniform(0.7, 1.2))
    up = 1 - np.sqrt(rng.uniform(0, 1, n))
    layer = 1 - 0.3 * np.abs(np.sin(up * rng.uniform(15, 30)))
    reach = wide * (1 - up) * layer * np.sqrt(rng.uniform(0.04, 1, n))
    turn = rng.uniform(0, 2 * np.pi, n)
    center = polar(reach, turn, base + up * (tall - base))
    trunk = tubes(above(-0.3), above(0.95 * tall), [radius, 0.02], _BARK)
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
    rows = [np.column_stack([line[:, :2] + side * normal, line[:, 2] + z]) for side, z in profile]
    return loft(np.stack(rows, axis=1), reflectance)


def trimmed_box_bush(rng: np.random.Generator) -> Mesh:
    """A box or cone clipped from yew, as stands beside a door."""
    size = rng.uniform([0.4, 0.4, 0.6], [0.9, 0.9, 1.6])
    n = int(110 * size[0] * size[2])
    center = (rng.uniform(-0.5, 0.5, (n, 3)) * size) + [0, 0, size[2] / 2]
    core = boxes([0, 0, size[2] / 2], 0.8 * size, 0.3)
    return join([core, scraps(rng, center, 0.08, _LEAF, SOLID)])


_GOLDEN = 2.4  # radians from one branch to the next, about the golden angle
_TWIGS_FROM = 0.45  # detail below which twigs carry leaves but are not drawn, nor are bends


def grow(rng: np.random.Generator, kind: str, *, detail: float = 1.0, scale: float = 1.0) -> Mesh:
    """A tree with its foot at the origin.

    Parameters
    ----------
    kind : str
        Of :data:`SPECIES`.
    detail : float
        Share of the leaves that is drawn, each enlarged to cover the same area; for
        trees that no ray meets from near by.
    scale : float
        Times the height of the species.
    """
    species = SPECIES[kind]
    tall = scale * float(rng.uniform(*species.height))
    radius = tall * float(rng.uniform(*species.girth))
    axes, radii = _axes(rng, species, tall, radius)
    rough = rng.normal(1, 0.06, (*radii.shape, 9))
    branches, thick = _branches(rng, species, axes, radii, tall)
    twigs = _twigs(rng, species, branches)
    if detail > _TWIGS_FROM:
        parts = [limbs(axes, radii, species.bark, 9, rough)]
        parts.append(limbs(branches, thick, species.bark, 4))
        parts.append(limbs(twigs, np.array([0.014, 0.006]), species.bark, 3))
    else:
        parts = [limbs(axes[:, ::2], radii[:, ::2], species.bark, 5)]
        parts.append(limbs(branches[:, ::3], thick[:, ::3], species.bark, 3))
    material = SOLID if kind in EVERGREEN else LEAF
    parts.append(_leaves(rng, species, twigs, detail, material))
    return join(parts)


def limbs(
    lines: Float64, radii: Float64, reflectance: float, sides: int, rough: Float64 | float = 1.0
) -> Mesh:
    """Open tubes along (n, k, 3) polylines with radii (n, k); ``rough`` scales (n, k, sides)."""
    ahead = np.gradient(lines, axis=1)
    ahead /= np.maximum(np.linalg.norm(ahead, axis=2, keepdims=True), 1e-9)
    chord = np.abs(lines[:, -1] - lines[:, 0])
    helper = np.eye(3)[np.argmin(chord, axis=1)][:, None, :]
    u = np.cross(ahead, helper)
    u /= np.maximum(np.linalg.norm(u, axis=2, keepdims=True), 1e-9)
    v = np.cross(ahead, u)
    angle = np.arange(sides) * (2 * np.pi / sides)
    ring = np.cos(angle)[:, None] * u[:, :, None] + np.sin(angle)[:, None] * v[:, :, None]
    reach = np.broadcast_to(radii, lines.shape[:2])[:, :, None] * rough
    skin = lines[:, :, None] + np.broadcast_to(reach, ring.shape[:3])[..., None] * ring
    near = np.roll(skin, -1, axis=2)
    corners = [skin[:, :-1], near[:, :-1], near[:, 1:], skin[:, 1:]]
    return quads(np.stack(corners, axis=3), reflectance)


def _axes(
    rng: np.random.Generator, species: Species, tall: float, radius: float
) -> tuple[Float64, Float64]:
    """Stems and the forks of the trunk as (a, 9, 3) polylines with (a, 9) radii."""
    count = int(rng.integers(species.stems[0], species.stems[1] + 1))
    t = np.array([0.0, 0.02, 0.06, 0.15, 0.3, 0.45, 0.6, 0.8, 1.0])
    reach = tall * rng.uniform(0.75, 1.0, count)
    reach[0] = tall
    lean = rng.normal(0, species.lean, (count, 2))
    bow = rng.normal(0, 0.5 * species.lean + 0.01, (count, 2))
    across = t[:, None] * lean[:, None] + (t**2)[:, None] * bow[:, None]
    across += np.cumsum(rng.normal(0, 0.004, (count, 9, 2)), axis=1)
    line = np.concatenate([across, np.broadcast_to(t[:, None], (count, 9, 1))], axis=2)
    line *= reach[:, None, None]
    line[:, :, :2] += rng.normal(0, 1.2, (count, 1, 2)) * radius * (count > 1)
    line[:, 0, 2] = -0.3
    flare = np.array([rng.uniform(1.3, 2.0), rng.uniform(1.05, 1.3), *np.ones(7)])
    thick = radius * flare * (1 - 0.9 * t**1.2) * np.ones((count, 1))
    if rng.random() >= species.forked:
        return line, thick
    begin = int(rng.integers(4, 7))
    forks, slim = _forks(rng, line[0, begin], float(thick[0, begin]), tall)
    line[0, begin + 1 :] = line[0, begin] + np.outer(np.arange(1, 9 - begin), [0.0, 0.0, 0.01])
    thick[0, begin + 1 :] = 0.5 * thick[0, begin]
    return np.concatenate([line, forks]), np.concatenate([thick, slim])


def _forks(
    rng: np.random.Generator, foot: Float64, radius: float, tall: float
) -> tuple[Float64, Float64]:
    """Two or three stems that a trunk divides into at ``foot``."""
    ways = int(rng.integers(2, 4))
    turn = rng.uniform(0, 2 * np.pi) + np.arange(ways) * 2 * np.pi / ways
    rest = tall * rng.uniform(0.8, 1.0, ways) - foot[2]
    swing = rng.uniform(0.12, 0.4, ways) * rest
    s = np.linspace(0, 1, 9)[None, :, None]
    out = np.stack([np.cos(turn), np.sin(turn)], axis=1)[:, None] * swing[:, None, None]
    lines = np.concatenate([out * s**0.8, rest[:, None, None] * s], axis=2) + foot
    lines[:, 1:] += rng.normal(0, 0.008 * tall, (ways, 8, 3))
    slim = rng.uniform(0.6, 0.85, (ways, 1)) * radius * (1 - 0.85 * s[0, :, 0])
    return lines, slim


def _branches(
    rng: np.random.Generator, species: Species, axes: Float64, radii: Float64, tall: float
) -> tuple[Float64, Float64]:
    """Boughs as (b, 4, 3) polylines with (b, 4) radii."""
    count = int(rng.integers(species.branches[0], species.branches[1] + 1))
    base = float(rng.uniform(*species.bare))
    wide = tall * float(rng.uniform(*species.spread))
    up = np.sort(rng.uniform(0, 1, count) ** 0.9)  # 0 at the foot of the crown, 1 at the top
    start, thick = _on_axes(rng, axes, radii, (base + 0.97 * (1 - base) * up) * tall)
    profile = np.interp(up, np.linspace(0, 1, len(species.crown)), species.crown)
    reach = wide * profile * rng.uniform(0.65, 1.15, count)
    turn = rng.uniform(0, 2 * np.pi) + _GOLDEN * np.arange(count) + rng.normal(0, 0.4, count)
    rise = np.interp(up, [0, 1], species.rise) + rng.normal(0, 0.15, count)
    way = polar(np.cos(rise), turn, np.sin(rise))
    s = np.array([0.0, 0.33, 0.67, 1.0])[:, None]
    line = start[:, None] + reach[:, None, None] * (s * way[:, None])
    line[:, :, 2] -= species.droop * reach[:, None] * s[:, 0] ** 2
    line[:, 1:] += rng.normal(0, 0.05, (count, 3, 3)) * reach[:, None, None]
    slim = np.maximum(0.012, np.minimum(0.55 * thick, 0.02 + 0.016 * reach))
    return line, slim[:, None] * np.array([1.0, 0.75, 0.5, 0.2])


def _on_axes(
    rng: np.random.Generator, axes: Float64, radii: Float64, heights: Float64
) -> tuple[Float64, Float64]:
    """A point and the radius of some axis at each height, of those that reach there."""
    low, high = axes[:, 0, 2], axes[:, -1, 2]
    reaches = (heights[:, None] >= low - 0.5) & (heights[:, None] <= high + 0.5)
    chosen = np.argmax(rng.random(reaches.shape) * reaches, axis=1)
    point, thick = np.empty((len(heights), 3)), np.empty(len(heights))
    for k in range(len(axes)):
        mine = chosen == k
        z = axes[k, :, 2]
        for d in range(3):
            point[mine, d] = np.interp(heights[mine], z, axes[k, :, d])
        thick[mine] = np.interp(heights[mine], z, radii[k])
    return point, thick


def _twigs(rng: np.random.Generator, species: Species, branches: Float64) -> Float64:
    """Twigs off the outer two thirds of each branch, (w, 2, 3)."""
    span = branches[:, -1] - branches[:, 0]
    length = np.linalg.norm(span, axis=1)
    many = np.clip((2.2 * length).astype(int) + 2, 2, 9)
    of = np.repeat(np.arange(len(branches)), many)
    at = rng.uniform(0.6, 3.0, len(of))
    cell = np.minimum(at.astype(int), 2)
    share = (at - cell)[:, None]
    start = branches[of, cell] * (1 - share) + branches[of, cell + 1] * share
    way = span[of] / np.maximum(length[of], 1e-6)[:, None] + rng.normal(0, 0.6, (len(of), 3))
    way[:, 2] = (1 - species.hang) * way[:, 2] - 1.6 * species.hang
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    reach = (0.35 + 0.5 * species.hang) * length[of] * rng.uniform(0.5, 1.2, len(of)) + 0.1
    reach = np.minimum(reach, 0.8 * np.maximum(start[:, 2], 0.3))
    return np.stack([start, start + reach[:, None] * way], axis=1)


def _leaves(
    rng: np.random.Generator, species: Species, twigs: Float64, detail: float, material: int
) -> Mesh:
    length = np.linalg.norm(twigs[:, 1] - twigs[:, 0], axis=1)
    dense = 1.5 * detail * float(rng.uniform(*species.leaves))
    wanted = length * dense * rng.uniform(0.4, 1.6, len(length))
    many = (wanted + rng.random(len(length))).astype(int)
    of = np.repeat(np.arange(len(twigs)), many)
    t = rng.uniform(0.1, 1.1, (len(of), 1))
    center = twigs[of, 0] * (1 - t) + twigs[of, 1] * t
    center += rng.normal(0, 0.22, (len(of), 3))
    shine = float(rng.uniform(0.4, 0.6))
    return scraps(rng, center, 1.3 * species.leaf / np.sqrt(detail), shine, material)


_WOOD, _STONE = 0.35, 0.4


def thicket(rng: np.random.Generator, radius: float, height: float, detail: float = 1.0) -> Mesh:
    """A mound of brambles or scrub over uneven lobes, with canes inside."""
    count = int(rng.integers(3, 8))
    turn, out = rng.uniform(0, 2 * np.pi, count), radius * rng.uniform(0, 0.75, count)
    wide, high = radius * rng.uniform(0.3, 0.7, count), height * rng.uniform(0.4, 1.0, count)
    high[0] = height
    foot = polar(out, turn)
    dense = detail * rng.uniform(14, 28)
    many = np.maximum(8, dense * wide * (wide + 2 * high)).astype(int)
    of = np.repeat(np.arange(count), many)
    way = rng.normal(size=(len(of), 3))
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    way[:, 2] = np.abs(way[:, 2])
    depth = rng.uniform(0.05, 1.0, (len(of), 1)) ** 0.4
    spread = xyz(wide, wide, high)[of]
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
    center = polar(reach, of, rise)
    return scraps(rng, center + rng.normal(0, 0.04, center.shape), 0.11, _LEAF)


def grass(rng: np.random.Generator) -> Mesh:
    """A patch of tall grass or rushes."""
    count, tall = int(rng.integers(25, 90)), rng.uniform(0.35, 1.1)
    foot = at_height(rng.normal(0, rng.uniform(0.15, 0.6), (count, 2)), -0.05)
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
    across, up = reach * np.cos(rim), reach * np.sin(rim) + 0.7 * radius
    disc = xyz(rng.normal(0, 0.08, 11), across, up)
    back = polygon(disc - [rng.uniform(0.25, 0.6), 0, 0], _WOOD)
    tips = disc * rng.uniform(1.05, 1.3, (11, 1)) + rng.normal(0, 0.1, (11, 3))
    roots = np.stack([0.6 * disc + above(0.3 * radius), tips], axis=1)
    return join([polygon(disc, _WOOD), back, limbs(roots, np.array([0.08, 0.02]), _WOOD, 4)])


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
        a = xyz(x, rng.normal(-long / 2, 0.1, len(x)), z)
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
    ring = polar(flat, longitude, high)
    ring = np.concatenate([ring, ring[:, :1]], axis=1) * size + above(0.3 * size[2])
    return grid_quads(ring, _STONE)


def _cut(center: Float64, normal: Float64, radius: float) -> Mesh:
    """The disc where a trunk was cut or broken."""
    way = normal / np.linalg.norm(normal)
    u = np.cross(way, np.eye(3)[np.argmin(np.abs(way))])
    u /= np.linalg.norm(u)
    angle = np.linspace(0, 2 * np.pi, 8, endpoint=False)[:, None]
    return polygon(center + radius * (np.cos(angle) * u + np.sin(angle) * np.cross(way, u)), _WOOD)
