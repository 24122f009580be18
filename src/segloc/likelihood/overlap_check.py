"""How much of a query cloud lies on the map at a pose, and the pose at which it fits best."""

from __future__ import annotations

import heapq
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from .. import _native, geometry
from ..frontend.segmentation import Segmentation
from ..geometry import Separation
from ..types import Candidate, Float32, Float64, Pose
from .config import VerificationConfig
from .details import ComparedMap, MeasuredDetails
from .evidence import SQUARE_M, CoarseScore, RankedCandidate, RefinedScore
from .free_space_check import QueryView, judged
from .nearby import NearbySearch, Surroundings
from .registration import Aligner, Registered, Target, thinned
from .walls import close_surface

_RANKING_SAMPLE, _RANKING_PRIOR = 300, 30.0
"""Map points that are judged while candidates are ranked; the overlap counts as so many of them."""
_RANKED_FIRST = 4
"""So many of the candidates are put in their exact order."""
_STILL_M, _MOST_AGAIN = 1.0, 2
"""An alignment that moved farther may not have ended where it would: it is begun anew from there,
at most so often."""
_STOREY_SAMPLE = 200
"""Points of the query that other storeys are looked for with."""
_CLOSE_VOXEL_M = 0.3
"""A query's walls are thinned to this, as maps are."""

_HERE = np.eye(4)


class QueryCloud:
    """A query cloud, made ready to be compared with a map at several poses.

    Attributes
    ----------
    sample : (N, 3) float32
        What overlap is computed from.
    aligned : dict
        The alignments with the map so far, by where they set out from.
    """

    def __init__(self, scene: Segmentation, config: VerificationConfig, aligner: Aligner) -> None:
        self.sample = thinned(scene.structure, config.overlap_sample)
        self.aligned: dict[bytes, Registered | None] = {}
        self._scene, self._config, self._aligner = scene, config, aligner
        self._extent: int | None = None
        self._view: QueryView | None = None
        self._surface: _native.Surface | None = None
        self._close_surface: _native.Surface | None = None

    @property
    def extent(self) -> int:
        """On how many squares, within the range that is judged, something stands; counted once."""
        if self._extent is None:
            self._extent = _squares(self._scene.structure, self._config.visibility_range)
        return self._extent

    @property
    def view(self) -> QueryView:
        """What the sensor saw, direction by direction; made once."""
        if self._view is None:
            self._view = QueryView(self._scene, self._config)
        return self._view

    @property
    def surface(self) -> _native.Surface:
        """What is aligned; made once."""
        if self._surface is None:
            scene, radius = self._scene, self._config.icp_radius
            near = [_native.moved_crop(p, _HERE, radius) for p in (scene.structure, scene.ground)]
            self._surface = self._aligner.surface(np.concatenate(near))
        return self._surface

    @property
    def close_surface(self) -> _native.Surface:
        """What stands, as densely as a map has it; made once."""
        if self._close_surface is None:
            near = _native.moved_crop(self._scene.structure, _HERE, self._config.icp_radius)
            self._close_surface = close_surface(_native.voxel_grid(near, _CLOSE_VOXEL_M))
        return self._close_surface


