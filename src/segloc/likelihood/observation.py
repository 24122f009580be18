"""Comparison of a query cloud with the map at a pose.

Overlap is the share of the query that lies on the map. Visibility is the share of the map in view
that the query sees. A map point violates free space if the sensor measured a surface well behind
it, in its direction and in all directions around it (G. Kim, A. Kim, "Remove, then Revert: Static
Point Cloud Map Construction using Multiresolution Range Images", IROS 2020). Intrusion is the
reverse: the query occupies space that the mapping sensor measured as free. Similar rooms differ by
decimetres, which the share of wall points on the map's surfaces separates. Hedges and rows of trees
may fit elsewhere, but their ground does not.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from .. import _native, geometry
from ..frontend.segmentation import Segmentation
from ..geometry import Separation
from ..localization import NextView
from ..types import Candidate, Float32, Float64, Pose
from .config import VerificationConfig
from .nearby import NearbySearch, Surroundings
from .next_view import next_view
from .registration import ERRORS, Aligner, Registered, Target, thinned

_RANKING_SAMPLE, _RANKING_PRIOR = 300, 30.0
"""Map points compared in the ranking, and the overlap's weight in such points."""
_RANKED_FIRST = 4
"""Number of candidates in their exact order."""
_STILL_M, _MOST_AGAIN = 1.0, 2
"""Shift beyond which an alignment is repeated from its result, and the most repetitions."""
_STOREY_SAMPLE = 200
"""Points of a query in the search for other storeys."""
_CLOSE_VOXEL_M = 0.3
"""Voxel size of a query's close surface: that of maps."""

_HERE = np.eye(4)
_HEIGHT_PERCENTILES, _MAX_HEIGHTS = (1.0, 99.0), 4000
"""Percentiles that bound the heights of a query, and the most points used."""
_STOREY_MARGIN_M = 1.0
"""Map points within this above or below these heights are on the query's storey."""
_VIEWPOINT_RADIUS_M, _VIEWPOINT_SPACING_M, _MAX_VIEWPOINTS = 12.0, 3.0, 8
"""Radius and spacing of viewpoints on the trajectory, and their largest number."""
_MAX_VIEWPOINT_HEIGHT_M = 1.5
"""Height difference beyond which a viewpoint is on another storey."""
_POINT_HALF_WIDTH_M = 0.2
"""Half width of a map point: without it, walls near the trajectory would have holes."""
_MAX_WALL_NORMAL_Z, _MIN_GROUND_NORMAL_Z = 0.3, 0.9
_MAX_SURFACE_POINTS = 2000
"""Most points of walls or of the ground compared."""
_GROUND_TOLERANCE_M = 0.2
_CLOSE_M, _SUPPORT_M = 1.0, 0.75
"""Radii of close surfaces: to the nearest point, and to the points of its plane."""


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


DOUBTFUL = Count(40, 2000)
"""Assumed occupied free space if it is not measured."""


@dataclass(frozen=True)
class RankedCandidate:
    """A candidate with the overlap of the clouds at its pose.

    Attributes
    ----------
    candidate : Candidate
    overlap : float
        Share of the query cloud with a map point within the coarse radius, in [0, 1]; points above
        the map's height there are excluded.
    seen : float
        For candidates from clouds: share of the map in view that the query sees; 1 if not measured,
        since the candidate cannot rank high.
    """

    candidate: Candidate
    overlap: float
    seen: float = 1.0

    @property
    def T_map_local(self) -> Pose:
        """(4, 4) float64."""
        return self.candidate.T_map_local

    @property
    def inliers(self) -> int:
        """Distinct query segments that agree with the pose."""
        return self.candidate.inliers


