"""Candidate poses -> one verified pose, or the reason why there is none."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from .. import geometry
from ..segmentation import Segmentation
from ..types import Float32, Float64, Hypothesis
from .confidence import CHANCE_INLIERS, confidence, confidence_alone
from .overlap_check import LiveCloud, MapCloud

HOPELESS = 0.005
"""Candidates less likely than this before ICP are not worth it."""
CERTAIN = 0.9
"""Nor are the rivals of those that are more likely than this without it."""


class VerificationConfig(BaseModel):
    """When a pose is believed."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    min_inliers: int = Field(3, ge=2, description="distinct segments that must agree")
    min_overlap: float = Field(
        0.25, ge=0, le=1, description="share of the live cloud that must lie on the map"
    )
    min_confidence: float = Field(0.8, ge=0, le=1, description="calibrated probability needed")
    ambiguity: float = Field(
        0.85, gt=0, description="a second place with this share of the support is one too many"
    )
    likeness: float = Field(
        0.9, gt=0, le=1, description="so is one where the clouds fit this well, beside the best"
    )
    separation: float = Field(3.0, gt=0, description="poses closer than this are one, metres")
    coarse_radius: float = Field(0.5, gt=0, description="neighbourhood before ICP, metres")
    overlap_radius: float = Field(0.3, gt=0, description="neighbourhood after ICP, metres")
    max_refined: int = Field(
        2, ge=1, description="candidates that are judged, and rivals that each is compared with"
    )
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


