"""Mines: bent galleries with rough walls, junctions, niches, and stretches where nothing is."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter
from scipy.spatial import cKDTree

from segloc.types import Float32, Float64

from ..objects.fixtures import cabinet
from ..objects.mesh import Mesh, Objects, above, boxes, join, quads, tubes
from ..objects.scene import Terrain, grid, relief, roughness
from ..objects.works import stores
from .layout import check_world
from .roads import RoadNetwork, Street, street_network
from .world import Spots, World, remember

_STEP = 0.3  # of the lattice that walls are made on, metres
_GROUND = 0.5  # of the terrain's grid, metres
_BELOW, _ABOVE = 0.6, 6.4  # what the lattice reaches below and above the floor, metres
_UPRIGHT = 1.0  # walls are upright to this height, metres
_BESIDE = 0.6  # from the edge of the way to the wall, metres
_ROCK = 0.35


@dataclass(frozen=True)
class Gallery:
    """A stretch of void about a line; metres."""

    line: Float64  # (n, 2)
    half_width: float
    high: float
    rough: float  # standard deviation of its walls
    fitted: str = "bare"  # or "pipes", "arches"

    def off(self, junctions: Float64) -> Gallery:
        """The same without what lies by a junction, where other galleries lead across."""
        away = np.linalg.norm(self.line[:, None] - junctions, axis=2).min(axis=1)
        return replace(self, line=self.line[away > 2 * self.half_width + 1.5])


@remember
def mine(seed: int, *, size_m: float = 120.0) -> World:
    """Galleries under a square of about ``size_m`` metres; the same for the same seed."""
    check_world(seed, size_m, 60.0, 240.0)
    rng = np.random.default_rng([seed, 122_949_823])
    roads = street_network(
        rng,
        size_m,
        margin_m=19.0,
        block_m=float(rng.uniform(30, 42)),
        half_width=(1.2, 2.2),
        shift=0.22,
        bend=0.16,
        missing=0.25,
    )
    roads = RoadNetwork(roads.nodes, roads.streets, 1.5)
    x, y = grid(size_m, _GROUND)
    heights = relief(rng, x, y, 0.035) + 0.02 * roughness(rng, x.shape)
    terrain = Terrain(np.zeros(2), _GROUND, heights)
    galleries = [part for street in roads.streets for part in _stretches(rng, street)]
    drawn = [pocket for street in roads.streets for pocket in _pockets(rng, street)]
    pockets = [p for p in drawn if p.line.min() > 3.0 and p.line.max() < size_m - 3.0]
    items = [("rock", _rock(rng, size_m, [*galleries, *pockets], terrain))]
    for gallery in galleries:
        items += _fittings(rng, gallery.off(roads.nodes), terrain)
    for pocket in pockets:
        items += _left_behind(rng, pocket, terrain)
    static = Objects.of([item for item in items if len(item[1])], 1)
    shine = np.full(2 * (len(heights) - 1) ** 2, 0.3, dtype=np.float32)
    # People keep to the walls.
    people = [s.at(np.arange(5.0, s.length, 17.0), s.half_width)[0] for s in roads.streets]
    spots = Spots(people=np.concatenate(people))
    return World(f"mine-{seed}", seed, terrain, shine, roads, static, spots)


def _stretches(rng: np.random.Generator, street: Street) -> list[Gallery]:
    """A gallery in parts of 10 to 25 m, each rough and fitted in its own way."""
    high = float(rng.uniform(3.0, 4.8))
    count = max(1, round(street.length / rng.uniform(10, 25)))
    parts = []
    for line in np.array_split(street.line, count):
        fitted = str(rng.choice(["bare", "pipes", "arches"], p=[0.45, 0.35, 0.2]))
        coarse = float(rng.uniform(0.03, 0.08) if rng.random() < 0.3 else rng.uniform(0.1, 0.28))
        half = street.half_width + _BESIDE + coarse + float(rng.uniform(0.0, 0.3))
        parts.append(Gallery(line, half, high + float(rng.normal(0, 0.15)), coarse, fitted))
    return parts


def _pockets(rng: np.random.Generator, street: Street) -> list[Gallery]:
    """Niches beside a gallery, and ends that lead nowhere."""
    found = []
    for s in np.arange(6.0, street.length - 6.0, rng.uniform(9.0, 25.0)):
        if rng.random() < 0.3:
            continue
        side = float(rng.choice([-1, 1]))
        deep = float(rng.uniform(8, 18) if rng.random() < 0.2 else rng.uniform(1.5, 4.5))
        begin, end = (street.half_width + d for d in (0.0, deep))
        across = np.linspace(begin, end, max(3, int(deep / 0.4)))
        line = street.at(s, side * across)[0]
        wide, high = rng.uniform([0.9, 2.0], [1.9, 3.2])
        found.append(Gallery(line, float(wide), float(high), float(rng.uniform(0.05, 0.2))))
    return found


def _rock(
    rng: np.random.Generator, size_m: float, galleries: list[Gallery], terrain: Terrain
) -> Mesh:
    """The walls and roofs of all galleries."""
    shape = tuple(int(np.ceil(s / _STEP)) + 1 for s in (size_m, size_m, _BELOW + _ABOVE))
    field = np.full(shape, 1.0, dtype=np.float32)
    coarse = np.zeros(shape[:2], dtype=np.float32)
    z: Float64 = _STEP * np.arange(shape[2], dtype=float) - _BELOW
    for gallery in galleries:
        _hollow(field, coarse, z, gallery)
    field += coarse[..., None] * rough(rng, shape, _STEP)
    field[..., -1] = 1.0  # a roof wherever noise would have none
    surface = skin(field, np.array([0.0, 0.0, -_BELOW]), _STEP)
    corner = surface.triangles
    corner[..., 2] += terrain.height(corner[..., 0], corner[..., 1])
    return surface


def _hollow(field: Float32, coarse: Float32, z: Float64, gallery: Gallery) -> None:
    """Hollow a gallery out: metres from its walls, negative in it; and note how rough they are."""
    reach = gallery.half_width + 1.5
    low = np.maximum(((gallery.line.min(axis=0) - reach) / _STEP).astype(int), 0)
    high = ((gallery.line.max(axis=0) + reach) / _STEP).astype(int) + 1
    part = (slice(low[0], high[0]), slice(low[1], high[1]))
    nx, ny = field[part].shape[:2]
    xy = _STEP * (np.indices((nx, ny)).transpose(1, 2, 0) + low)
    gap = np.asarray(cKDTree(gallery.line).query(xy.reshape(-1, 2))[0])
    away = gap.reshape(nx, ny) / gallery.half_width
    up = np.maximum(z - _UPRIGHT, 0.0) / (gallery.high - _UPRIGHT)
    radius = (away[..., None] ** 2.5 + up**2.5) ** 0.4
    scale = min(gallery.half_width, gallery.high - _UPRIGHT)
    np.minimum(field[part], ((radius - 1) * scale).astype(np.float32), out=field[part])
    near = np.float32(gallery.rough) * (away < 1.5)
    np.maximum(coarse[part], near.astype(np.float32), out=coarse[part])


def _fittings(
    rng: np.random.Generator, gallery: Gallery, terrain: Terrain
) -> list[tuple[str, Mesh]]:
    """Pipes and lamps along a wall, or steel arches; nothing in a bare stretch."""
    line = gallery.line[::3]
    if gallery.fitted == "bare" or len(line) < 3:
        return []
    way = np.gradient(line, axis=0)
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    left = np.column_stack([-way[:, 1], way[:, 0]])
    floor = np.column_stack([line, terrain.height(*line.T)])
    inner = gallery.half_width - gallery.rough - 0.25
    if gallery.fitted == "arches":
        return [("arches", _arches(floor, left, inner, gallery.high - 0.3))]
    parts, side = [], np.column_stack([left, np.zeros(len(line))]) * float(rng.choice([-1, 1]))
    for _ in range(int(rng.integers(1, 4))):
        row = floor + inner * side + above(float(rng.uniform(0.4, 2.0)))
        parts.append(tubes(row[:-1], row[1:], [rng.uniform(0.03, 0.12)] * 2, 0.3, sides=6))
    lamps = floor[:: max(1, int(rng.uniform(4, 7)))] + above(gallery.high - 0.5)
    return [("pipes", join(parts)), ("lamps", boxes(lamps, [0.4, 0.4, 0.15], 0.6))]


def _arches(floor: Float64, left: Float64, half: float, high: float) -> Mesh:
    """Steel arches from wall to wall, one at each point of a line."""
    turn = np.linspace(0, np.pi, 9)
    up = np.concatenate([[0.0], 0.55 * high + 0.45 * high * np.sin(turn), [0.0]])
    out = np.concatenate([[half], half * np.cos(turn), [-half]])
    point = floor[:, None] + np.concatenate(
        [left[:, None] * out[:, None], np.broadcast_to(up[:, None], (len(floor), 11, 1))], axis=2
    )
    starts, ends = point[:, :-1].reshape(-1, 3), point[:, 1:].reshape(-1, 3)
    return tubes(starts, ends, [0.07, 0.07], 0.35, sides=5)


def _left_behind(
    rng: np.random.Generator, pocket: Gallery, terrain: Terrain
) -> list[tuple[str, Mesh]]:
    """What lies at the end of a pocket."""
    pick, at = rng.random(), pocket.line[-2]
    foot, yaw = [*at, float(terrain.height(*at))], float(rng.uniform(0, 2 * np.pi))
    if pick < 0.5:
        return [("stores", stores(rng).moved(foot, yaw))]
    return [("switchgear", cabinet(rng).moved(foot, yaw))] if pick < 0.7 else []


def skin(field: Float32, origin: Float64, step: float) -> Mesh:
    """The surface where a field on a lattice is zero, by surface nets: one vertex a cell it cuts.

    Each vertex is the mean of where the surface cuts the edges of its cell, after Gibson,
    "Constrained elastic surface nets", MICCAI 1998.

    Parameters
    ----------
    field : (nx, ny, nz) float32
        Negative in the void.
    origin : (3,) float64
        Of its first value, metres.
    """
    inside = field < 0
    total = np.zeros((*(np.array(field.shape) - 1), 3), dtype=np.float32)
    count = np.zeros(total.shape[:3], dtype=np.float32)
    for axis in range(3):
        _add_crossings(field, inside, axis, total, count)
    total /= np.maximum(count, 1)[..., None]
    vertex = np.indices(count.shape, dtype=np.float32).transpose(1, 2, 3, 0) + total
    corners = [_faces(inside, vertex, axis) for axis in range(3)]
    return quads(np.concatenate(corners) * step + origin, _ROCK)


def _add_crossings(
    field: Float32, inside: NDArray[np.bool_], axis: int, total: Float32, count: Float32
) -> None:
    """Add where edges along an axis cross the surface to the sums of the four cells about each."""
    others = [k for k in range(3) if k != axis]
    first, last = _ends(axis)
    cut = inside[first] != inside[last]
    gap = field[first] - field[last]
    share = np.where(cut, field[first] / np.where(cut, gap, 1), 0).astype(np.float32)
    for a in (0, 1):
        for b in (0, 1):
            part = [slice(None)] * 3
            part[others[0]] = slice(a, None if a else -1)
            part[others[1]] = slice(b, None if b else -1)
            # The edge lies at the cell's low side (0) where it was cut from the high one.
            mine = cut[tuple(part)]
            count += mine
            total[..., axis] += share[tuple(part)]
            total[..., others[0]] += mine * np.float32(a)
            total[..., others[1]] += mine * np.float32(b)


def _ends(axis: int) -> tuple[tuple[slice, ...], tuple[slice, ...]]:
    first, last = [slice(None)] * 3, [slice(None)] * 3
    first[axis], last[axis] = slice(None, -1), slice(1, None)
    return tuple(first), tuple(last)


def _faces(inside: NDArray[np.bool_], vertex: Float32, axis: int) -> Float64:
    """Quadrilaterals (n, 4, 3) across the edges along an axis that the surface cuts."""
    others = [k for k in range(3) if k != axis]
    first, last = _ends(axis)
    cut = inside[first] != inside[last]
    inner = [slice(None)] * 3
    for k in others:
        inner[k] = slice(1, -1)
    at = np.argwhere(cut[tuple(inner)])
    around = []
    for a, b in ((0, 0), (1, 0), (1, 1), (0, 1)):
        cell = at.copy()
        cell[:, others[0]] += a
        cell[:, others[1]] += b
        around.append(vertex[tuple(cell.T)])
    return np.stack(around, axis=1).astype(np.float64)


def rough(rng: np.random.Generator, shape: tuple[int, ...], step: float) -> Float32:
    """Roughness on a lattice, of unit standard deviation: bulges of metres, edges of decimetres."""
    white = rng.standard_normal(shape, dtype=np.float32)
    total = np.zeros(shape, dtype=np.float32)
    for length, share in ((1.6, 0.8), (0.5, 0.6)):
        part = gaussian_filter(white, length / step / 2, mode="nearest")
        total += np.float32(share / part.std()) * part
    return total