class Observation:
    """Fit of a query at a pose after alignment with the map.

    Attributes
    ----------
    T_map_local : (4, 4) float64
    inliers : int
        Number of distinct query segments that agree with the pose (one map segment each); 0 until
        counted.
    overlap : float
        Share of the query cloud with a map point nearby, in [0, 1]; points above the map's height
        there are excluded.
    seen : Count
        Map points in view with a query point nearby; the others are free-space violations.
    rmse : float
        Root mean square distance of the pairs of the overlap [m].
    covariance : (6, 6) float64 or None
        Covariance of rotation [rad], then translation [m], in the local frame. None if ICP failed.

    flush, ground, intruding : Count
        Wall points on the map's surfaces, of those near them; ground points on the map's ground;
        structure points in free space of the map. Measured on first use, since they cost more; see
        :meth:`has`.
    """

    flush: Count
    ground: Count
    intruding: Count

    def __init__(
        self,
        T_map_local: Pose,
        overlap: float,
        seen: Count,
        rmse: float,
        covariance: Float64 | None,
        compared: Compared,
    ) -> None:
        self.T_map_local, self.inliers, self.overlap = T_map_local, 0, overlap
        self.seen, self.rmse, self.covariance = seen, rmse, covariance
        self._compared = compared

    def has(self, name: str) -> bool:
        """Return whether ``flush``, ``ground`` or ``intruding`` was measured."""
        return name in self.__dict__

    def __getattr__(self, name: str) -> Count:
        # Not functools.cached_property: before Python 3.12 its lock is shared by all instances,
        # and a fork while another thread holds it hangs.
        if name not in ("flush", "ground", "intruding"):
            raise AttributeError(name)
        measured: Count = getattr(self._compared, name)()
        setattr(self, name, measured)
        return measured


class QueryCloud:
    """A query cloud, preprocessed for comparison with a map at several poses.

    Attributes
    ----------
    sample : (N, 3) float32
        Points of the overlap.
    aligned : dict
        Alignments so far, by their start.
    rough : dict
        Rough overlaps so far, by pose.
    """

    def __init__(self, scene: Segmentation, config: VerificationConfig, aligner: Aligner) -> None:
        self.sample = thinned(scene.structure, config.overlap_sample)
        self.aligned: dict[bytes, Registered | None] = {}
        self.rough: dict[bytes, float] = {}
        self._scene, self._config, self._aligner = scene, config, aligner
        self._view: QueryView | None = None
        self._surface: _native.Surface | None = None
        self._close_surface: _native.Surface | None = None

    @property
    def view(self) -> QueryView:
        """Range image of the sensor's view; built once."""
        if self._view is None:
            self._view = QueryView(self._scene, self._config)
        return self._view

    @property
    def surface(self) -> _native.Surface:
        """Surface for alignment; built once."""
        if self._surface is None:
            scene, radius = self._scene, self._config.icp_radius
            near = [_native.moved_crop(p, _HERE, radius) for p in (scene.structure, scene.ground)]
            self._surface = self._aligner.surface(np.concatenate(near))
        return self._surface

    @property
    def close_surface(self) -> _native.Surface:
        """Surface of the structure, as dense as a map; built once."""
        if self._close_surface is None:
            near = _native.moved_crop(self._scene.structure, _HERE, self._config.icp_radius)
            self._close_surface = close_surface(_native.voxel_grid(near, _CLOSE_VOXEL_M))
        return self._close_surface


