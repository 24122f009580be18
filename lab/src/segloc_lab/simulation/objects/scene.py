"""What rays meet: terrain and objects, ready to be cast at."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import gaussian_filter

from segloc.errors import MissingDependency
from segloc.types import Float32, Float64, Int64

from .mesh import GROUND_ID, SOLID, Int32, Objects, UInt8, xyz


@dataclass(frozen=True)
class Terrain:
    """A height field; between grid points it is the two triangles that the rays meet."""

    origin: Float64  # (2,): x, y of heights[0, 0]
    step: float  # of the grid, metres
    heights: Float64  # (ny, nx), metres

    def height(self, x: ArrayLike, y: ArrayLike) -> Float64:
        """Height of the surface at x, y (any shape); outside the grid, that of its border."""
        ny, nx = self.heights.shape
        u = np.clip((np.asarray(x, dtype=float) - self.origin[0]) / self.step, 0, nx - 1 - 1e-9)
        v = np.clip((np.asarray(y, dtype=float) - self.origin[1]) / self.step, 0, ny - 1 - 1e-9)
        i, j = v.astype(np.int64), u.astype(np.int64)
        fu, fv = u - j, v - i
        h = self.heights
        low = h[i, j] + fu * (h[i, j + 1] - h[i, j]) + fv * (h[i + 1, j] - h[i, j])
        top = h[i + 1, j + 1]
        high = top + (1 - fu) * (h[i + 1, j] - top) + (1 - fv) * (h[i, j + 1] - top)
        return np.asarray(np.where(fu + fv <= 1, low, high), dtype=np.float64)

    def raised(self, by: float) -> Terrain:
        """Return the surface raised by a height [m]."""
        return replace(self, heights=self.heights + by)

    def mesh(self) -> tuple[Float32, Int64]:
        """Vertices (V, 3) float32 and triangles (T, 3) int64 of the surface."""
        ny, nx = self.heights.shape
        x = self.origin[0] + self.step * np.arange(nx)
        y = self.origin[1] + self.step * np.arange(ny)[:, None]
        vertices = xyz(x, y, self.heights).reshape(-1, 3).astype(np.float32)
        corner = (np.arange(ny - 1)[:, None] * nx + np.arange(nx - 1)).reshape(-1)
        low = np.stack([corner, corner + 1, corner + nx], axis=1)
        high = np.stack([corner + 1, corner + nx + 1, corner + nx], axis=1)
        return vertices, np.stack([low, high], axis=1).reshape(-1, 3)


def grid(size_m: float, step: float) -> tuple[Float64, Float64]:
    """x and y of the points of a square with a corner at the origin."""
    axis = step * np.arange(int(np.ceil(size_m / step)) + 1)
    x, y = np.meshgrid(axis, axis)
    return x, y


def relief(
    rng: np.random.Generator,
    x: Float64,
    y: Float64,
    slope: float = 0.025,
    *,
    lengths: tuple[float, float] = (70.0, 400.0),
) -> Float64:
    """Rolling ground: waves of the given lengths (m), root mean square slope about ``slope``."""
    waves = 7
    length = np.exp(rng.uniform(np.log(lengths[0]), np.log(lengths[1]), waves))
    angle, phase = rng.uniform(0, 2 * np.pi, (2, waves))
    amplitude = slope * length / (2 * np.pi) * np.sqrt(2.0 / waves)
    total = np.zeros(np.broadcast(x, y).shape)
    for k in range(waves):
        along = np.cos(angle[k]) * x + np.sin(angle[k]) * y
        total += amplitude[k] * np.sin(2 * np.pi / length[k] * along + phase[k])
    return total


def roughness(rng: np.random.Generator, shape: tuple[int, int]) -> Float64:
    """Small bumps with unit standard deviation: one part fine, one part a few cells wide."""
    fine = rng.normal(size=shape)
    coarse = gaussian_filter(rng.normal(size=shape), 3.0, mode="wrap")
    coarse /= coarse.std()
    return (0.6 * fine + 0.8 * coarse).astype(np.float64)


@dataclass(frozen=True)
class Hits:
    """What rays met, one entry a ray."""

    ranges: Float32  # metres; infinite where nothing was met
    object_ids: Int32  # -1 where nothing was met
    material: UInt8  # of the surface; SOLID where nothing was met
    lots: Float32  # a number in [0, 1) that belongs to the triangle
    normals: Float32  # (R, 3), of unit length, on either side of the surface
    cosines: Float32  # of the angle between ray and surface normal, in [0, 1]
    reflectance: Float32


class Scene:
    """A world as it stands in one session, ready for rays.

    Parameters
    ----------
    ground_reflectance : (T,) float32
        Of each triangle of the terrain's mesh.
    """

    def __init__(
        self, terrain: Terrain, ground_reflectance: Float32, groups: list[Objects]
    ) -> None:
        try:
            from embreex.mesh_construction import TriangleMesh
            from embreex.rtcore_scene import EmbreeScene
        except ImportError as error:
            raise MissingDependency("embreex", "lab", "simulation") from error
        self._embree = EmbreeScene()
        vertices, faces = terrain.mesh()
        filled = [group for group in groups if len(group.triangles)]
        self._meshes = [TriangleMesh(self._embree, vertices, faces.astype(np.int32))]
        self._meshes += [TriangleMesh(self._embree, group.triangles) for group in filled]

        def column(name: str, ground: ArrayLike, none: int, kind: type) -> NDArray[Any]:
            parts = [np.broadcast_to(ground, len(faces)), *(getattr(g, name) for g in filled)]
            return np.concatenate([*parts, [none]], dtype=kind, casting="unsafe")

        # The last entry, number -1, is what rays that met nothing met.
        self._ids = column("object_ids", GROUND_ID, -1, np.int32)
        self._material = column("material", SOLID, SOLID, np.uint8)
        self._lots = column("lots", 0, 0, np.float32)
        self._reflectance = column("reflectance", ground_reflectance, 0, np.float32)
        sizes = [len(faces), *(len(group.triangles) for group in filled)]
        self._first = np.concatenate([[0], np.cumsum(sizes)[:-1]])
        self.kinds: dict[int, str] = {GROUND_ID: "ground"}
        for group in filled:
            self.kinds.update(group.kinds)

    def cast(self, origins: Float32, directions: Float32, max_range: float) -> Hits:
        """First hits of rays from (R, 3) origins along (R, 3) unit directions."""
        found = self._embree.run(
            np.ascontiguousarray(origins, dtype=np.float32),
            np.ascontiguousarray(directions, dtype=np.float32),
            dists=np.full(len(origins), max_range, dtype=np.float32),
            output=True,
        )
        ranges, normals, missed = found["tfar"], found["Ng"], found["primID"] < 0
        triangles = self._first[found["geomID"]] + found["primID"]
        triangles[missed] = -1
        ranges[missed] = np.inf
        length = np.sqrt(np.einsum("ij,ij->i", normals, normals))
        normals /= np.maximum(length, np.float32(1e-12))[:, None]
        normals[missed] = 0.0
        slant = np.minimum(np.abs(np.einsum("ij,ij->i", normals, directions)), np.float32(1.0))
        return Hits(
            ranges,
            self._ids[triangles],
            self._material[triangles],
            self._lots[triangles],
            normals,
            slant,
            self._reflectance[triangles],
        )
