"""Comparison of a query cloud with the map at a pose: what the map knows where each point falls.

A point lies on the map, in space that the mapping sensor looked through, beside a surface that it
saw there, or in unknown space, which counts neither for nor against a pose. The reverse is the
share of the map in view that the query sees: a map point violates free space if the query measured
a surface well behind it, in its direction and all around it (G. Kim, A. Kim, "Remove, then Revert:
Static Point Cloud Map Construction using Multiresolution Range Images", IROS 2020). Similar rooms
differ by decimetres, which walls tell. Hedges and rows of trees may fit elsewhere, but their ground
does not.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from .. import _native, geometry
from ..frontend.segmentation import Segmentation
from ..geometry import Separation
from ..localization import NextView
from ..system.once import once
from ..types import Float32, Float64, Int64, Pose
from .nearby import NearbySearch
from .next_view import RADIUS_M, next_view
from .registration import ERRORS, Aligner, Alignment, Target, thinned

OVERLAP_M, _POINTS, _SOME_POINTS = 0.3, 2000, 1000
"""Distance within which a query point lies on the map, the most points compared, and those of them
after an alignment with some."""
_ROUGH_M, _ROUGH_POINTS = 0.5, 500
"""The same before alignment."""
CHANCE = 0.25
"""Share of points that lie on the map at some pose of any map: those in unmapped space count so."""
_ICP_VOXEL_M, _ICP_M, _ICP_RANGE_M = 0.8, 1.5, 35.0
"""Voxels of clouds that are aligned, their longest correspondences, and the range of points."""
SEEN_M, VIEW_M, VIEW_DEG, BEHIND_M = 0.4, 30.0, 2.0, 0.7
"""Largest distance of a seen map point from a query point, range of the map points compared, width
of a pixel of the range image, and how far behind a point a ray violates free space."""
_VIEW_POINTS = 1000
"""Most map points compared."""
_FLUSH_M = 0.1
"""Largest distance of a point on a wall's surface."""
_STOREY_SAMPLE = 200
"""Points of a query in the search for other storeys."""
_CLOSE_VOXEL_M = 0.3
"""Voxel size of a query's close surface: that of maps."""

_HERE = np.eye(4)
_HEIGHT_PERCENTILES, _MAX_HEIGHTS = (1.0, 99.0), 4000
"""Percentiles that bound the heights of a query, and the most points used."""
_STOREY_MARGIN_M = 1.0
"""Map points within this above or below these heights are on the query's storey."""
_VIEWPOINT_SPACING_M = 3.0
"""Spacing of the viewpoints from which the map knows its space."""
_WALL, _LEVEL = (-1.0, 0.3), (0.9, 2.0)
"""Vertical parts of the normals of walls and of the ground."""
_MAX_SURFACE_POINTS = 2000
"""Most points of walls or of the ground compared."""
_GROUND_TOLERANCE_M = 0.2
_CLOSE_M, _SUPPORT_M = 1.0, 0.75
"""Radii of close surfaces: to the nearest point, and to the points of its plane."""
_WALL_PATCH_M, _INSIDE_PATCH_M = 3.0, 0.75
"""Sides of the patches of walls that are compared as one, and of the query in free space."""
_PLANES, _PLANE_POINTS, _MAX_PLANES = 2, 800, 64
"""Widest planes of a query that are found, of how many points, and by how many normals."""
UNKNOWN, HIT, THROUGH, MISSED = range(4)
"""Codes of points: in unknown space, on the map, in free space, beside a surface."""
_EXPLAINED_M = (0.04, 0.2)
"""Distances from the map's surface up to which a wall point is explained, and beyond which not."""
_SURE_PATCH = 8.0
"""Points from which a patch of walls counts as one; fewer count less."""
_OPEN_DEG = 1.1
"""Standard deviation of the rotation from which an alignment is repeated, as dense as the map."""


class Count(NamedTuple):
    """A number of points out of a total."""

    hits: int
    of: int

    @property
    def share(self) -> float | None:
        """Share in [0, 1]; None of an empty total."""
        return self.hits / self.of if self.of else None

    def log_odds(self, prior: float) -> float:
        """Return the log-odds of the share, with ``prior`` more hits and misses."""
        return math.log((self.hits + prior) / (self.of - self.hits + prior))


