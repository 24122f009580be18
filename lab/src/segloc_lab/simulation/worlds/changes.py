"""What is different from session to session: things replaced, scaffolding, road works."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from scipy.spatial import ConvexHull, cKDTree

from segloc.types import Float32, Float64

from ..objects.fixtures import cabinet, traffic_sign
from ..objects.mesh import SOLID, Mesh, above, boxes, join, scraps, tubes
from ..objects.scene import Terrain
from ..objects.works import barriers, cones
from .interior import REPLACEABLE, Interior, Replaceable

_CELL_M = 0.5

Item: TypeAlias = tuple[str, Mesh]
Clearance: TypeAlias = Callable[[Float64], Float64]

BUILT = frozenset({"house", "hall", "training house"})
"""Kinds that scaffolding may stand before."""


class Footing:
    """Where the ground is free between what stands on it.

    Parameters
    ----------
    triangles : (T, 3, 3) float32
        Of everything that stays.
    terrain : Terrain
    parked : (n, 2) float64
        Middles of places where vehicles come and go.
    clearance : callable
        Distances of (n, 2) points from the nearest road.
    interior : Interior or None
        Whose walls nothing is put beyond.
    """

    def __init__(
        self,
        triangles: Float32,
        terrain: Terrain,
        parked: Float64,
        clearance: Clearance,
        interior: Interior | None = None,
    ) -> None:
        corners = triangles.reshape(-1, 3)
        low = corners[corners[:, 2] < terrain.height(corners[:, 0], corners[:, 1]) + 2.5]
        cell = np.rint(low[:, :2] / _CELL_M).astype(np.int64)
        first = cell.min(axis=0, initial=0)
        taken = np.zeros(cell.max(axis=0, initial=0) - first + 1, dtype=bool)
        taken[tuple((cell - first).T)] = True
        self._taken = cKDTree(np.concatenate([_CELL_M * (np.argwhere(taken) + first), parked]))
        self._parked = cKDTree(parked) if len(parked) else None
        self._clearance = clearance
        self.interior = interior

    def find(
        self, rng: np.random.Generator, near: Float64, radius: float, taken: list[Float64]
    ) -> Float64 | None:
        """A free spot of a radius 2 to 15 m from a (2,) place; None where there is none."""
        turn, reach = rng.uniform(0, 2 * np.pi, 40), rng.uniform(2.0, 15.0, 40)
        spots = near + reach[:, None] * np.stack([np.cos(turn), np.sin(turn)], axis=1)
        free = (self._taken.query(spots)[0] > radius + 0.3) & (self._clearance(spots) > radius)
        if self._parked is not None:
            free &= self._parked.query(spots)[0] > radius + 2.7
        if self.interior is not None:
            free &= self.interior.inside(spots)
        if taken:
            apart = np.linalg.norm(spots[:, None] - np.array(taken), axis=2).min(axis=1)
            free &= apart > radius + 3.5
        return spots[int(np.argmax(free))] if free.any() else None


@dataclass(frozen=True)
class Extent:
    """Where an object is: the middle of its plan, (2,), foot, height, and its triangles."""

    middle: Float64
    base: float
    height: float
    triangles: Float32

    @staticmethod
    def of(triangles: Float32) -> Extent:
        """Of the (T, 3, 3) triangles of one object."""
        points = triangles.reshape(-1, 3)
        low, high = points.min(axis=0), points.max(axis=0)
        middle = ((low + high) / 2)[:2].astype(np.float64)
        return Extent(middle, float(low[2]), float(high[2] - low[2]), triangles)


def replace_some(
    rng: np.random.Generator,
    share: float,
    things: dict[int, tuple[str, Extent]],
    footing: Footing,
    terrain: Terrain,
) -> tuple[set[int], list[Item]]:
    """Which of the replaceable objects are gone, and others near where they stood."""
    gone: set[int] = set()
    added: list[Item] = []
    taken: list[Float64] = []
    for number, (kind, extent) in sorted(things.items()):
        entry = REPLACEABLE[kind]
        if extent.height > entry.tallest or rng.random() >= share:
            continue
        gone.add(number)
        if entry.in_place:
            added.append((kind, _instead(rng, entry, extent, footing.interior)))
            continue
        at = footing.find(rng, extent.middle, entry.radius, taken)
        mesh, yaw = entry.make(rng), float(rng.uniform(0, 2 * np.pi))
        if at is not None:
            taken.append(at)
            added.append((kind, mesh.moved([*at, float(terrain.height(*at))], yaw)))
    return gone, added


def _instead(
    rng: np.random.Generator, entry: Replaceable, extent: Extent, interior: Interior | None
) -> Mesh:
    """Another of its kind where one stood, either way round, square to the walls."""
    turn = 0.0 if interior is None else interior.turn
    span = np.ptp(extent.triangles.reshape(-1, 3)[:, :2] @ _turned(turn), axis=0)
    mesh = entry.make(rng)
    own = np.ptp(mesh.triangles.reshape(-1, 3)[:, :2], axis=0)
    across = np.pi / 2 * ((span[0] > span[1]) != (own[0] > own[1]))
    return mesh.moved([*extent.middle, extent.base], turn + across + np.pi * int(rng.integers(2)))


def _turned(angle: float) -> Float64:
    return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])


def scaffold(
    rng: np.random.Generator, extent: Extent, terrain: Terrain, clearance: Clearance
) -> Mesh:
    """Scaffolding before that side of a building which is nearest to a road.

    Two rows of standards with ledgers, decks, diagonals, handrails; netting on part of it.
    """
    start, end, out = _street_side(extent, clearance)
    long = float(np.linalg.norm(end - start))
    bays = max(1, round(long / rng.uniform(1.9, 2.6)))
    deep, lift = rng.uniform([0.7, 1.9], [1.2, 2.1])
    base = float(np.min(terrain.height(*(start + end) / 2 + out * deep)))
    top = max(lift, extent.height - rng.uniform(1.0, 3.0))
    s = np.linspace(0, 1, bays + 1)[:, None]
    line = start + s * (end - start)
    rows = [np.column_stack([line + out * d, np.full(bays + 1, base)]) for d in (0.3, 0.3 + deep)]
    foot = np.concatenate(rows)
    parts = [tubes(foot - above(0.2), foot + above(top + 1.0), [0.024, 0.024], 0.4, sides=5)]
    for z in np.arange(lift, top, lift):
        for row in rows:
            at = row + above(z)
            parts.append(tubes(at[:-1], at[1:], [0.024, 0.024], 0.4, sides=4))
        rail = rows[1] + above(z + 1.0)
        parts.append(tubes(rail[:-1], rail[1:], [0.024, 0.024], 0.4, sides=4))
        parts.append(tubes(rows[0] + above(z), rows[1] + above(z), [0.024] * 2, 0.4, sides=4))
        parts.append(_deck(start, end, out, deep, base + z))
    brace = rows[1]
    parts.append(tubes(brace[:-1] + above(0.1), brace[1:] + above(top), [0.024] * 2, 0.4, sides=4))
    if rng.random() < 0.6:
        parts.append(_netting(rng, rows[1], top))
    return join(parts)


def _street_side(extent: Extent, clearance: Clearance) -> tuple[Float64, Float64, Float64]:
    """The side of the smallest rectangle about a building that is nearest to a road.

    Both ends, (2,), and the unit vector away from the building.
    """
    points = extent.triangles.reshape(-1, 3)[:, :2].astype(np.float64)
    hull = points[ConvexHull(points).vertices]
    edges = np.roll(hull, -1, axis=0) - hull
    angles = np.unique(np.round(np.arctan2(edges[:, 1], edges[:, 0]) % (np.pi / 2), 3))
    turns = [_turned(float(a)) for a in angles]
    R = min(turns, key=lambda turn: float(np.prod(np.ptp(hull @ turn, axis=0))))
    low, high = (hull @ R).min(axis=0), (hull @ R).max(axis=0)
    corner = np.array([low, [high[0], low[1]], high, [low[0], high[1]]]) @ R.T
    begin, end = corner, np.roll(corner, -1, axis=0)
    k = int(np.argmin(clearance((begin + end) / 2)))
    way = (end[k] - begin[k]) / np.linalg.norm(end[k] - begin[k])
    return begin[k], end[k], np.array([way[1], -way[0]])


def _deck(start: Float64, end: Float64, out: Float64, deep: float, z: float) -> Mesh:
    middle = (start + end) / 2 + out * (0.3 + deep / 2)
    way = end - start
    yaw = float(np.arctan2(way[1], way[0]))
    board = boxes([0, 0, 0], [float(np.linalg.norm(way)), 0.9 * deep, 0.05], 0.4)
    return board.moved([*middle, z], yaw)


def _netting(rng: np.random.Generator, row: Float64, top: float) -> Mesh:
    """Net before a stretch of scaffolding: small patches in its plane, some rays pass."""
    first = int(rng.integers(0, max(1, len(row) // 2)))
    last = int(rng.integers(first + 1, len(row) + 1)) - 1
    a, b = row[first], row[max(last, first + 1) if first + 1 < len(row) else -1]
    count = int(np.linalg.norm(b - a) * top * rng.uniform(25, 60))
    t, z = rng.random((count, 1)), rng.uniform(0.5, top, count)
    sway = rng.normal(0, 0.02, (count, 3))
    center = a + t * (b - a) + sway + np.column_stack([np.zeros((count, 2)), z])
    return scraps(rng, center, 0.1, 0.35, SOLID)


def road_works(rng: np.random.Generator) -> Mesh:
    """Cones or barriers about a heap or a hole's spoil, about 5 m along x and 1.8 m wide."""
    edge = cones(rng) if rng.random() < 0.6 else barriers(rng)
    span = edge.triangles[..., 0]
    fit = min(1.0, 4.6 / float(np.ptp(span)))
    squeezed = Mesh(edge.triangles * [fit, 1, 1], edge.reflectance, edge.material)
    parts = [squeezed.moved([0, 0.75, 0])]
    size = rng.uniform([1.2, 0.5, 0.3], [3.2, 0.9, 1.1])
    n = int(40 * size[0])
    way = rng.normal(0, 0.33, (n, 2)) * size[:2]
    lift = size[2] * np.exp(-((way / size[:2]) ** 2).sum(axis=1) * 3)
    heap = scraps(rng, np.column_stack([way - [0, 0.2], 0.5 * lift]), 0.16, 0.35, SOLID)
    parts.append(heap)
    if rng.random() < 0.5:
        parts.append(traffic_sign(rng).moved([rng.choice([-2.4, 2.4]), 0.4, 0]))
    if rng.random() < 0.3:
        parts.append(cabinet(rng).moved([rng.uniform(-1, 1), -0.4, 0], 1.6))
    return join(parts)
