"""How well a live cloud and the map's agree at a pose, and the pose at which they agree best."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from .. import _native, geometry
from ..registration import Aligner
from ..segmentation import Segmentation
from ..types import Float32, Float64, Hypothesis, Pose

if TYPE_CHECKING:
    from .verifier import VerificationConfig

MIN_SIGHTED = 150
"""Fewer points of the map in view say too little: a single bush or car may have been met again."""


class LiveCloud:
    """A live cloud, made ready to be compared with a map at several poses."""

    def __init__(self, scene: Segmentation, config: VerificationConfig, aligner: Aligner) -> None:
        self.sample = _thinned(scene.structure, config.sample)
        self._scene, self._config, self._aligner = scene, config, aligner

    @cached_property
    def sight(self) -> _native.Sight:
        """What is looked at, and through."""
        config = self._config
        radius = max(config.seen_radius, config.coarse_radius)
        scene = self._scene
        return _native.Sight(
            scene.structure, scene.ground, config.sight_range, config.sight_bin, radius
        )

    @cached_property
    def surface(self) -> _native.Surface:
        """What is aligned."""
        points = self._scene.surface
        near = (points[:, :2] ** 2).sum(axis=1) < self._config.icp_radius**2
        return self._aligner.surface(points[near])


class MapCloud:
    """The map's own cloud, made ready to be compared with live ones.

    Parameters
    ----------
    cloud : (N, 3) float32
        Relative to ``origin``.
    origin : (3,) float64
        Added to the cloud it gives map coordinates.
    config : VerificationConfig
    threads : int
        0: all cores. No result depends on it.
    """

    def __init__(
        self, cloud: Float32, origin: Float64, config: VerificationConfig, threads: int
    ) -> None:
        self._config, self._origin = config, origin
        self._index = _native.PointIndex(cloud, max(config.coarse_radius, config.overlap_radius))
        self._aligner = Aligner(config.icp_voxel, config.icp_reach, threads)
        self._surface = self._aligner.surface(cloud)

    def live(self, scene: Segmentation) -> LiveCloud:
        """A cloud to compare with this one."""
        return LiveCloud(scene, self._config, self._aligner)

    def roughly(self, hypotheses: list[Hypothesis], live: LiveCloud) -> list[Hypothesis]:
        """The hypotheses with the share of the live cloud that roughly lies on the map there."""
        poses = np.stack([self._relative(h.T_map_local) for h in hypotheses])
        few = _thinned(live.sample, self._config.coarse_sample)
        overlap, rmse = self._index.overlap(few, poses, self._config.coarse_radius)
        return [
            replace(h, overlap=float(o), rmse=float(r))
            for h, o, r in zip(hypotheses, overlap, rmse, strict=True)
        ]

    def roughly_seen(self, hypothesis: Hypothesis, live: LiveCloud) -> Hypothesis:
        """The hypothesis with the share of the map that is roughly seen there."""
        T = self._relative(hypothesis.T_map_local)
        return replace(hypothesis, seen=self._seen(live, T, self._config.coarse_radius))

    def refined(self, hypothesis: Hypothesis, live: LiveCloud) -> Hypothesis:
        """The hypothesis at the pose where the clouds agree best; its own where they do not."""
        config = self._config
        T, covariance = self._aligned(self._relative(hypothesis.T_map_local), live)
        overlap, rmse = self._index.overlap(live.sample, T[None], config.overlap_radius)
        return replace(
            hypothesis,
            T_map_local=geometry.rigid(T[:3, :3], T[:3, 3] + self._origin),
            overlap=float(overlap[0]),
            seen=self._seen(live, T, config.seen_radius),
            rmse=float(rmse[0]),
            covariance=covariance,
        )

    def _aligned(self, T: Pose, live: LiveCloud) -> tuple[Pose, Float64 | None]:
        """Where the clouds fit best; unchanged, and without covariance, where they do not fit."""
        if not self._config.refine:
            return T, None
        aligned = self._aligner.align(self._surface, live.surface, T)
        if aligned is None:
            return T, None
        moved = geometry.inverse(T) @ aligned.T_target_source
        if np.linalg.norm(moved[:3, 3]) > self._config.separation:  # it has run away
            return T, None
        return aligned.T_target_source, aligned.covariance

    def _seen(self, live: LiveCloud, T: Pose, radius: float) -> float:
        """Share of the map in view that the live cloud has, too; NaN where too little is."""
        config = self._config
        x, y = float(T[0, 3]), float(T[1, 3])
        site = self._index.sample(x, y, config.sight_range, config.sight_sample)
        T_local_site = np.ascontiguousarray(geometry.inverse(T))
        seen, through = live.sight.look(site, T_local_site, radius, config.sight_margin)
        judged = seen + through
        return seen / judged if judged >= MIN_SIGHTED else math.nan

    def _relative(self, T_map_local: Pose) -> Pose:
        return geometry.rigid(T_map_local[:3, :3], T_map_local[:3, 3] - self._origin)


def _thinned(points: Float32, count: int) -> Float32:
    """At most ``count`` of the points, evenly spread over their (spatially sorted) order."""
    step = max(1, -(-len(points) // count))
    return np.ascontiguousarray(points[::step])