class MapCloud:
    """The map's own cloud, preprocessed for comparison with query clouds.

    Parameters
    ----------
    cloud : (N, 3) float32
        Cloud relative to ``origin``.
    origin : (3,) float64
        Origin of the cloud in map coordinates.
    config : VerificationConfig
    separation : Separation
        Largest motion of a pose by ICP.
    threads : int
        0 is all cores; results do not depend on it.
    storeyed : bool
        True if the map has several storeys.
    path : (M, 3) float64
        Positions of the mapping sensor, in map coordinates.

    Attributes
    ----------
    storeyed : bool
        True if the map has several storeys.
    """

    def __init__(
        self,
        cloud: Float32,
        origin: Float64,
        config: VerificationConfig,
        separation: Separation,
        threads: int,
        storeyed: bool,
        path: Float64,
    ) -> None:
        self._config, self._origin, self._separation = config, origin, separation
        self.storeyed, self._path = storeyed, path - origin
        self._aligner = Aligner(config.icp_voxel, config.icp_max_correspondence, threads)
        index = _native.PointIndex(cloud, max(config.coarse_radius, config.overlap_radius))
        self._target = Target(
            self._aligner.surface(cloud, target=True), index, config.unmapped_overlap
        )
        self._nearby = NearbySearch(index, config.nearby, separation)
        self._compared = ComparedMap(self._target, close_surface(cloud, target=True), self._path)

    def query(self, scene: Segmentation) -> QueryCloud:
        """Preprocess a query cloud for comparison with this one."""
        return QueryCloud(scene, self._config, self._aligner)

    def ranked(self, candidates: Sequence[Candidate], query: QueryCloud) -> list[RankedCandidate]:
        """Return the candidates with their rough overlap, in their order.

        Visibility takes time, and only lowers the rank. Of candidates from clouds it is measured if
        they may be among the first.
        """
        keys = [c.T_map_local.tobytes() for c in candidates]
        fresh = [k for k, key in enumerate(keys) if key not in query.rough]
        if fresh:
            poses = np.stack([self._relative(candidates[k].T_map_local) for k in fresh])
            few = thinned(query.sample, self._config.coarse_sample)
            overlap = self._target.index.overlap(
                few, poses, self._config.coarse_radius, self._config.unmapped_overlap
            )
            query.rough |= {keys[k]: float(o) for k, o in zip(fresh, overlap, strict=True)}
        ranked = [
            RankedCandidate(c, query.rough[key]) for c, key in zip(candidates, keys, strict=True)
        ]
        heap = [(-c.overlap, k) for k, c in enumerate(ranked) if c.candidate.fit is not None]
        heapq.heapify(heap)
        measured = set[int]()
        firsts = 0
        while heap and firsts < _RANKED_FIRST:
            _, k = heapq.heappop(heap)
            if k in measured:
                firsts += 1
                continue
            measured.add(k)
            ranked[k] = replace(ranked[k], seen=self._seen(ranked[k], query))
            heapq.heappush(heap, (-ranked[k].overlap * ranked[k].seen, k))
        return ranked

    def _seen(self, ranked: RankedCandidate, query: QueryCloud) -> float:
        """Return the visibility of a candidate from clouds; many overlap in sparse parts."""
        config, T = self._config, self._relative(ranked.T_map_local)
        seen = self._visible(query, T, config.coarse_radius, _RANKING_SAMPLE)
        return (seen.hits + _RANKING_PRIOR * ranked.overlap) / (seen.of + _RANKING_PRIOR)

    def next_view(self, T_one: Pose, T_other: Pose) -> NextView | None:
        """Return the shortest step that separates two poses T_map_sensor."""
        poses = self._relative(T_one), self._relative(T_other)
        return next_view(self._target.index, self._path, *poses)

    def around(self, T_map_local: Pose, query: QueryCloud) -> Surroundings:
        """Return the poses around one at which the clouds roughly fit."""
        T, config = self._relative(T_map_local), self._config
        found = self._nearby.around(query.sample, T)
        few = thinned(query.sample, _STOREY_SAMPLE)
        others = self._nearby.storeys(few, found.start, config.coarse_radius)
        return Surroundings(
            self._absolute(found.start), [self._absolute(T) for T in [*found.rivals, *others]]
        )

    def refined(
        self,
        T_map_local: Pose,
        query: QueryCloud,
        start: Pose | None = None,
        *,
        roughly: bool = True,
    ) -> Observation:
        """Measure a query at the best alignment near a pose, or at the pose if ICP fails.

        ICP starts from the pose, and from ``start`` if it differs; ``roughly`` uses some of the
        points.
        """
        T = self._relative(T_map_local)
        begin = None if start is None else self._relative(start)
        return self._observed(T, self._best(T, begin, query, roughly), query)

    def finished(self, fit: Observation, query: QueryCloud) -> Observation:
        """Refine a candidate by ICP with all points."""
        T = self._relative(fit.T_map_local)
        found = self._registered(T, T, query, roughly=False)
        if found is None:
            return fit
        finished = self._observed(T, found, query)
        finished.inliers = fit.inliers
        return finished

    def mapped(self, fit: Observation, query: QueryCloud) -> float:
        """Return the share of a query's structure with any map points around it, in [0, 1]."""
        T, radius = self._relative(fit.T_map_local)[None], self._config.overlap_radius
        none = self._target.index.overlap(query.sample, T, radius, 0.0)
        most = self._target.index.overlap(query.sample, T, radius, 1.0)
        return 1.0 - float(most[0] - none[0])

    def _observed(self, T: Pose, found: Registered | None, query: QueryCloud) -> Observation:
        """Measure the fit at T, or at its alignment."""
        config = self._config
        covariance: Float64 | None = None
        if found is None:
            overlap, rmse = self._target.overlap(query.sample, T, config.overlap_radius)
        else:
            T, covariance = found.T_target_source, ERRORS.widened(found.covariance)
            overlap, rmse = found.overlap, found.rmse
        seen = self._visible(query, T, config.seen_radius, config.visibility_sample)
        compared = Compared(self._compared, query, T, config)
        return Observation(self._absolute(T), overlap, seen, rmse, covariance, compared)

    def _visible(self, query: QueryCloud, T: Pose, radius: float, sample: int) -> Count:
        """Count the map points in view that the query sees, and those compared.

        In a map with several storeys, points of other storeys are excluded.
        """
        x, y, z = T[:3, 3].tolist()
        low, high = -np.inf, np.inf
        if self.storeyed:
            low, high = (z + height for height in query.view.storey())
        range_m = self._config.visibility_range
        points = self._target.index.sample(x, y, range_m, sample, low, high)
        return query.view.count(points, np.ascontiguousarray(geometry.inverse(T)), radius)

    def _best(
        self, T: Pose, start: Pose | None, query: QueryCloud, roughly: bool
    ) -> Registered | None:
        """Return the better of two alignments, repeated until it converges."""
        found = self._registered(T, T, query, roughly)
        if start is not None and not np.array_equal(start, T):
            other = self._registered(start, T, query, roughly)
            if other is not None and (found is None or other.overlap > found.overlap):
                found = other
        for _ in range(_MOST_AGAIN):
            if found is None or found.shift_m < _STILL_M:
                break
            again = self._registered(found.T_target_source, T, query, roughly)
            if again is None or again.overlap <= found.overlap:
                break
            found = again
        return found

    def _registered(
        self, start: Pose, T: Pose, query: QueryCloud, roughly: bool
    ) -> Registered | None:
        """Align the clouds; None if ICP fails or moves too far from T."""
        if not self._config.refine:
            return None
        key = start.tobytes() + bytes([roughly])
        if key not in query.aligned:
            radius = self._config.overlap_radius
            query.aligned[key] = self._aligner.register(
                self._target, query, start, radius, roughly=roughly
            )
        found = query.aligned[key]
        if found is None:
            return None
        metres = float(np.linalg.norm(found.T_target_source[:3, 3] - T[:3, 3]))
        return None if metres > self._separation.metres else found

    def _relative(self, T_map_local: Pose) -> Pose:
        return geometry.rigid(T_map_local[:3, :3], T_map_local[:3, 3] - self._origin)

    def _absolute(self, T: Pose) -> Pose:
        return geometry.rigid(T[:3, :3], T[:3, 3] + self._origin)


