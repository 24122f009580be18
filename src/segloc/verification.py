"""Candidate poses -> one verified pose, or the reason why there is none."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
import small_gicp
from pydantic import BaseModel, ConfigDict, Field

from . import _native, geometry
from .segmentation import Segmentation
from .types import Float32, Float64, Hypothesis, Pose

MIN_ICP_POINTS = 20
MIN_SIGHTED = 50
COVARIANCE_SCALE = 20.0
"""Neighbouring correspondences err together, so the curvature of the cost alone claims far too
much. With this factor the normalised squared error is about 1 on simulated towns."""


class VerificationConfig(BaseModel):
    """When a pose is believed."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    min_inliers: int = Field(6, ge=2, description="distinct segments that must agree")
    extra_inliers: int = Field(
        2, ge=0, description="so many more among more neighbours, where more agree by chance"
    )
    min_overlap: float = Field(
        0.55, ge=0, le=1, description="share of the live cloud that must lie on the map"
    )
    min_confidence: float = Field(0.5, ge=0, le=1, description="calibrated probability needed")
    ambiguity: float = Field(
        0.85, gt=0, description="a second place with this share of the support is one too many"
    )
    separation: float = Field(3.0, gt=0, description="poses closer than this are one, metres")
    coarse_radius: float = Field(0.5, gt=0, description="neighbourhood before ICP, metres")
    overlap_radius: float = Field(0.3, gt=0, description="neighbourhood after ICP, metres")
    max_refined: int = Field(2, ge=1, description="candidates that ICP is spent on")
    refine: bool = Field(True, description="refine the pose by ICP")
    icp_voxel: float = Field(0.8, gt=0, description="clouds are thinned to this for ICP, metres")
    icp_reach: float = Field(1.5, gt=0, description="longest ICP correspondence, metres")
    icp_radius: float = Field(35.0, gt=0, description="how far around the sensor ICP looks, metres")
    icp_tile: float = Field(10.0, gt=0, description="prepared map tiles lie this far apart, metres")
    icp_tiles: int = Field(32, ge=1, description="prepared map tiles kept in memory")
    sample: int = Field(2000, ge=1, description="points of the live cloud that overlap is taken of")
    seen_radius: float = Field(
        0.4, gt=0, description="a map point with a live point so near is seen, metres"
    )
    sight_range: float = Field(
        30.0, gt=0, le=200, description="how far the map must agree with what is seen, metres"
    )
    sight_bin: float = Field(
        2.0, ge=0.1, le=10, description="width of the directions that are looked in, degrees"
    )
    sight_margin: float = Field(
        0.7, gt=0, description="what is looked through lies so far before the surface, metres"
    )
    sight_sample: int = Field(4000, ge=1, description="points of the map that are looked for")
    coarse_sample: int = Field(500, ge=1, description="the same while candidates are ranked")


@dataclass(frozen=True)
class Verdict:
    """The outcome: ``best`` is believed exactly when ``reason`` is empty."""

    reason: str
    best: Hypothesis | None
    runner_up: Hypothesis | None
    confidence: float
    starved: bool = False
    """Whether it was for lack of segments that agree."""