class Evidence(NamedTuple):
    """A query's points by what the map knows where they fall; the others are unknown.

    Attributes
    ----------
    on, off : int
        Points on the map, and those in known space beside it.
    of : int
        All points, the unknown ones included.
    """

    on: int
    off: int
    of: int

    @property
    def unknown(self) -> float:
        """Share of the points in unknown space, in [0, 1]; 1 of no points."""
        return 1.0 - (self.on + self.off) / self.of if self.of else 1.0


class Walls(NamedTuple):
    """The patches of walls of a query.

    Attributes
    ----------
    explained : (P,) float32
        Share of each that lies on the map's surfaces; 0 where the map knows nothing about it.
    weight : (P,) float32
        How sure that is, in [0, 1].
    """

    explained: Float32
    weight: Float32


@dataclass(eq=False)
class Aligned:
    """A query at a pose after alignment with some of its points; equal to itself only.

    Attributes
    ----------
    T_map_local : (4, 4) float64
    overlap : float
        Share of the query cloud with a map point nearby, in [0, 1]; points above the map's height
        there are excluded.
    seen : Count
        Map points in view with a query point nearby; the others violate free space.
    """

    T_map_local: Pose
    overlap: float
    seen: Count


@dataclass(eq=False)
class Observation(Aligned):
    """A query at a pose after alignment with all of its points, compared with all that is known.

    Attributes
    ----------
    rmse : float
        Root mean square distance of the pairs of the overlap [m].
    covariance : (6, 6) float64 or None
        Covariance of rotation [rad], then translation [m], in the local frame. None without
        an alignment.
    known : Evidence
        Points of the structure.
    inside : Count
        Patches of the structure in free space of the map.
    on_surface, ground : Count
        Wall points on the map's surfaces, of those near them or in free space; ground points on the
        map's ground.
    walls : Walls
    planes : Count
        Points of the structure on its two widest planes, wherever it is.
    inliers : int
        Number of distinct query segments that agree with the pose (one map segment each).
    """

    rmse: float
    covariance: Float64 | None
    known: Evidence
    inside: Count
    on_surface: Count
    ground: Count
    walls: Walls
    planes: Count
    inliers: int = 0