@dataclass(frozen=True)
class ComparedMap:
    """Map side of the comparison.

    Attributes
    ----------
    target : Target
        Cloud of the map.
    close : Surface
        Its surface, from :func:`close_surface`.
    path : (M, 3) float64
        Positions of the mapping sensor, in the frame of the cloud.
    """

    target: Target
    close: _native.Surface
    path: Float64


class Compared:
    """Compares walls, ground and free space at a pose.

    Parameters
    ----------
    compared : ComparedMap
    query : QueryCloud
    T : (4, 4) float64
        Transforms the query to the frame of the map's cloud.
    config : VerificationConfig
    """

    def __init__(
        self, compared: ComparedMap, query: QueryCloud, T: Pose, config: VerificationConfig
    ) -> None:
        self._map, self._query, self._T, self._config = compared, query, T, config

    def ground(self) -> Count:
        """Count the ground points that lie on the map's ground."""
        return ground_count(self._map.target.surface, self._query.surface, self._T)

    def flush(self) -> Count:
        """Count the wall points on the map's surfaces, of those near them."""
        source, offset = self._query.close_surface, self._config.flush_offset
        return flush_count(self._map.close, source, self._T, offset)

    def intruding(self) -> Count:
        """Count the structure points in free space of the map, of those with known occupancy.

        Without measured free space it is :data:`DOUBTFUL`.
        """
        if not len(self._map.path):
            return DOUBTFUL
        index, sample = self._map.target.index, self._query.sample
        return intruding_count(index, sample, self._T, self._map.path, self._config)


