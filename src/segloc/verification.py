"""Candidate poses -> one verified pose, or the reason why there is none."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from . import _native, geometry
from .confidence import CHANCE_INLIERS, confidence, confidence_alone
from .registration import Aligner
from .segmentation import Segmentation
from .types import Float32, Float64, Hypothesis, Pose

MIN_SIGHTED = 50
HOPELESS = 0.02
"""Candidates less likely than this before ICP are not worth it."""


class VerificationConfig(BaseModel):
    """When a pose is believed."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    min_inliers: int = Field(4, ge=2, description="distinct segments that must agree")
    min_overlap: float = Field(
        0.25, ge=0, le=1, description="share of the live cloud that must lie on the map"
    )
    min_confidence: float = Field(0.6, ge=0, le=1, description="calibrated probability needed")
    ambiguity: float = Field(
        0.85, gt=0, description="a second place with this share of the support is one too many"
    )
    likeness: float = Field(
        0.9, gt=0, le=1, description="so is one where the clouds fit this well, beside the best"
    )
    separation: float = Field(3.0, gt=0, description="poses closer than this are one, metres")
    coarse_radius: float = Field(0.5, gt=0, description="neighbourhood before ICP, metres")
    overlap_radius: float = Field(0.3, gt=0, description="neighbourhood after ICP, metres")
    max_refined: int = Field(2, ge=1, description="candidates that ICP is spent on")
    refine: bool = Field(True, description="refine the pose by ICP")
    icp_voxel: float = Field(0.8, gt=0, description="clouds are thinned to this for ICP, metres")
    icp_reach: float = Field(1.5, gt=0, description="longest ICP correspondence, metres")
    icp_radius: float = Field(35.0, gt=0, description="how far around the sensor ICP looks, metres")
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
    sight_sample: int = Field(3000, ge=1, description="points of the map that are looked for")
    coarse_sample: int = Field(500, ge=1, description="the same while candidates are ranked")


@dataclass(frozen=True)
class Verdict:
    """The outcome: ``best`` is believed exactly when ``reason`` is empty."""

    reason: str
    best: Hypothesis | None
    runner_up: Hypothesis | None
    confidence: float
    unsure: bool = False
    """Whether too little spoke for any pose, so that more candidates may help."""


class _Live:
    """A live cloud, made ready to be compared with the map at several poses."""

    def __init__(self, scene: Segmentation, config: VerificationConfig, aligner: Aligner) -> None:
        self.sample = _thinned(scene.structure, config.sample)
        self._scene, self._config, self._aligner = scene, config, aligner

    @cached_property
    def sight(self) -> _native.Sight:
        config = self._config
        radius = max(config.seen_radius, config.coarse_radius)
        scene = self._scene
        return _native.Sight(
            scene.structure, scene.ground, config.sight_range, config.sight_bin, radius
        )

    @cached_property
    def surface(self) -> _native.Surface:
        points = self._scene.surface
        near = (points[:, :2] ** 2).sum(axis=1) < self._config.icp_radius**2
        return self._aligner.surface(points[near])


