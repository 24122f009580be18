"""Triangle meshes of simulated things: a few vectorised primitives, no mesh library needed."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from segloc.types import Float32, Float64

SOLID, GLASS, LEAF = range(3)
"""What triangles are made of: sensors see through glass, and leaves fall in winter."""

UInt8: TypeAlias = NDArray[np.uint8]
_PANE = 0.05


@dataclass(frozen=True)
class Mesh:
    """Loose triangles with what a laser sees of them."""

    triangles: Float64  # (T, 3, 3), corners in metres
    reflectance: Float32  # (T,), share of the light that comes back; decides what is lost
    material: UInt8  # (T,), SOLID, GLASS or LEAF

    def __len__(self) -> int:
        return len(self.triangles)

    def moved(self, position: ArrayLike, yaw: float = 0.0) -> Mesh:
        """The mesh turned about z by ``yaw`` radians, then shifted to ``position`` (x, y, z)."""
        R = np.eye(3)
        R[:2, :2] = rotation(yaw)
        return replace(self, triangles=self.triangles @ R + np.asarray(position, dtype=float))

    def scaled(self, factor: ArrayLike) -> Mesh:
        """The mesh with all coordinates multiplied by a factor, or by one for each axis."""
        return replace(self, triangles=self.triangles * np.asarray(factor, dtype=float))

    def only(self, mask: NDArray[np.bool_]) -> Mesh:
        """The triangles of a (T,) mask."""
        return Mesh(self.triangles[mask], self.reflectance[mask], self.material[mask])

    def leaning(self, pitch: float, roll: float) -> Mesh:
        """The mesh leaning by small angles (radians): a sheared z axis, good for a few degrees."""
        shear = np.eye(3)
        shear[2, :2] = pitch, roll
        return replace(self, triangles=self.triangles @ shear)


def rotation(yaw: float) -> Float64:
    """The (2, 2) matrix that turns rows (x, y) by ``yaw`` radians: ``xy @ rotation(yaw)``."""
    c, s = np.cos(yaw), np.sin(yaw)
    return np.array([[c, s], [-s, c]])


def xyz(x: ArrayLike, y: ArrayLike, z: ArrayLike) -> Float64:
    """Points (..., 3) of coordinates that broadcast."""
    return np.stack(np.broadcast_arrays(x, y, z), axis=-1).astype(float)


def at_height(xy: Float64, z: ArrayLike) -> Float64:
    """Points (n, 3) of points (n, 2) of the plan at heights that broadcast."""
    return xyz(xy[:, 0], xy[:, 1], z)


def polar(radius: ArrayLike, angle: ArrayLike, z: ArrayLike = 0.0) -> Float64:
    """Points (..., 3) at a distance and in a direction from the z axis."""
    return xyz(np.multiply(radius, np.cos(angle)), np.multiply(radius, np.sin(angle)), z)


def above(height: float) -> Float64:
    """The offset (0, 0, height)."""
    return np.array([0.0, 0.0, height])


def join(meshes: Iterable[Mesh]) -> Mesh:
    """One mesh of several."""
    parts = list(meshes) or [triangles([], 0.0)]
    return Mesh(
        np.concatenate([part.triangles for part in parts]),
        np.concatenate([part.reflectance for part in parts]),
        np.concatenate([part.material for part in parts]),
    )


def glass(mesh: Mesh) -> Mesh:
    """The mesh as window panes."""
    return triangles(mesh.triangles, _PANE, GLASS)


def triangles(corners: ArrayLike, reflectance: float, material: int = SOLID) -> Mesh:
    """A mesh of (T, 3, 3) corners."""
    array = np.asarray(corners, dtype=float).reshape(-1, 3, 3)
    return Mesh(
        array,
        np.full(len(array), reflectance, dtype=np.float32),
        np.full(len(array), material, dtype=np.uint8),
    )


def quads(corners: ArrayLike, reflectance: float) -> Mesh:
    """Quadrilaterals, (..., 4, 3) corners in cyclic order, as two triangles each."""
    array = np.asarray(corners, dtype=float).reshape(-1, 4, 3)
    return triangles(array[:, [[0, 1, 2], [0, 2, 3]]], reflectance)


_BOX_CORNERS = np.array(
    [
        [x, y, z]
        for z in (-0.5, 0.5)
        for x, y in ((-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5))
    ]
)
_BOX_FACES = np.array(
    [[0, 3, 2, 1], [4, 5, 6, 7], [0, 1, 5, 4], [1, 2, 6, 5], [2, 3, 7, 6], [3, 0, 4, 7]]
)


def boxes(centers: ArrayLike, sizes: ArrayLike, reflectance: float) -> Mesh:
    """Axis-aligned boxes: (n, 3) or (3,) centers and full sizes."""
    middle, size = np.broadcast_arrays(np.atleast_2d(centers), np.atleast_2d(sizes))
    corners = middle[:, None, :] + _BOX_CORNERS * size[:, None, :]
    return quads(corners[:, _BOX_FACES], reflectance)


def tubes(
    starts: ArrayLike, ends: ArrayLike, radii: ArrayLike, reflectance: float, sides: int = 8
) -> Mesh:
    """Cones with cut tips from (n, 3) ``starts`` to ``ends``; ``radii`` (n, 2) or (2,)."""
    a, b = np.broadcast_arrays(np.atleast_2d(starts), np.atleast_2d(ends))
    r = np.broadcast_to(np.atleast_2d(np.asarray(radii, dtype=float)), (len(a), 2))
    axis = b - a
    axis = axis / np.maximum(np.linalg.norm(axis, axis=1, keepdims=True), 1e-9)
    helper = np.where(np.abs(axis[:, 2:]) < 0.9, [[0.0, 0.0, 1.0]], [[1.0, 0.0, 0.0]])
    u = np.cross(axis, helper)
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    v = np.cross(axis, u)
    angle = np.arange(sides) * (2 * np.pi / sides)
    ring = np.cos(angle)[None, :, None] * u[:, None] + np.sin(angle)[None, :, None] * v[:, None]
    low = a[:, None] + r[:, :1, None] * ring
    high = b[:, None] + r[:, 1:, None] * ring
    corners = np.stack([low, np.roll(low, -1, 1), np.roll(high, -1, 1), high], axis=2)
    caps = np.stack([high, np.roll(high, -1, 1), np.repeat(b[:, None], sides, 1)], axis=2)
    return join([quads(corners, reflectance), triangles(caps, reflectance)])


def ellipsoid(center: ArrayLike, radii: ArrayLike, reflectance: float, rings: int = 5) -> Mesh:
    """A closed ellipsoid of ``rings`` latitudes and twice as many longitudes."""
    latitude = np.linspace(-np.pi / 2, np.pi / 2, rings + 1)[:, None]
    longitude = np.linspace(0, 2 * np.pi, 2 * rings + 1)
    grid = polar(np.cos(latitude), longitude, np.sin(latitude))
    return grid_quads(grid * np.asarray(radii) + np.asarray(center), reflectance)


def loft(sections: ArrayLike, reflectance: float, *, closed: bool = True) -> Mesh:
    """The skin over (n, k, 3) cross-sections of k points; both ends are capped if ``closed``."""
    array = np.asarray(sections, dtype=float)
    ring = np.concatenate([array, array[:, :1]], axis=1) if closed else array
    skin = grid_quads(ring, reflectance)
    if not closed:
        return skin
    return join([skin, *(polygon(array[end], reflectance) for end in (0, -1))])


def polygon(corners: ArrayLike, reflectance: float) -> Mesh:
    """A star-shaped flat polygon, (k, 3), as a fan about its middle."""
    ring = np.asarray(corners, dtype=float)
    middle = np.broadcast_to(ring.mean(axis=0), ring.shape)
    return triangles(np.stack([ring, np.roll(ring, -1, axis=0), middle], axis=1), reflectance)


def scraps(
    rng: np.random.Generator,
    centers: Float64,
    size: ArrayLike,
    reflectance: float,
    material: int = LEAF,
) -> Mesh:
    """One small triangle of random shape and direction at each of (n, 3) centers: foliage.

    What keeps its leaves in winter is ``SOLID``.
    """
    n = len(centers)
    a, b = rng.normal(size=(2, n, 3))
    a /= np.linalg.norm(a, axis=1, keepdims=True)
    b -= a * np.sum(a * b, axis=1, keepdims=True)
    b /= np.linalg.norm(b, axis=1, keepdims=True)
    scale = np.broadcast_to(np.asarray(size, dtype=float), (n,))[:, None]
    corner = np.stack([a, -0.5 * a + 0.9 * b, -0.5 * a - 0.9 * b], axis=1)
    spread = corner * scale[:, None] * rng.uniform(0.6, 1.4, (n, 3, 1))
    return triangles(centers[:, None] + spread, reflectance, material)


def grid_quads(grid: Float64, reflectance: float) -> Mesh:
    """The surface over a grid (n, k, 3) of points."""
    corners = np.stack([grid[:-1, :-1], grid[:-1, 1:], grid[1:, 1:], grid[1:, :-1]], axis=2)
    return quads(corners, reflectance)


def rectangle(center: Sequence[float] | Float64, size: tuple[float, float], yaw: float) -> Float64:
    """The (4, 2) corners of a rectangle in the plane, length ``size[0]`` along ``yaw``."""
    half = np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]]) * size
    corners: Float64 = half @ rotation(yaw) + np.asarray(center, dtype=float)[:2]
    return corners


Int32: TypeAlias = NDArray[np.int32]

GROUND_ID = 0
SESSION_IDS = 1_000_000
"""Objects that stay have ids below this; those of session k start at ``(k + 1) * SESSION_IDS``."""


@dataclass(frozen=True)
class Objects:
    """Triangles of many objects."""

    triangles: Float32  # (T, 3, 3), world frame, metres
    reflectance: Float32  # (T,)
    material: UInt8  # (T,)
    object_ids: Int32  # (T,)
    lots: Float32  # (T,), in [0, 1): which leaf falls when, which pane is dirty
    kinds: dict[int, str]  # what each object id is: "house", "tree", "car", ...

    @staticmethod
    def of(items: list[tuple[str, Mesh]], first_id: int) -> Objects:
        """Number (kind, mesh) items upwards from ``first_id``."""
        sizes = [len(mesh) for _, mesh in items]
        ids = first_id + np.repeat(np.arange(len(items)), sizes)
        surface = join(mesh for _, mesh in items)
        return Objects(
            surface.triangles.astype(np.float32),
            surface.reflectance,
            surface.material,
            ids.astype(np.int32),
            _lots(first_id, len(ids)),
            {first_id + k: kind for k, (kind, _) in enumerate(items)},
        )

    def only(self, mask: NDArray[np.bool_]) -> Objects:
        """The triangles of a (T,) mask, and the kinds of the objects that are left."""
        ids = self.object_ids[mask]
        return Objects(
            self.triangles[mask],
            self.reflectance[mask],
            self.material[mask],
            ids,
            self.lots[mask],
            {int(k): self.kinds[int(k)] for k in np.unique(ids)},
        )

    def with_foliage(self, share: float) -> Objects:
        """The objects with that share of their leaves."""
        if share == 1:
            return self
        return self.only((self.material != LEAF) | (self.lots < share))


def _lots(first: int, count: int) -> Float32:
    """A number in [0, 1) for each of ``count`` numbers from ``first``: without a pattern."""
    mixed = np.arange(count, dtype=np.uint64) + np.uint64(first)
    mixed *= np.uint64(0x9E3779B97F4A7C15)
    mixed ^= mixed >> np.uint64(29)
    mixed *= np.uint64(0xBF58476D1CE4E5B9)
    mixed ^= mixed >> np.uint64(32)
    return np.asarray((mixed >> np.uint64(40)).astype(np.float32) * np.float32(2.0**-24))
