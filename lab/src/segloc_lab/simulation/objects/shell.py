"""The shell of a building: walls with openings, ceilings with beams, pillars, stairs."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from segloc.types import Float64

from .mesh import Mesh, above, boxes, glass, join, quads, tubes

_PIECE_M = 1.0
"""Longest piece of a wall: what stands beside it is kept clear of the corners of its pieces."""

_CONCRETE, _PLASTER, _STEEL = 0.45, 0.65, 0.3


def wall(
    start: ArrayLike,
    end: ArrayLike,
    span: tuple[float, float],
    openings: Sequence[tuple[float, float, float, float]] = (),
    *,
    thick: float = 0.2,
) -> Mesh:
    """A wall between two points of the plan.

    Parameters
    ----------
    start, end : (2,) array
        Its middle line, metres.
    span : (float, float)
        Heights of its foot and its top.
    openings : sequence of (from, to, low, top)
        Metres along the wall, and heights; apart from each other.
    thick : float
    """
    a, b = np.asarray(start, dtype=float), np.asarray(end, dtype=float)
    long, (low, high) = float(np.linalg.norm(b - a)), span
    edges = [0.0, *(s for hole in sorted(openings) for s in hole[:2]), long]
    spans = [(s, t, low, high) for s, t in zip(edges[::2], edges[1::2], strict=True)]
    spans += [(s, t, low, bottom) for s, t, bottom, _ in openings]
    spans += [(s, t, top, high) for s, t, _, top in openings]
    blocks = np.array([
        (x, x + step, z0, z1)
        for s, t, z0, z1 in spans
        if t - s > 0.02 and z1 - z0 > 0.02
        for step in [(t - s) / max(1, round((t - s) / _PIECE_M))]
        for x in np.arange(s, t - step / 2, step)
    ]).reshape(-1, 4)  # fmt: skip
    middle = np.column_stack(
        [(blocks[:, 0] + blocks[:, 1]) / 2, 0 * blocks[:, 0], (blocks[:, 2] + blocks[:, 3]) / 2]
    )
    size = np.column_stack(
        [blocks[:, 1] - blocks[:, 0], np.full(len(blocks), thick), blocks[:, 3] - blocks[:, 2]]
    )
    yaw = float(np.arctan2(*(b - a)[::-1]))
    return boxes(middle, size, _PLASTER).moved([*a, 0.0], yaw)


def panes(start: ArrayLike, end: ArrayLike, span: tuple[float, float]) -> Mesh:
    """Glass between mullions, 1.2 m apart, from one point of the plan to another."""
    a, b = np.asarray(start, dtype=float), np.asarray(end, dtype=float)
    long, (low, high) = float(np.linalg.norm(b - a)), span
    x = np.linspace(0, long, max(2, round(long / 1.2) + 1))
    post = boxes(
        np.column_stack([x, 0 * x, 0 * x + (low + high) / 2]), [0.06, 0.08, high - low], _STEEL
    )
    rail = boxes([[long / 2, 0, z] for z in (low + 0.03, high - 0.03)], [long, 0.07, 0.06], _STEEL)
    left, right = x[:-1], x[1:]
    corner = np.zeros((len(left), 4, 3))
    corner[:, :, 0] = np.stack([left, right, right, left], axis=1)
    corner[:, :, 2] = [low, low, high, high]
    sheet = glass(quads(corner, 0.0))
    return join([post, rail, sheet]).moved([*a, 0.0], float(np.arctan2(*(b - a)[::-1])))


def slab(low: ArrayLike, high: ArrayLike, z: float, holes: Float64, reflectance: float) -> Mesh:
    """A level rectangle of the plan at height z, less rectangles (n, 4): x0, y0, x1, y1."""
    (x0, y0), (x1, y1) = np.asarray(low, dtype=float), np.asarray(high, dtype=float)
    xs = np.unique(np.concatenate([[x0, x1], holes[:, 0], holes[:, 2]]))
    ys = np.unique(np.concatenate([[y0, y1], holes[:, 1], holes[:, 3]]))
    left, bottom = np.meshgrid(xs[:-1], ys[:-1])
    right, top = np.meshgrid(xs[1:], ys[1:])
    cells = np.stack([left, bottom, right, top], axis=-1).reshape(-1, 4)
    middle = (cells[:, :2] + cells[:, 2:]) / 2
    open_ = ((middle[:, None] > holes[:, :2]) & (middle[:, None] < holes[:, 2:])).all(axis=2)
    kept = cells[~open_.any(axis=1)]
    corner = np.stack([kept[:, [0, 1]], kept[:, [2, 1]], kept[:, [2, 3]], kept[:, [0, 3]]], axis=1)
    return quads(np.concatenate([corner, np.full((*corner.shape[:2], 1), z)], axis=2), reflectance)


def pillar(shape: str, size: float, high: float) -> Mesh:
    """A "square", "round" or "steel" (H profile) pillar on a plinth, ``size`` metres wide."""
    if shape == "round":
        shaft = tubes([[0, 0, -0.2]], [[0, 0, high]], [size / 2, size / 2], _CONCRETE, sides=14)
    elif shape == "steel":
        web = [[0, 0, high / 2], [0, -size / 2, high / 2], [0, size / 2, high / 2]]
        wide = np.array([[0.03, size, high], [size, 0.03, high], [size, 0.03, high]])
        shaft = boxes(web, wide, _STEEL)
    else:
        shaft = boxes(above(high / 2 - 0.1), [size, size, high + 0.2], _CONCRETE)
    return join([shaft, boxes(above(0.1), [size + 0.16, size + 0.16, 0.24], 0.6)])


def beams(
    first: ArrayLike, last: ArrayLike, along: ArrayLike, pitch: float, size: tuple[float, float]
) -> Mesh:
    """Girders between two points (x, y, z of their tops), again and again, ``pitch`` apart.

    ``along`` is the (3,) way from the first girder to the last; ``size`` is width and depth.
    """
    a, b, way = (np.asarray(v, dtype=float) for v in (first, last, along))
    count = int(np.linalg.norm(way) / pitch + 1e-6)
    shift = np.arange(count + 1)[:, None] * way / np.linalg.norm(way) * pitch
    long = np.abs(b - a)
    wide = np.where(long > 1e-9, long, size[0])
    wide[2] = size[1]
    return boxes((a + b) / 2 + shift - above(size[1] / 2), wide, _STEEL)


def stair_flight(wide: float, run: float, rise: float) -> Mesh:
    """A flight of stairs that climbs ``rise`` over ``run`` along +x, its foot at the origin."""
    steps = 9
    k = np.arange(steps) + 0.5
    tread = np.column_stack([k * run / steps, 0 * k, (k + 0.5) * rise / steps - 0.08])
    parts = [boxes(tread, [run / steps, wide, 0.16], _CONCRETE)]
    for y in (-wide / 2, wide / 2):
        foot = np.array([[0.1, y, 0.1], [run - 0.1, y, rise]])
        parts.append(tubes(foot, foot + above(0.9), [0.02, 0.02], _STEEL, sides=5))
        rail = foot + above(0.9)
        parts.append(tubes(rail[:1], rail[1:], [0.025, 0.025], _STEEL, sides=5))
    return join(parts)