class Verifier:
    """Compares candidate poses with the map's own cloud.

    Parameters
    ----------
    cloud : (N, 3) float32
        The map's voxelised cloud, relative to ``origin``.
    origin : (3,) float64
        Added to the cloud it gives map coordinates.
    """

    def __init__(
        self, cloud: Float32, origin: Float64, config: VerificationConfig | None = None
    ) -> None:
        self.config = config or VerificationConfig()
        self._cloud = cloud
        self._origin = origin
        self._index = _native.PointIndex(
            cloud, max(self.config.coarse_radius, self.config.overlap_radius)
        )
        self._tile = lru_cache(maxsize=self.config.icp_tiles)(self._prepared_tile)

    def verify(
        self, scene: Segmentation, hypotheses: list[Hypothesis], *, escalated: bool = False
    ) -> Verdict:
        """Rank the candidates, refine the best and decide.

        A pose is believed when enough distinct segments agree with it, enough of the live cloud
        lies on the map after ICP, and no different place explains the scan about as well.
        """
        if not hypotheses:
            return Verdict("no consistent matches", None, None, 0.0, starved=True)
        sample = _thinned(scene.structure, self.config.sample)
        ranked = self._ranked(hypotheses, sample)
        needed = self.config.min_inliers + (self.config.extra_inliers if escalated else 0)
        verdicts = [
            self._judge(ranked, i, scene, sample, needed)
            for i in range(self._worth_refining(ranked))
        ]
        accepted = [v for v in verdicts if not v.reason]
        return max(accepted or verdicts[:1], key=lambda v: v.confidence)

    def refined(self, hypothesis: Hypothesis, scene: Segmentation) -> Hypothesis:
        """A hypothesis moved to where the clouds fit best, with its overlap there.

        Unchanged where the clouds do not fit at all.
        """
        return self._refined(hypothesis, scene, _thinned(scene.structure, self.config.sample))

    def _ranked(self, hypotheses: list[Hypothesis], sample: Float32) -> list[Hypothesis]:
        poses = np.stack([self._relative(h.T_map_local) for h in hypotheses])
        few = _thinned(sample, self.config.coarse_sample)
        overlap, rmse = self._index.overlap(few, poses, self.config.coarse_radius)
        scored = [
            replace(h, overlap=float(o), rmse=float(r))
            for h, o, r in zip(hypotheses, overlap, rmse, strict=True)
        ]
        return sorted(scored, key=_support, reverse=True)

    def _worth_refining(self, ranked: list[Hypothesis]) -> int:
        """ICP is not spent on candidates far below the best; the best one is always judged."""
        best = _support(ranked[0])
        worth = [h for h in ranked[: self.config.max_refined] if _support(h) >= 0.5 * best]
        return max(len(worth), 1)

    def _judge(
        self,
        ranked: list[Hypothesis],
        chosen: int,
        scene: Segmentation,
        sample: Float32,
        needed: int,
    ) -> Verdict:
        config, coarse = self.config, ranked[chosen]
        if coarse.inliers < needed:
            reason = f"too few inliers ({coarse.inliers} < {needed})"
            other = _elsewhere(ranked, coarse, config.separation)
            return Verdict(reason, coarse, other, 0.0, starved=True)
        best = self._refined(coarse, scene, sample)
        runner_up = _elsewhere(ranked, best, config.separation)
        p = confidence(best)
        if best.overlap < config.min_overlap:
            reason = f"too little overlap ({best.overlap:.2f} < {config.min_overlap:.2f})"
        elif runner_up and _support(runner_up) > config.ambiguity * _support(coarse):
            reason = "ambiguous"
        elif p < config.min_confidence:
            reason = f"too uncertain ({p:.2f} < {config.min_confidence:.2f})"
        else:
            reason = ""
        return Verdict(reason, best, runner_up, p)

    def _refined(self, coarse: Hypothesis, scene: Segmentation, sample: Float32) -> Hypothesis:
        config = self.config
        T = self._relative(coarse.T_map_local)
        covariance = None
        if config.refine:
            T, covariance = self._icp(T, scene)
        overlap, rmse = self._index.overlap(sample, T[None], config.overlap_radius)
        return Hypothesis(
            geometry.rigid(T[:3, :3], T[:3, 3] + self._origin),
            coarse.inliers,
            float(overlap[0]),
            self._seen(scene, T),
            float(rmse[0]),
            covariance,
        )

    def _seen(self, scene: Segmentation, T: Pose) -> float:
        """Share of the map in view that the live cloud has, too; NaN where too little is."""
        config = self.config
        x, y = float(T[0, 3]), float(T[1, 3])
        near = self._cloud[self._index.within(x, y, config.sight_range)]
        near = _thinned(near, config.sight_sample)
        T_local_site = np.ascontiguousarray(geometry.inverse(T))
        seen, through = _native.sight(
            scene.structure,
            scene.ground,
            near,
            T_local_site,
            config.sight_range,
            config.seen_radius,
            config.sight_margin,
            config.sight_bin,
        )
        judged = seen + through
        return seen / judged if judged >= MIN_SIGHTED else math.nan

    def _icp(self, T: Pose, scene: Segmentation) -> tuple[Pose, Float64 | None]:
        """Generalised ICP against the map around the candidate; unchanged where it fails."""
        config = self.config
        tile = self._tile(
            round(float(T[0, 3]) / config.icp_tile), round(float(T[1, 3]) / config.icp_tile)
        )
        surface = scene.surface
        near = (surface[:, :2] ** 2).sum(axis=1) < config.icp_radius**2
        if tile is None or near.sum() < MIN_ICP_POINTS:
            return T, None
        target, tree = tile
        source, _ = small_gicp.preprocess_points(surface[near].astype(np.float64), config.icp_voxel)
        result = small_gicp.align(
            target, source, tree, T, "GICP", max_correspondence_distance=config.icp_reach
        )
        refined = np.array(result.T_target_source)
        moved = geometry.inverse(T) @ refined
        if not np.isfinite(refined).all() or np.linalg.norm(moved[:3, 3]) > config.separation:
            return T, None
        return geometry.orthonormal(refined), _covariance(result)

    def _prepared_tile(self, x: int, y: int) -> tuple[Any, Any] | None:
        """The map around a tile's centre, thinned and with its normals, and its search tree.

        Preparing it costs far more than the alignment does; successive queries of one robot share
        it. Which tile is used depends on the candidate alone, so the answer does not depend on
        what was asked before.
        """
        config = self.config
        near = self._index.within(
            x * config.icp_tile, y * config.icp_tile, config.icp_radius + config.icp_tile
        )
        if len(near) < MIN_ICP_POINTS:
            return None
        prepared: tuple[Any, Any] = small_gicp.preprocess_points(
            self._cloud[near].astype(np.float64), config.icp_voxel
        )
        return prepared

    def _relative(self, T_map_local: Pose) -> Pose:
        return geometry.rigid(T_map_local[:3, :3], T_map_local[:3, 3] - self._origin)


