"""How much of a query cloud lies on the map at a pose, and the pose at which it fits best."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .. import _native, geometry
from ..geometry import Separation
from ..registration import Aligner, Registered, Target, thinned
from ..segmentation import Segmentation
from ..types import Candidate, Float32, Float64, Pose
from .config import VerificationConfig
from .evidence import CoarseScore, RankedCandidate, RefinedScore
from .free_space_check import QueryView, seen_share


class QueryCloud:
    """A query cloud, made ready to be compared with a map at several poses."""

    def __init__(self, scene: Segmentation, config: VerificationConfig, aligner: Aligner) -> None:
        self.sample = thinned(scene.structure, config.overlap_sample)
        self._scene, self._config, self._aligner = scene, config, aligner
        self._view: QueryView | None = None
        self._surface: _native.Surface | None = None

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
            points = self._scene.surface
            near = (points[:, :2] ** 2).sum(axis=1) < self._config.icp_radius**2
            self._surface = self._aligner.surface(points[near])
        return self._surface


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
    """

    def __init__(
        self,
        cloud: Float32,
        origin: Float64,
        config: VerificationConfig,
        separation: Separation,
        threads: int,
    ) -> None:
        self._config, self._origin, self._separation = config, origin, separation
        self._aligner = Aligner(config.icp_voxel, config.icp_max_correspondence, threads)
        index = _native.PointIndex(cloud, max(config.coarse_radius, config.overlap_radius))
        self._target = Target(self._aligner.surface(cloud), index)

    def query(self, scene: Segmentation) -> QueryCloud:
        """A query cloud to compare with this one."""
        return QueryCloud(scene, self._config, self._aligner)

    def ranked(self, candidates: Sequence[Candidate], query: QueryCloud) -> list[RankedCandidate]:
        """The candidates with their rough overlap, the best supported first."""
        poses = np.stack([self._relative(c.T_map_local) for c in candidates])
        few = thinned(query.sample, self._config.coarse_sample)
        overlap, rmse = self._target.index.overlap(few, poses, self._config.coarse_radius)
        ranked = [
            RankedCandidate(c, float(o), float(r))
            for c, o, r in zip(candidates, overlap, rmse, strict=True)
        ]
        return sorted(ranked, key=lambda each: each.support, reverse=True)

    def coarse(self, ranked: RankedCandidate, query: QueryCloud) -> CoarseScore:
        """A candidate where it stands, with the share of the map that is roughly seen there."""
        T = self._relative(ranked.T_map_local)
        seen = seen_share(
            self._target.index, query.view, T, self._config.coarse_radius, self._config
        )
        return CoarseScore(ranked.T_map_local, ranked.inliers, ranked.overlap, seen, ranked.rmse)

    def refined(self, candidate: Candidate, query: QueryCloud) -> RefinedScore:
        """A candidate at the pose where the clouds fit best; at its own where they do not."""
        config, T = self._config, self._relative(candidate.T_map_local)
        covariance: Float64 | None = None
        found = self._registered(T, query)
        if found is None:
            overlap, rmse = self._target.overlap(query.sample, T, config.overlap_radius)
        else:
            T, covariance = found.T_target_source, found.covariance
            overlap, rmse = found.overlap, found.rmse
        return RefinedScore(
            T_map_local=geometry.rigid(T[:3, :3], T[:3, 3] + self._origin),
            inliers=candidate.inliers,
            overlap=overlap,
            seen=seen_share(self._target.index, query.view, T, config.seen_radius, config),
            rmse=rmse,
            covariance=covariance,
        )

    def _registered(self, T: Pose, query: QueryCloud) -> Registered | None:
        """Where the clouds fit best; None where they do not, or ICP has run away."""
        if not self._config.refine:
            return None
        found = self._aligner.register(self._target, query, T, self._config.overlap_radius)
        return None if found is None or found.shift_m > self._separation.metres else found

    def _relative(self, T_map_local: Pose) -> Pose:
        return geometry.rigid(T_map_local[:3, :3], T_map_local[:3, 3] - self._origin)