class QueryCloud:
    """A query cloud, preprocessed for comparison with a map at several poses.

    Attributes
    ----------
    sample, some, few : (N, 3) float32
        Points of the overlap: all of them, and those after and before a rough alignment.
    aligned : dict
        Alignments so far, by their start and its frame.
    rough : dict
        Rough overlaps so far, by pose.
    walls : dict
        Walls compared already, by the pose and the origin of the map.
    """

    def __init__(self, scene: Segmentation, aligner: Aligner) -> None:
        self.sample = thinned(scene.structure, _POINTS)
        self.some = thinned(self.sample, _SOME_POINTS)
        self.few = thinned(self.sample, _ROUGH_POINTS)
        self.aligned: dict[bytes, Alignment | None] = {}
        self.rough: dict[bytes, float] = {}
        self.walls: dict[bytes, Walls] = {}
        self._scene, self._aligner = scene, aligner

    @once
    def surface(self) -> _native.Surface:
        """Surface for alignment."""
        return self._aligner.surface(self._near())

    @once
    def dense(self) -> _native.Surface:
        """The same, as dense as a map."""
        return close_surface(_native.voxel_grid(self._near(), _CLOSE_VOXEL_M))

    @once
    def close(self) -> tuple[_native.Surface, Float32, Int64]:
        """Surface of the structure, as dense as a map, its compared points, (N, 3), and the wall
        patch of each, (N,)."""
        near = _native.moved_crop(self._scene.structure, _HERE, _ICP_RANGE_M)
        surface = close_surface(_native.voxel_grid(near, _CLOSE_VOXEL_M))
        points = surface.sampled(_MAX_SURFACE_POINTS)
        return surface, points, patches(points, _WALL_PATCH_M)

    @once
    def patches(self) -> Int64:
        """Patch of each point of ``sample``, (N,)."""
        return patches(self.sample, _INSIDE_PATCH_M)

    @once
    def planes(self) -> Count:
        """Points of the structure on its two widest planes."""
        return _on_planes(self.close[0])

    def _near(self) -> Float32:
        """Return the points that are aligned, (N, 3)."""
        parts = self._scene.structure, self._scene.ground
        return np.concatenate([_native.moved_crop(p, _HERE, _ICP_RANGE_M) for p in parts])

    @once
    def storey(self) -> tuple[float, float]:
        """The lowest and the highest z of the query's storey [m]."""
        z = self._scene.surface[:, 2]
        if not len(z):
            return -np.inf, np.inf
        low, high = np.percentile(z[:: -(-len(z) // _MAX_HEIGHTS)], _HEIGHT_PERCENTILES)
        return float(low) - _STOREY_MARGIN_M, float(high) + _STOREY_MARGIN_M

    @once
    def _image(self) -> _native.VisibilityCheck:
        parts = self._scene.structure, self._scene.ground
        return _native.VisibilityCheck(*parts, VIEW_M, VIEW_DEG, SEEN_M)

    def seen(self, points: Float32, T_local_map: Pose) -> Count:
        """Count the (N, 3) map points that the query sees, of those and the violations."""
        seen, violations = self._image.count(points, T_local_map, SEEN_M, BEHIND_M)
        return Count(seen, seen + violations)


class MapCloud:
    """The map's own cloud, preprocessed for comparison with query clouds.

    Parameters
    ----------
    cloud : (N, 3) float32
        Cloud relative to ``origin``.
    origin : (3,) float64
        Origin of the cloud in map coordinates.
    separation : Separation
        Largest motion of a pose by ICP.
    threads : int
        0 is all cores; results do not depend on it.
    storeyed : bool
        True if the map has several storeys.
    path : (M, 3) float64
        Positions of the mapping sensor, in map coordinates.
    thicker_m : float
        By how much farther a point on a wall may be off, where walls of the map are thick [m].
    refine : bool
        Whether poses are aligned.
    """

    def __init__(
        self,
        cloud: Float32,
        origin: Float64,
        separation: Separation,
        threads: int,
        storeyed: bool,
        path: Float64,
        *,
        thicker_m: float = 0.0,
        refine: bool = True,
    ) -> None:
        self._origin, self._separation, self._refine = origin, separation, refine
        self._storeyed, self._path = storeyed, path - origin
        self._flush_m = _FLUSH_M + thicker_m
        self._aligner = aligner(threads)
        index = _native.PointIndex(cloud, max(_ROUGH_M, OVERLAP_M, RADIUS_M))
        self._target = Target(self._aligner.surface(cloud, target=True), index, CHANCE)
        self._nearby = NearbySearch(index, separation)
        self._close = close_surface(cloud, target=True)
        self._known = _native.KnownSpace(
            index,
            geometry.spaced(self._path, _VIEWPOINT_SPACING_M),
            VIEW_M,
            VIEW_DEG,
            BEHIND_M,
        )

    def query(self, scene: Segmentation) -> QueryCloud:
        """Preprocess a query cloud for comparison with this one."""
        return QueryCloud(scene, self._aligner)

    def rough_overlap(self, poses: Sequence[Pose], query: QueryCloud) -> list[float]:
        """Return the overlap at poses T_map_local before alignment, of some of the points.

        Each is measured once.
        """
        keys = [T.tobytes() for T in poses]
        fresh = [k for k, key in enumerate(keys) if key not in query.rough]
        if fresh:
            there = np.stack([self._relative(poses[k]) for k in fresh])
            overlap = self._target.index.overlap(query.few, there, _ROUGH_M, CHANCE)
            query.rough |= {keys[k]: float(o) for k, o in zip(fresh, overlap, strict=True)}
        return [query.rough[key] for key in keys]

    def next_view(self, T_one: Pose, T_other: Pose) -> NextView | None:
        """Return the shortest step that separates two poses T_map_sensor."""
        poses = self._relative(T_one), self._relative(T_other)
        return next_view(self._target.index, self._path, *poses)

    def around(self, T_map_local: Pose, query: QueryCloud) -> list[Pose]:
        """Return the poses at other places around one at which the clouds roughly fit."""
        T = self._relative(T_map_local)
        few = thinned(query.sample, _STOREY_SAMPLE)
        beside = self._nearby.around(query.sample, T)
        return [self._absolute(T) for T in (*beside, *self._nearby.storeys(few, T, _ROUGH_M))]

    def aligned(self, T_map_local: Pose, query: QueryCloud, known: Pose | None = None) -> Aligned:
        """Align some of a query's points from a pose; at the pose itself if ICP fails.

        An alignment that leaves the place of a ``known`` pose counts as failed, there.
        """
        T, _ = self._from(T_map_local, query, known, roughly=True)
        overlap = self._target.overlap(query.some, T, OVERLAP_M)
        return Aligned(self._absolute(T), overlap, self._seen(query, T))

    def measured(
        self,
        T_map_local: Pose,
        query: QueryCloud,
        known: Pose | None = None,
        *,
        align: bool = True,
    ) -> Observation:
        """Align a query from a pose, and compare it; at the pose itself if not, or if ICP fails.

        An alignment that leaves the place of a ``known`` pose counts as failed, there.
        """
        T, found = self._relative(T_map_local), None
        if align:
            T, found = self._from(T_map_local, query, known, roughly=False)
        covariance = None if found is None else ERRORS.widened(found.covariance)
        overlap, rmse = self._target.overlap_rmse(query.sample, T, OVERLAP_M)
        codes = self._known.codes(query.sample, T, OVERLAP_M)
        on_surface, walls = self._walls(query, T)
        level = self._target.surface.off_plane(query.surface, T, *_LEVEL, _MAX_SURFACE_POINTS)
        return Observation(
            T_map_local=self._absolute(T),
            overlap=overlap,
            seen=self._seen(query, T),
            rmse=rmse,
            covariance=covariance,
            known=Evidence(_number(codes, HIT), _number(codes, THROUGH, MISSED), len(codes)),
            inside=_inside(codes, query.patches),
            on_surface=on_surface,
            ground=_within(level, _GROUND_TOLERANCE_M),
            walls=walls,
            planes=query.planes,
        )

    def walls(self, T_map_local: Pose, query: QueryCloud) -> Walls:
        """Compare the walls of a query at a pose, where it is.

        Each is measured once.
        """
        T = self._relative(T_map_local)
        key = self._key(T)
        if key not in query.walls:
            query.walls[key] = self._walls(query, T)[1]
        return query.walls[key]

    def finest(self, fit: Observation, query: QueryCloud) -> Observation:
        """Return a fit, aligned as dense as the map if that tells more than one with open turns.

        In a room, voxels that suit a street mix the faces of what stands there, and a pose may lean
        by degrees. The covariances know; what they hardly allow is another pose.
        """
        if fit.covariance is None or _open_deg(fit.covariance) < _OPEN_DEG:
            return fit
        start = self._relative(fit.T_map_local)
        finer = self._aligner.align(self._close, query.dense, start)
        if finer is None or self._separation.apart(start, finer.T_target_source):
            return fit
        covariance = ERRORS.widened(finer.covariance)
        moved = geometry.displacement(start, finer.T_target_source)
        is_surer = _open_deg(covariance) < _open_deg(fit.covariance)
        if not (is_surer and geometry.allows(fit.covariance, moved)):
            return fit
        T_map_local = self._absolute(finer.T_target_source)
        return replace(fit, T_map_local=T_map_local, covariance=covariance)

    def _walls(self, query: QueryCloud, T: Pose) -> tuple[Count, Walls]:
        """Compare walls: their points, and the share of each patch that is explained."""
        surface, points, patch = query.close
        off = self._close.off_plane(surface, T, *_WALL, _MAX_SURFACE_POINTS)
        alone = np.flatnonzero(np.isinf(off))
        known = np.isfinite(off)
        codes = self._known.codes(points[alone], T, OVERLAP_M)
        known[alone[codes == THROUGH]] = True
        near, far = _EXPLAINED_M
        explained = np.clip((far - off[known]) / (far - near), 0.0, 1.0)
        count = int(patch.max(initial=-1)) + 1
        of = np.bincount(patch[known], minlength=count)
        share = np.bincount(patch[known], explained, minlength=count) / np.maximum(of, 1)
        weight = np.minimum(of / _SURE_PATCH, 1.0)
        walls = Walls(share.astype(np.float32), weight.astype(np.float32))
        return _within(off, self._flush_m), walls

    def _seen(self, query: QueryCloud, T: Pose) -> Count:
        """Count the map points in view that the query sees, and those compared.

        In a map with several storeys, points of other storeys are excluded.
        """
        x, y, z = T[:3, 3].tolist()
        low, high = -np.inf, np.inf
        if self._storeyed:
            low, high = (z + height for height in query.storey)
        points = self._target.index.sample(x, y, VIEW_M, _VIEW_POINTS, low, high)
        return query.seen(points, np.ascontiguousarray(geometry.inverse(T)))

    def _from(
        self, T_map_local: Pose, query: QueryCloud, known: Pose | None, *, roughly: bool
    ) -> tuple[Pose, Alignment | None]:
        """Return the pose that is aligned, relative to the origin, and its alignment, if any."""
        T = self._relative(T_map_local)
        found = self._alignment(T, query, roughly)
        if found is None:
            return T, None
        if known is not None:
            stay = self._relative(known)
            if self._separation.apart(stay, found.T_target_source):
                return stay, None
        return found.T_target_source, found

    def _alignment(self, T: Pose, query: QueryCloud, roughly: bool) -> Alignment | None:
        """Align the clouds; None if ICP fails or moves too far from T."""
        if not self._refine:
            return None
        key = self._key(T) + bytes([roughly])
        if key not in query.aligned:
            clouds = self._target.surface, query.surface
            query.aligned[key] = self._aligner.align(*clouds, T, roughly=roughly)
        found = query.aligned[key]
        if found is None or found.shift_m(T) > self._separation.metres:
            return None
        return found

    def _key(self, T: Pose) -> bytes:
        """Return the key of a pose relative to the origin, which differs between tiles."""
        return self._origin.tobytes() + T.tobytes()

    def _relative(self, T_map_local: Pose) -> Pose:
        return geometry.rigid(T_map_local[:3, :3], T_map_local[:3, 3] - self._origin)

    def _absolute(self, T: Pose) -> Pose:
        return geometry.rigid(T[:3, :3], T[:3, 3] + self._origin)


def aligner(threads: int) -> Aligner:
    """Return the aligner of queries with maps."""
    return Aligner(_ICP_VOXEL_M, _ICP_M, threads)


def patches(points: Float32, side_m: float) -> Int64:
    """Number the cubes that hold points, (N, 3): the cube of each, (N,)."""
    x, y, z = np.floor(points / side_m).astype(np.int64).T
    # One key a cube, in the order of x, y and z: rows take NumPy ten times as long.
    _, patch = np.unique((x << 42) + (y << 21) + z, return_inverse=True)
    return patch.reshape(-1)


def _on_planes(surface: _native.Surface) -> Count:
    """Count the points of a surface on its widest planes: those of some of its normals."""
    points = surface.sampled(_MAX_SURFACE_POINTS)
    normals = surface.sampled_normals(_MAX_SURFACE_POINTS)
    some = points[:: 1 + len(points) // _PLANE_POINTS].astype(np.float64)
    flat = np.flatnonzero(normals.any(axis=1))
    flat = flat[:: 1 + len(flat) // _MAX_PLANES]
    # Not by BLAS, whose rounding depends on its threads.
    off = np.einsum("ni,ki->nk", some, normals[flat])
    off -= np.einsum("ki,ki->k", points[flat], normals[flat])
    near, on = np.abs(off) < _FLUSH_M, np.zeros(len(some), bool)
    for _ in range(_PLANES if len(flat) else 0):
        on |= near[:, (near & ~on[:, None]).sum(axis=0).argmax()]
    return Count(int(on.sum()), len(some))


def _inside(codes: np.ndarray, patch: Int64) -> Count:
    """Count the patches most of which is in free space."""
    count = int(patch.max(initial=-1)) + 1
    through, of = np.bincount(patch[codes == THROUGH], minlength=count), np.bincount(patch)
    return Count(int((2 * through > of).sum()), count)


def _within(off: Float32, metres: float) -> Count:
    """Count the points nearer to a surface than so, of those with one near."""
    return Count(int((off < metres).sum()), int(np.isfinite(off).sum()))


def _open_deg(covariance: Float64) -> float:
    """Return the standard deviation of the rotation of a (6, 6) covariance [deg]."""
    return float(np.degrees(np.sqrt(np.trace(covariance[:3, :3]))))


def _number(codes: np.ndarray, *chosen: int) -> int:
    return sum(int(np.count_nonzero(codes == code)) for code in chosen)


def close_surface(points: Float32, *, target: bool = False) -> _native.Surface:
    """Return the surface of a cloud (N, 3) as dense as a map; its planes are accurate to cm.

    One that is only a target is tiled.
    """
    return _native.Surface(np.ascontiguousarray(points), _CLOSE_M, _SUPPORT_M, target)