class MapCloud:
    """The map's own cloud, made ready to be compared with query clouds.

    Parameters
    ----------
    cloud : (N, 3) float32
        Relative to ``origin``.
    origin : (3,) float64
        Added to the cloud it gives map coordinates.
    config : VerificationConfig
    separation : Separation
        ICP that moves a pose farther has run away.
    threads : int
        0: all cores. No result depends on it.
    storeyed : bool
        Whether the map has several storeys.
    path : (M, 3) float64
        Where the sensor was when the map was made, in map coordinates.

    Attributes
    ----------
    storeyed : bool
        As given.
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
        self._target = Target(self._aligner.surface(cloud), index, config.unmapped_overlap)
        self._nearby = NearbySearch(index, config.nearby, separation)
        self._compared = ComparedMap(self._target, close_surface(cloud), self._path)

    def query(self, scene: Segmentation) -> QueryCloud:
        """A query cloud to compare with this one."""
        return QueryCloud(scene, self._config, self._aligner)

    def ranked(self, candidates: Sequence[Candidate], query: QueryCloud) -> list[RankedCandidate]:
        """The candidates with their rough overlap, the best supported first."""
        poses = np.stack([self._relative(c.T_map_local) for c in candidates])
        few = thinned(query.sample, self._config.coarse_sample)
        overlap, rmse = self._target.index.overlap(
            few, poses, self._config.coarse_radius, self._config.unmapped_overlap
        )
        ranked = [
            RankedCandidate(c, float(o), float(r))
            for c, o, r in zip(candidates, overlap, rmse, strict=True)
        ]
        return self._ordered(ranked, query)

    def _ordered(self, ranked: list[RankedCandidate], query: QueryCloud) -> list[RankedCandidate]:
        """The best supported first. What is seen takes time, and lowers the support: it is measured
        only of those that may be among the first."""
        heap = [(-c.support, k, c.candidate.fit is None, c) for k, c in enumerate(ranked)]
        heapq.heapify(heap)
        first: list[RankedCandidate] = []
        while heap and len(first) < _RANKED_FIRST:
            _, k, known, best = heapq.heappop(heap)
            if known:
                first.append(best)
            else:
                best = replace(best, seen=self._seen(best, query))
                heapq.heappush(heap, (-best.support, k, True, best))
        return first + [rest for *_, rest in sorted(heap)]

    def _seen(self, ranked: RankedCandidate, query: QueryCloud) -> float:
        """What ranks candidates of the clouds alone, of which many overlap where little stands."""
        config, T = self._config, self._relative(ranked.T_map_local)
        confirmed, all_judged = self._judged(query, T, config.coarse_radius, _RANKING_SAMPLE)
        return (confirmed + _RANKING_PRIOR * ranked.overlap) / (all_judged + _RANKING_PRIOR)

    def coarse(self, ranked: RankedCandidate, query: QueryCloud) -> CoarseScore:
        """A candidate where it stands, with the share of the map that is roughly seen there."""
        config, T = self._config, self._relative(ranked.T_map_local)
        seen = self._judged(query, T, config.coarse_radius, config.coarse_visibility_sample)
        return CoarseScore(ranked.T_map_local, ranked.inliers, ranked.overlap, *seen, ranked.rmse)

    def off_path(self, T_map_local: Pose) -> float | None:
        """How far a pose is from the path of the map, seen from above, metres; None without one."""
        if not len(self._path):
            return None
        at = T_map_local[:2, 3] - self._origin[:2]
        return float(np.hypot(*(self._path[:, :2] - at).T).min())

    def around(self, T_map_local: Pose, query: QueryCloud) -> Surroundings:
        """Poses around one at which the clouds roughly fit."""
        T, config = self._relative(T_map_local), self._config
        found = self._nearby.around(query.sample, T)
        few = thinned(query.sample, _STOREY_SAMPLE)
        others = self._nearby.storeys(few, found.start, config.coarse_radius)
        return Surroundings(
            self._absolute(found.start), [self._absolute(T) for T in [*found.rivals, *others]]
        )

    def refined(
        self, candidate: Candidate, query: QueryCloud, start: Pose | None = None
    ) -> RefinedScore:
        """A candidate at the pose where the clouds fit best; at its own where they do not.

        ICP of some of the points sets out from the candidate's pose, and from ``start`` if it is
        another.
        """
        T = self._relative(candidate.T_map_local)
        found = self._best(T, None if start is None else self._relative(start), query)
        return self._score(T, candidate.inliers, found, query)

    def finished(self, score: RefinedScore, query: QueryCloud) -> RefinedScore:
        """A refined candidate after ICP of all points."""
        T = self._relative(score.T_map_local)
        found = self._registered(T, T, query, roughly=False)
        return score if found is None else self._score(T, score.inliers, found, query)

    def _score(
        self, T: Pose, inliers: int, found: Registered | None, query: QueryCloud
    ) -> RefinedScore:
        """What is measured at T, or where it was aligned to."""
        config = self._config
        covariance: Float64 | None = None
        if found is None:
            overlap, rmse = self._target.overlap(query.sample, T, config.overlap_radius)
        else:
            T, covariance = found.T_target_source, found.covariance
            overlap, rmse = found.overlap, found.rmse
        seen = self._judged(query, T, config.seen_radius, config.visibility_sample)
        details = MeasuredDetails(self._compared, query, T, config)
        return RefinedScore(self._absolute(T), inliers, overlap, *seen, rmse, covariance, details)

    def _judged(self, query: QueryCloud, T: Pose, radius: float, sample: int) -> tuple[int, int]:
        range_m = self._config.visibility_range
        index, storeyed = self._target.index, self.storeyed
        return judged(index, query.view, T, radius, range_m, sample, storeyed)

    def _best(self, T: Pose, start: Pose | None, query: QueryCloud) -> Registered | None:
        """The better of two alignments, which goes on until it holds still."""
        found = self._registered(T, T, query)
        if start is not None and not np.array_equal(start, T):
            other = self._registered(start, T, query)
            if other is not None and (found is None or other.overlap > found.overlap):
                found = other
        for _ in range(_MOST_AGAIN):
            if found is None or found.shift_m < _STILL_M:
                break
            again = self._registered(found.T_target_source, T, query)
            if again is None or again.overlap <= found.overlap:
                break
            found = again
        return found

    def _registered(
        self, start: Pose, T: Pose, query: QueryCloud, *, roughly: bool = True
    ) -> Registered | None:
        """Where the clouds fit best; None where they do not, or ICP has run away from T."""
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


def _squares(points: Float32, range_m: float) -> int:
    """On how many squares of a grid about the sensor the points within a range lie."""
    near = points[np.hypot(points[:, 0], points[:, 1]) < range_m]
    x, y = (np.floor(near[:, axis] / SQUARE_M).astype(np.int64) for axis in (0, 1))
    half = int(np.ceil(range_m / SQUARE_M))
    return int(np.count_nonzero(np.bincount(2 * half * (y + half) + x + half)))
