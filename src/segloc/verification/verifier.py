"""Candidate poses -> one verified pose, or the reason why there is none."""

from __future__ import annotations

from collections.abc import Sequence

from ..geometry import Separation
from ..localization import Reason
from ..segmentation import Segmentation
from ..types import Candidate, Float32, Float64
from .candidates import CandidateScores, Inliers
from .confidence import ConfidenceModel, shipped_confidence
from .config import VerificationConfig
from .decision import decide, equal_rival, too_few_inliers
from .evidence import CoarseScore, Evidence, RankedCandidate, RefinedScore, Score, Verdict
from .overlap_check import MapCloud

HOPELESS = 0.02
"""A candidate less likely than this is not refined, nor, once it is, its rivals. Set by hand, far
below the threshold."""
CERTAIN = 0.9
"""The rivals of a candidate more likely than this are not refined. Set by hand, above the
threshold."""


class Verifier:
    """Compares candidate poses with the map's own cloud.

    Parameters
    ----------
    cloud : (N, 3) float32
        The map's voxelised cloud, relative to ``origin``.
    origin : (3,) float64
        Added to the cloud it gives map coordinates.
    config : VerificationConfig, optional
    separation : Separation, optional
        Poses closer than this are one.
    model : ConfidenceModel, optional
        The shipped one by default.
    threads : int
        0: all cores. No verdict depends on it.
    """

    def __init__(
        self,
        cloud: Float32,
        origin: Float64,
        config: VerificationConfig | None = None,
        *,
        separation: Separation | None = None,
        model: ConfidenceModel | None = None,
        threads: int = 0,
    ) -> None:
        self.config = config or VerificationConfig()
        self.model = model or shipped_confidence()
        self._separation = separation or Separation()
        self._map = MapCloud(cloud, origin, self.config, self._separation, threads)

    def verify(
        self,
        scene: Segmentation,
        candidates: Sequence[Candidate],
        inliers: Inliers = lambda _: 0,
    ) -> Verdict:
        """Rank the candidates, judge the best, and believe one or none.

        The first candidate that is believed is the answer. If none is, the verdict on the best
        supported one says why. ``inliers`` counts the segments that agree with a pose that is no
        candidate.
        """
        if not candidates:
            return Verdict(Reason.NO_CONSISTENT_MATCHES, "no consistent matches")
        query = self._map.query(scene)
        scores = CandidateScores(
            candidates, self._map, query, self.config, self._separation, inliers
        )
        verdicts = []
        for k in scores.worth_judging():
            verdicts.append(self._judge(scores, k))
            if verdicts[-1].reason is None:
                return verdicts[-1]
        return verdicts[0]

    def refined(self, candidate: Candidate, scene: Segmentation) -> RefinedScore:
        """A candidate at the pose where the clouds fit best; at its own where they do not."""
        return self._map.refined(candidate, self._map.query(scene))

    def _judge(self, scores: CandidateScores, k: int) -> Verdict:
        ranked = scores.ranked[k]
        if ranked.inliers < self.config.min_inliers:
            return too_few_inliers(ranked, scores.runner_up(ranked.T_map_local), self.config)
        evidence = self._enough_evidence(scores, k)
        runner_up = scores.runner_up(evidence.score.T_map_local)
        return decide(evidence, runner_up, self.model, self.config)

    def _enough_evidence(self, scores: CandidateScores, k: int) -> Evidence:
        """As much evidence as the verdict needs: what cannot change it is not measured.

        Refining costs most. A hopeless candidate is not refined: ICP moves a pose by a metre or
        two and does not make a wrong place right. The rivals of a certain one are not refined
        unless one of them might become its equal: their coarse overlap, within a wider
        neighbourhood, stands in for the refined one, with a slack for what ICP may add.
        """
        config, chance = self.config, self.model.chance.inliers
        others = scores.elsewhere(scores.ranked[k].T_map_local)[: config.max_rivals]
        rivals: list[Score] = [scores.coarse(j) for j in others]
        evidence = scores.evidence(scores.coarse(k), rivals, chance)
        if self._is_hopeless(evidence):
            return evidence
        start, nearby = scores.around(k)
        score, near = self._best_around(scores, scores.refined(k, start), nearby)
        evidence = scores.evidence(score, [*near, *rivals], chance)
        if self._is_hopeless(evidence) or self._is_certain(evidence):
            return evidence
        least = config.refined_from * scores.rough_overlap(score)
        rivals = [
            scores.refined(j) if scores.ranked[j].overlap >= least else scores.coarse(j)
            for j in others
        ]
        return self._settled(scores, scores.evidence(score, [*near, *rivals], chance))

    def _settled(self, scores: CandidateScores, evidence: Evidence) -> Evidence:
        """The same with those rivals refined that would be equal as they are."""
        config, chance = self.config, self.model.chance.inliers
        while isinstance(rival := equal_rival(evidence, self.model, config), CoarseScore):
            rivals = [scores.closer(r) if r is rival else r for r in evidence.rivals]
            evidence = scores.evidence(evidence.score, rivals, chance)
        return evidence

    def _best_around(
        self, scores: CandidateScores, score: Score, nearby: Sequence[RankedCandidate]
    ) -> tuple[Score, list[Score]]:
        """The pose that is likelier by itself, and its rivals near it.

        A rival is refined where the clouds roughly fit nearly as well.
        """
        rough, rivals = scores.rough_overlap(score), list[Score]()
        for each in nearby:
            if each.overlap < self.config.refined_from * rough:
                rivals.append(scores.roughly(each))
                continue
            rival: Score = scores.closely(each)
            if self.model.standalone(rival) > self.model.standalone(score):
                score, rival = rival, score
                rough = max(rough, each.overlap)
            rivals.append(rival)
        return score, rivals

    def _is_hopeless(self, evidence: Evidence) -> bool:
        least = min(HOPELESS, self.config.min_confidence)
        return self.model.probability(evidence) < least and not self._may_be_equal(evidence)

    def _is_certain(self, evidence: Evidence) -> bool:
        enough = max(CERTAIN, self.config.min_confidence)
        return self.model.probability(evidence) >= enough and not self._may_be_equal(evidence)

    def _may_be_equal(self, evidence: Evidence) -> bool:
        """Whether a rival might turn out to be equal once it is refined."""
        slack = self.config.rival_overlap_ratio
        return equal_rival(evidence, self.model, self.config, slack) is not None
