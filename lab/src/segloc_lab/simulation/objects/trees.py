"""Trees of several species: trunks, forks, branches, twigs, and leaves as small scraps."""

from __future__ import annotations

import numpy as np

from segloc.types import Float64

from .mesh import LEAF, SOLID, Mesh, join, quads, scraps
from .species import EVERGREEN, SPECIES, Species

_GOLDEN = 2.4  # radians from one branch to the next, about the golden angle
_TWIGS_FROM = 0.45  # detail below which twigs carry leaves but are not drawn, nor are bends


def grow(rng: np.random.Generator, kind: str, *, detail: float = 1.0, scale: float = 1.0) -> Mesh:
    """A tree with its foot at the origin.

    Parameters
    ----------
    rng : Generator
    kind : str
        Of :data:`SPECIES`.
    detail : float
        Share of the leaves that is drawn, each so much larger that they cover the same area; for
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
        parts = [
            limbs(axes, radii, species.bark, 9, rough),
            limbs(branches, thick, species.bark, 4),
            limbs(twigs, np.array([0.014, 0.006]), species.bark, 3),
        ]
    else:
        parts = [
            limbs(axes[:, ::2], radii[:, ::2], species.bark, 5),
            limbs(branches[:, ::3], thick[:, ::3], species.bark, 3),
        ]
    material = SOLID if kind in EVERGREEN else LEAF
    parts.append(_leaves(rng, species, twigs, detail, material))
    return join(parts)


def limbs(
    lines: Float64,
    radii: Float64,
    reflectance: float,
    sides: int,
    rough: Float64 | float = 1.0,
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
    next_side = np.roll(skin, -1, axis=2)
    corners = [skin[:, :-1], next_side[:, :-1], next_side[:, 1:], skin[:, 1:]]
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
    way = np.stack([np.cos(turn) * np.cos(rise), np.sin(turn) * np.cos(rise), np.sin(rise)], axis=1)
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