class _Candidates:
    """The hypotheses for one live cloud, the best supported first; each is refined at most once."""

    def __init__(
        self,
        hypotheses: list[Hypothesis],
        prior_map: MapCloud,
        live: LiveCloud,
        config: VerificationConfig,
    ) -> None:
        self.ranked = sorted(prior_map.roughly(hypotheses, live), key=_support, reverse=True)
        self._site, self._live, self._config = prior_map, live, config
        self._seen: dict[int, Hypothesis] = {}
        self._refined: dict[int, Hypothesis] = {}

    def rough(self, k: int) -> Hypothesis:
        """Candidate k where it stands."""
        if k not in self._seen:
            self._seen[k] = self._site.roughly_seen(self.ranked[k], self._live)
        return self._seen[k]

    def refined(self, k: int) -> Hypothesis:
        """Candidate k where the clouds agree best."""
        if k not in self._refined:
            self._refined[k] = self._site.refined(self.ranked[k], self._live)
        return self._refined[k]

    def elsewhere(self, k: int) -> list[int]:
        """Candidates at other places than k, first those where the clouds roughly agree best."""
        here, separation = self.ranked[k], self._config.separation
        others = [j for j, h in enumerate(self.ranked) if _apart(h, here, separation)]
        return sorted(others, key=lambda j: -self.ranked[j].overlap)

    def compared(
        self, best: Hypothesis, others: list[int], how: Callable[[int], Hypothesis]
    ) -> tuple[Hypothesis, list[Hypothesis]]:
        """A candidate, rough or refined, with all that speaks for it, and its rivals.

        Its rivals are the first of the others, taken as ``how`` has them: :meth:`rough` or
        :meth:`refined`.
        """
        most = max((self.ranked[j].inliers for j in others), default=0)
        rivals = [how(j) for j in others[: self._config.max_refined]]
        rivals = [rival for rival in rivals if _apart(rival, best, self._config.separation)]
        compared = replace(
            best,
            margin=best.inliers / max(CHANCE_INLIERS, most),
            rival_overlap=max((r.overlap for r in rivals), default=math.nan),
            rival_seen=max((r.seen_or_overlap for r in rivals), default=math.nan),
        )
        return compared, rivals


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
        self._site = MapCloud(cloud, origin, self.config, threads)

    def verify(self, scene: Segmentation, hypotheses: list[Hypothesis]) -> Verdict:
        """Rank the candidates, refine the best and decide.

        A pose is believed when many segments agree with it, and many more than with any pose
        elsewhere; when the live cloud lies on the map after ICP, and the map in view is seen, much
        more so than anywhere else; and when no different place explains the scan about as well.
        """
        if not hypotheses:
            return Verdict("no consistent matches", None, None, 0.0, unsure=True)
        candidates = _Candidates(hypotheses, self._site, self._site.live(scene), self.config)
        first: Verdict | None = None
        for k in self._worth_judging(candidates.ranked):
            verdict = self._judge(candidates, k)
            if not verdict.reason:
                return verdict
            first = first or verdict
        assert first is not None  # the best candidate is always judged
        return first

    def refined(self, hypothesis: Hypothesis, scene: Segmentation) -> Hypothesis:
        """A hypothesis moved to where the clouds agree best; unchanged where they do not."""
        return self._site.refined(hypothesis, self._site.live(scene))

    def _worth_judging(self, ranked: list[Hypothesis]) -> list[int]:
        """The best candidates, without those far below the very best."""
        bar = 0.5 * _support(ranked[0])
        best = ranked[: self.config.max_refined]
        return [k for k, h in enumerate(best) if _support(h) >= bar]

    def _judge(self, candidates: _Candidates, k: int) -> Verdict:
        config, coarse = self.config, candidates.ranked[k]
        if coarse.inliers < config.min_inliers:
            other = self._elsewhere(candidates.ranked, coarse)
            reason = f"too few inliers ({coarse.inliers} < {config.min_inliers})"
            return Verdict(reason, coarse, other, 0.0, unsure=True)
        best, rivals = self._compared(candidates, k)
        p = confidence(best)
        other = self._elsewhere(candidates.ranked, best)
        if best.overlap < config.min_overlap:
            reason = f"too little overlap ({best.overlap:.2f} < {config.min_overlap:.2f})"
        elif equal := self._equal(best, rivals, config.likeness):
            return Verdict("ambiguous", best, equal, p)
        elif p < config.min_confidence:
            reason = f"too uncertain ({p:.2f} < {config.min_confidence:.2f})"
        else:
            return Verdict("", best, other, p)
        return Verdict(reason, best, other, p, unsure=True)

    def _compared(self, candidates: _Candidates, k: int) -> tuple[Hypothesis, list[Hypothesis]]:
        """A candidate with its rivals, refined where that can change the verdict."""
        config, others = self.config, candidates.elsewhere(k)
        best, rivals = candidates.compared(candidates.rough(k), others, candidates.rough)
        equal = self._equal(best, rivals, config.likeness**2)
        if confidence(best) < min(HOPELESS, config.min_confidence) and not equal:
            return best, rivals
        best, rivals = candidates.compared(candidates.refined(k), others, candidates.rough)
        equal = self._equal(best, rivals, config.likeness**2)
        if confidence(best) >= max(CERTAIN, config.min_confidence) and not equal:
            return best, rivals
        return candidates.compared(candidates.refined(k), others, candidates.refined)

    def _equal(
        self, best: Hypothesis, rivals: list[Hypothesis], likeness: float
    ) -> Hypothesis | None:
        """A rival that explains the scan about as well: by its segments or its clouds.

        Where a place repeats itself, it is chance which of its parts a segment is matched to: few
        matches do not speak against a place at which the clouds fit.
        """
        if confidence_alone(best) < self.config.min_confidence:
            return None
        for other in rivals:
            supported = _support(other) > self.config.ambiguity * _support(best)
            fits = other.overlap >= likeness * best.overlap
            if (supported or fits) and confidence_alone(other) >= 0.5 * confidence_alone(best):
                return other
        return None

    def _elsewhere(self, ranked: list[Hypothesis], best: Hypothesis) -> Hypothesis | None:
        """The best supported candidate at a different place or with a different heading."""
        return next((h for h in ranked if _apart(h, best, self.config.separation)), None)


def _support(hypothesis: Hypothesis) -> float:
    return hypothesis.inliers * hypothesis.overlap


def _apart(a: Hypothesis, b: Hypothesis, separation: float) -> bool:
    delta = geometry.inverse(b.T_map_local) @ a.T_map_local
    turned = abs(geometry.heading(delta)) > math.radians(15)
    return bool(turned or np.linalg.norm(delta[:2, 3]) > separation)