def confidence(hypothesis: Hypothesis) -> float:
    """Probability that a refined hypothesis is right, from its inliers and its overlap.

    A logistic model, fitted on simulated towns by ``benchmarks/calibrate_confidence.py``.
    """
    score = -10.5 + 4.8 * math.log(max(hypothesis.inliers, 1)) + 5.8 * hypothesis.overlap
    return 1.0 / (1.0 + math.exp(-score))


def _support(hypothesis: Hypothesis) -> float:
    return hypothesis.inliers * hypothesis.overlap


def _elsewhere(ranked: list[Hypothesis], best: Hypothesis, separation: float) -> Hypothesis | None:
    """The best hypothesis at a different place or with a different heading."""
    for other in ranked:
        delta = geometry.inverse(best.T_map_local) @ other.T_map_local
        turned = abs(geometry.heading(delta)) > math.radians(15)
        if turned or np.linalg.norm(delta[:2, 3]) > separation:
            return other
    return None


def _thinned(points: Float32, count: int) -> Float32:
    """At most ``count`` of the points, evenly spread over their (spatially sorted) order."""
    step = max(1, -(-len(points) // count))
    return np.ascontiguousarray(points[::step])


def _covariance(result: small_gicp.RegistrationResult) -> Float64 | None:
    """Covariance of (rotation, translation) from the curvature of the ICP cost."""
    degrees = 3 * result.num_inliers - 6
    H = np.array(result.H)
    if degrees <= 0 or not np.isfinite(H).all() or np.linalg.cond(H) > 1e12:
        return None
    inverse = np.linalg.inv(H) * (COVARIANCE_SCALE * 2.0 * result.error / degrees)
    covariance: Float64 = (inverse + inverse.T) / 2
    return covariance
