"""Candidate poses -> one verified pose, or the reason why there is none."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from . import _native, geometry
from .refinement import Refiner
from .segmentation import Segmentation
from .types import Float32, Float64, Hypothesis, Pose

MIN_SIGHTED = 50


class VerificationConfig(BaseModel):
    """When a pose is believed."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    min_inliers: int = Field(5, ge=2, description="distinct segments that must agree")
    extra_inliers: int = Field(
        2, ge=0, description="so many more among more neighbours, where more agree by chance"
    )
    min_overlap: float = Field(
        0.25, ge=0, le=1, description="share of the live cloud that must lie on the map"
    )
    min_confidence: float = Field(0.7, ge=0, le=1, description="calibrated probability needed")
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
        self._refiner = Refiner(cloud, self._index, self.config)

    def verify(
        self, scene: Segmentation, hypotheses: list[Hypothesis], *, escalated: bool = False
    ) -> Verdict:
        """Rank the candidates, refine the best and decide.

        A pose is believed when enough distinct segments agree with it, enough of the live cloud
        lies on the map after ICP, enough of the map in view is seen, and no different place
        explains the scan about as well.
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
        starved = coarse.inliers < needed + config.extra_inliers
        if coarse.inliers < needed:
            reason = f"too few inliers ({coarse.inliers} < {needed})"
            other = _elsewhere(ranked, coarse, config.separation)
            return Verdict(reason, coarse, other, 0.0, starved)
        best = self._refined(coarse, scene, sample)
        runner_up = _elsewhere(ranked, best, config.separation)
        p = confidence(best)
        if best.overlap < config.min_overlap:
            reason = f"too little overlap ({best.overlap:.2f} < {config.min_overlap:.2f})"
        elif p < config.min_confidence:
            reason = f"too uncertain ({p:.2f} < {config.min_confidence:.2f})"
        elif rival := self._rival(ranked, coarse, best, scene, sample):
            return Verdict("ambiguous", best, rival, p)
        else:
            return Verdict("", best, runner_up, p)
        return Verdict(reason, best, runner_up, p, starved)

    def _rival(
        self,
        ranked: list[Hypothesis],
        coarse: Hypothesis,
        best: Hypothesis,
        scene: Segmentation,
        sample: Float32,
    ) -> Hypothesis | None:
        """A different place that explains the scan about as well: by its segments or its clouds.

        Where a place repeats itself, it is chance which of its parts a segment is matched to: few
        matches do not speak against a place at which the clouds fit.
        """
        config = self.config
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
            other = self._refined(candidate, scene, sample)
            supported = _support(other) > config.ambiguity * _support(best)
            fits = other.overlap >= config.likeness * best.overlap
            likely = confidence(other) >= 0.5 * confidence(best)
            if (supported or fits) and likely and _apart(other, best, config.separation):
                return other
        return None

    def _refined(self, coarse: Hypothesis, scene: Segmentation, sample: Float32) -> Hypothesis:
        config = self.config
        T = self._relative(coarse.T_map_local)
        covariance = None
        if config.refine:
            T, covariance = self._refiner.refine(T, scene)
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

    def _relative(self, T_map_local: Pose) -> Pose:
        return geometry.rigid(T_map_local[:3, :3], T_map_local[:3, 3] - self._origin)


def confidence(hypothesis: Hypothesis) -> float:
    """Probability that a refined hypothesis is right, from its three witnesses.

    A logistic model of the logarithm of the inliers, the overlap, and what of the map is seen,
    fitted by ``benchmarks/calibrate_confidence.py``.
    """
    seen = hypothesis.overlap if math.isnan(hypothesis.seen) else hypothesis.seen
    inliers = math.log(max(hypothesis.inliers, 1))
    score = -13.6 + 3.7 * inliers + 7.4 * hypothesis.overlap + 5.8 * seen
    return 1.0 / (1.0 + math.exp(-score))


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