class Verifier:
    """Compares candidate poses with the map's own cloud.

    Parameters
    ----------
    cloud : (N, 3) float32
        The map's voxelised cloud, relative to ``origin``.
    origin : (3,) float64
        Added to the cloud it gives map coordinates.
    config : VerificationConfig, optional
    threads : int
        0: all cores. No verdict depends on it.
    """

    def __init__(
        self,
        cloud: Float32,
        origin: Float64,
        config: VerificationConfig | None = None,
        *,
        threads: int = 0,
    ) -> None:
        self.config = config or VerificationConfig()
        self._origin = origin
        self._index = _native.PointIndex(
            cloud, max(self.config.coarse_radius, self.config.overlap_radius)
        )
        self._aligner = Aligner(self.config.icp_voxel, self.config.icp_reach, threads)
        self._surface = self._aligner.surface(cloud)

    def verify(self, scene: Segmentation, hypotheses: list[Hypothesis]) -> Verdict:
        """Rank the candidates, refine the best and decide.

        A pose is believed when the segments that agree with it are many, and many more than agree
        with any pose elsewhere; when the live cloud lies on the map after ICP, and the map in view
        is seen; and when no different place explains the scan about as well.
        """
        if not hypotheses:
            return Verdict("no consistent matches", None, None, 0.0, unsure=True)
        live = _Live(scene, self.config, self._aligner)
        ranked = self._ranked(hypotheses, live)
        first: Verdict | None = None
        for candidate in self._worth_judging(ranked):
            verdict = self._judge(ranked, candidate, live)
            if not verdict.reason:
                return verdict
            first = first or verdict
        assert first is not None  # the best candidate is always judged
        return first

    def refined(
        self, hypothesis: Hypothesis, scene: Segmentation, among: Sequence[Hypothesis] = ()
    ) -> Hypothesis:
        """A hypothesis moved to where the clouds fit best, with all that speaks for it there.

        Unchanged where the clouds do not fit at all. Its margin is that over the others.
        """
        margin = _margin(hypothesis, among, self.config.separation)
        return self._refined(
            replace(hypothesis, margin=margin), _Live(scene, self.config, self._aligner)
        )

    def _ranked(self, hypotheses: list[Hypothesis], live: _Live) -> list[Hypothesis]:
        poses = np.stack([self._relative(h.T_map_local) for h in hypotheses])
        few = _thinned(live.sample, self.config.coarse_sample)
        overlap, rmse = self._index.overlap(few, poses, self.config.coarse_radius)
        scored = [
            replace(h, overlap=float(o), rmse=float(r))
            for h, o, r in zip(hypotheses, overlap, rmse, strict=True)
        ]
        return sorted(scored, key=_support, reverse=True)

    def _worth_judging(self, ranked: list[Hypothesis]) -> list[Hypothesis]:
        """The best candidates, without those far below the very best."""
        bar = 0.5 * _support(ranked[0])
        return [h for h in ranked[: self.config.max_refined] if _support(h) >= bar]

    def _judge(self, ranked: list[Hypothesis], coarse: Hypothesis, live: _Live) -> Verdict:
        config = self.config
        other = _elsewhere(ranked, coarse, config.separation)
        if coarse.inliers < config.min_inliers:
            reason = f"too few inliers ({coarse.inliers} < {config.min_inliers})"
            return Verdict(reason, coarse, other, 0.0, unsure=True)
        rough = self._rough(coarse, live, ranked)
        p = confidence(rough)
        if p < min(HOPELESS, config.min_confidence):
            reason = f"too uncertain ({p:.2f} < {config.min_confidence:.2f})"
            return Verdict(reason, rough, other, p, unsure=True)
        best = self._refined(rough, live)
        other = _elsewhere(ranked, best, config.separation)
        p = confidence(best)
        if best.overlap < config.min_overlap:
            reason = f"too little overlap ({best.overlap:.2f} < {config.min_overlap:.2f})"
        elif rival := self._rival(ranked, coarse, best, live):
            return Verdict("ambiguous", best, rival, p)
        elif p < config.min_confidence:
            reason = f"too uncertain ({p:.2f} < {config.min_confidence:.2f})"
        else:
            return Verdict("", best, other, p)
        return Verdict(reason, best, other, p, unsure=True)

    def _rough(self, coarse: Hypothesis, live: _Live, among: Sequence[Hypothesis]) -> Hypothesis:
        """What speaks for a candidate before refinement, generously: most are hopeless by that."""
        seen = self._seen(live, self._relative(coarse.T_map_local), self.config.coarse_radius)
        return replace(coarse, seen=seen, margin=_margin(coarse, among, self.config.separation))

    def _rival(
        self,
        ranked: list[Hypothesis],
        coarse: Hypothesis,
        best: Hypothesis,
        live: _Live,
    ) -> Hypothesis | None:
        """A different place that explains the scan about as well: by its segments or its clouds.

        Where a place repeats itself, it is chance which of its parts a segment is matched to: few
        matches do not speak against a place at which the clouds fit.
        """
        config = self.config
        if confidence_alone(best) < config.min_confidence:
            return None
        # Refinement gains most where a pose was rough: the bar before it is lower.
        bar = config.likeness**2 * coarse.overlap
        alike = [
            other
            for other in ranked
            if _apart(other, best, config.separation)
            and (other.overlap >= bar or _support(other) > config.ambiguity * _support(coarse))
        ]
        alike.sort(key=lambda other: -other.overlap)
        for candidate in alike[: config.max_refined]:
            margin = _margin(candidate, ranked, config.separation)
            other = self._refined(replace(candidate, margin=margin), live)
            supported = _support(other) > config.ambiguity * _support(best)
            fits = other.overlap >= config.likeness * best.overlap
            likely = confidence_alone(other) >= 0.5 * confidence_alone(best)
            if (supported or fits) and likely and _apart(other, best, config.separation):
                return other
        return None

    def _refined(self, coarse: Hypothesis, live: _Live) -> Hypothesis:
        config = self.config
        T, covariance = self._aligned(self._relative(coarse.T_map_local), live)
        overlap, rmse = self._index.overlap(live.sample, T[None], config.overlap_radius)
        return Hypothesis(
            geometry.rigid(T[:3, :3], T[:3, 3] + self._origin),
            coarse.inliers,
            float(overlap[0]),
            self._seen(live, T, config.seen_radius),
            float(rmse[0]),
            coarse.margin,
            covariance,
        )

    def _aligned(self, T: Pose, live: _Live) -> tuple[Pose, Float64 | None]:
        """Where the clouds fit best; unchanged, and without covariance, where they do not fit."""
        if not self.config.refine:
            return T, None
        aligned = self._aligner.align(self._surface, live.surface, T)
        if aligned is None:
            return T, None
        moved = geometry.inverse(T) @ aligned.T_target_source
        if np.linalg.norm(moved[:3, 3]) > self.config.separation:  # it has run away
            return T, None
        return aligned.T_target_source, aligned.covariance

    def _seen(self, live: _Live, T: Pose, radius: float) -> float:
        """Share of the map in view that the live cloud has, too; NaN where too little is."""
        config = self.config
        x, y = float(T[0, 3]), float(T[1, 3])
        site = self._index.sample(x, y, config.sight_range, config.sight_sample)
        T_local_site = np.ascontiguousarray(geometry.inverse(T))
        seen, through = live.sight.look(site, T_local_site, radius, config.sight_margin)
        judged = seen + through
        return seen / judged if judged >= MIN_SIGHTED else math.nan

    def _relative(self, T_map_local: Pose) -> Pose:
        return geometry.rigid(T_map_local[:3, :3], T_map_local[:3, 3] - self._origin)


def _margin(chosen: Hypothesis, among: Sequence[Hypothesis], separation: float) -> float:
    """Inliers in units of what agrees at the best different place."""
    if not among:
        return math.nan
    others = (h.inliers for h in among if _apart(h, chosen, separation))
    return chosen.inliers / max(CHANCE_INLIERS, max(others, default=0))


def _support(hypothesis: Hypothesis) -> float:
    return hypothesis.inliers * hypothesis.overlap


def _elsewhere(ranked: list[Hypothesis], best: Hypothesis, separation: float) -> Hypothesis | None:
    """The best hypothesis at a different place or with a different heading."""
    return next((other for other in ranked if _apart(other, best, separation)), None)


def _apart(a: Hypothesis, b: Hypothesis, separation: float) -> bool:
    delta = geometry.inverse(b.T_map_local) @ a.T_map_local
    turned = abs(geometry.heading(delta)) > math.radians(15)
    return bool(turned or np.linalg.norm(delta[:2, 3]) > separation)


def _thinned(points: Float32, count: int) -> Float32:
    """At most ``count`` of the points, evenly spread over their (spatially sorted) order."""
    step = max(1, -(-len(points) // count))
    return np.ascontiguousarray(points[::step])
