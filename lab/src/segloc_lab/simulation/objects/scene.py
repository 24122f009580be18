"""What rays meet: terrain and objects, ready to be cast at."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from segloc.errors import MissingDependency
from segloc.types import Float32

from .identity import GROUND_ID, Int32, Objects
from .mesh import SOLID, UInt8
from .terrain import Terrain


@dataclass(frozen=True)
class Hits:
    """What rays met, one entry a ray.

    Attributes
    ----------
    ranges : (R,) float32
        Metres; infinite where nothing was met.
    object_ids : (R,) int32
        -1 where nothing was met.
    material : (R,) uint8
        Of the surface; ``SOLID`` where nothing was met.
    lots : (R,) float32
        A number in [0, 1) that belongs to the triangle.
    normals : (R, 3) float32
        Unit normals, on either side of the surface.
    cosines : (R,) float32
        Of the angle between ray and surface normal, in [0, 1].
    reflectance : (R,) float32
    """

    ranges: Float32
    object_ids: Int32
    material: UInt8
    lots: Float32
    normals: Float32
    cosines: Float32
    reflectance: Float32


class Scene:
    """A world as it stands in one session, ready for rays.

    Parameters
    ----------
    terrain : Terrain
    ground_reflectance : (T,) float32
        Of each triangle of the terrain's mesh.
    groups : list of Objects

    Raises
    ------
    MissingDependency
        If embreex is not installed.
    """

    def __init__(
        self, terrain: Terrain, ground_reflectance: Float32, groups: list[Objects]
    ) -> None:
        try:
            from embreex.mesh_construction import TriangleMesh
            from embreex.rtcore_scene import EmbreeScene
        except ImportError as error:
            raise MissingDependency("embreex", "sim", "simulation") from error
        self._embree = EmbreeScene()
        vertices, faces = terrain.mesh()
        filled = [group for group in groups if len(group.triangles)]
        self._meshes = [TriangleMesh(self._embree, vertices, faces.astype(np.int32))]
        self._meshes += [TriangleMesh(self._embree, group.triangles) for group in filled]
        ground = np.full(len(faces), GROUND_ID, dtype=np.int32)
        none, dark = np.full(1, -1, dtype=np.int32), np.zeros(1, dtype=np.float32)
        earth, blank = np.full(len(faces), SOLID, dtype=np.uint8), np.full(1, SOLID, dtype=np.uint8)
        same = np.zeros(len(faces), dtype=np.float32)
        # The last entry, number -1, is what rays that met nothing met.
        self._ids = np.concatenate([ground, *(group.object_ids for group in filled), none])
        self._material = np.concatenate([earth, *(group.material for group in filled), blank])
        self._lots = np.concatenate([same, *(group.lots for group in filled), dark])
        shine = [group.reflectance for group in filled]
        self._reflectance = np.concatenate([ground_reflectance, *shine, dark])
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