class QueryView:
    """Range image of a sensor's view, around the local frame's origin."""

    def __init__(self, scene: Segmentation, config: VerificationConfig) -> None:
        radius = max(config.seen_radius, config.coarse_radius)
        self._scene, self._margin = scene, config.visibility_margin
        self._storey: tuple[float, float] | None = None
        self._image = _native.VisibilityCheck(
            scene.structure, scene.ground, config.visibility_range, config.visibility_bin, radius
        )

    def storey(self) -> tuple[float, float]:
        """Return the lowest and the highest z of the query's storey [m]."""
        if self._storey is None:
            z = np.concatenate([self._scene.structure[:, 2], self._scene.ground[:, 2]])
            if not len(z):
                return -np.inf, np.inf
            low, high = np.percentile(z[:: -(-len(z) // _MAX_HEIGHTS)], _HEIGHT_PERCENTILES)
            self._storey = float(low) - _STOREY_MARGIN_M, float(high) + _STOREY_MARGIN_M
        return self._storey

    def count(self, points: Float32, T_local_map: Pose, radius: float) -> Count:
        """Count the (N, 3) map points that are seen, and those that are seen or violate free
        space."""
        seen, violations = self._image.count(points, T_local_map, radius, self._margin)
        return Count(seen, seen + violations)


def viewpoints(path: Float64, at: Float64) -> Float64:
    """Return the trajectory positions, (V, 3) of (M, 3), with known free space around ``at``."""
    off = path - at
    near = (np.hypot(off[:, 0], off[:, 1]) < _VIEWPOINT_RADIUS_M) & (
        np.abs(off[:, 2]) < _MAX_VIEWPOINT_HEIGHT_M
    )
    chosen: list[Float64] = []
    for p in path[near][np.argsort(np.hypot(*off[near, :2].T), kind="stable")]:
        if len(chosen) == _MAX_VIEWPOINTS:
            break
        if all(np.linalg.norm(p - other) > _VIEWPOINT_SPACING_M for other in chosen):
            chosen.append(p)
    return np.array(chosen).reshape(-1, 3)


def intruding_count(
    index: _native.PointIndex, sample: Float32, T: Pose, path: Float64, config: VerificationConfig
) -> Count:
    """Count the points of a query's structure that occupy free space of the map.

    Parameters
    ----------
    index : PointIndex
        Index of the map's cloud.
    sample : (N, 3) float32
        Structure points around the sensor.
    T : (4, 4) float64
        Transforms them to the frame of the map's cloud.
    path : (M, 3) float64
        Positions of the mapping sensor, in the same frame.
    config : VerificationConfig
    """
    used, intruding = index.intrusion(
        sample,
        T,
        viewpoints(path, T[:3, 3]),
        config.visibility_range,
        config.visibility_bin,
        config.coarse_radius,
        config.visibility_margin,
        _POINT_HALF_WIDTH_M,
    )
    return Count(intruding, used)


def close_surface(points: Float32, *, target: bool = False) -> _native.Surface:
    """Return the surface of a cloud (N, 3) as dense as a map; its planes are accurate to cm.

    One that is only a target is tiled.
    """
    return _native.Surface(np.ascontiguousarray(points), _CLOSE_M, _SUPPORT_M, target)


def flush_count(target: _native.Surface, source: _native.Surface, T: Pose, offset: float) -> Count:
    """Count a query's wall points on a surface of the map, of those near one.

    Points without a map point nearby count in the overlap instead: they may be above the map.

    Parameters
    ----------
    target, source : Surface
        Surfaces of the map and of the query, from :func:`close_surface`.
    T : (4, 4) float64
        Transforms the source to the target.
    offset : float
        Largest distance of a point from its plane [m].
    """
    wall = -1.0, _MAX_WALL_NORMAL_Z
    return Count(*target.on_plane(source, T, *wall, offset, _MAX_SURFACE_POINTS))


def ground_count(target: _native.Surface, source: _native.Surface, T: Pose) -> Count:
    """Count a query's ground points on the ground of the map, of those near a surface.

    Parameters
    ----------
    target, source : Surface
        Surfaces of the map and of the query.
    T : (4, 4) float64
        Transforms the source to the target.
    """
    level = _MIN_GROUND_NORMAL_Z, 2.0
    return Count(*target.on_plane(source, T, *level, _GROUND_TOLERANCE_M, _MAX_SURFACE_POINTS))
