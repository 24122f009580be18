"""Candidate poses -> one verified pose, or the reason why there is none."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..frontend.segmentation import Segmentation
from ..geometry import Separation
from ..localization import Reason
from ..types import Candidate, Float32, Float64
from .candidates import Allowed, CandidateScores, Inliers
from .confidence import shipped_confidence
from .config import VerificationConfig
from .decision import decide, equal_rival, too_few_inliers
from .evidence import (
    DECISIVE_INLIERS,
    CoarseScore,
    Evidence,
    RankedCandidate,
    RefinedScore,
    Score,
    Verdict,
    inlier_evidence,
)
from .observation import MapCloud, QueryCloud

HOPELESS = 0.02
"""A candidate less likely than this is not refined. Set by hand, far below the threshold."""
UNLIKELY = 0.3
"""The rivals of a candidate that is less likely than this once it is refined are not. Set by hand,
below what trackers keep."""
FEWEST_REFINED = 2
"""So many rivals are refined, if there are as many, before a pose is believed of which the segments
leave doubt."""
MOST_STOREYS = 16
"""Of a map of several storeys so many more candidates are refined. Set by hand."""
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
    threads : int
        0: all cores. No verdict depends on it.
    storeyed : bool
        Whether the map has several storeys.
    path : (M, 3) float64, optional
        Where the sensor was when the map was made, in map coordinates.
    """

    def __init__(
        self,
        cloud: Float32,
        origin: Float64,
        config: VerificationConfig | None = None,
        *,
        separation: Separation | None = None,
        threads: int = 0,
        storeyed: bool = False,
        path: Float64 | None = None,
    ) -> None:
        self.config = config or VerificationConfig()
        self.model = shipped_confidence()
        self._separation = separation or Separation()
        path = np.empty((0, 3)) if path is None else path
        self._map = MapCloud(cloud, origin, self.config, self._separation, threads, storeyed, path)

    def query(self, scene: Segmentation) -> QueryCloud:
        """A query's cloud, made ready to be compared with the map any number of times."""
        return self._map.query(scene)

    def is_decisive(self, candidates: Sequence[Candidate]) -> bool:
        """Whether segments say more for one of the candidates than chance would."""
        chance = self.model.chance.inliers
        most, second, *_ = sorted((0, chance, *(c.inliers for c in candidates)), reverse=True)
        return most > chance and inlier_evidence(most, most / second) >= DECISIVE_INLIERS

    def verify(
        self,
        query: QueryCloud,
        candidates: Sequence[Candidate],
        inliers: Inliers = lambda _: 0,
        allowed: Allowed = lambda _: True,
    ) -> Verdict:
        """Rank the candidates, judge the best, and believe one or none.

        The first candidate that is believed is the answer. If none is, the verdict on the best
        supported one says why. Storeys fit roughly alike: of several, more candidates are refined,
        and the likeliest of all that were, rivals among them, is judged, too. ``inliers`` counts
        the segments that agree with a pose that is no candidate; no such pose is a rival that is
        not ``allowed``.
        """
        if not candidates:
            return Verdict(Reason.NO_CONSISTENT_MATCHES, "no consistent matches")
        scores = CandidateScores(
            candidates, self._map, query, self.config, self._separation, inliers, allowed
        )
        verdicts, judged = [], scores.worth_judging()
        for k in judged:
            verdicts.append(self._judge(scores, k))
            if verdicts[-1].reason is None:
                return verdicts[-1]
        if self._map.storeyed:
            for k in scores.widely(judged, MOST_STOREYS):
                scores.refined(k)
            if likeliest := scores.likeliest(self.model.standing):
                verdict = self._judge(scores, scores.moved(likeliest))
                if verdict.reason is None:
                    return verdict
        return verdicts[0]

    def refined(self, candidate: Candidate, query: QueryCloud) -> RefinedScore:
        """A candidate at the pose where the clouds fit best; at its own where they do not."""
        return self._map.finished(self._map.refined(candidate, query), query)

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
        two and does not make a wrong place right. The rivals of an unlikely one are not refined,
        nor those of a certain one, unless one of them might become its equal: their coarse overlap
        stands in for the refined one, with a slack for what ICP may add. Where segments settle it,
        no rivals are looked for nearby. Only what may be believed is aligned with all of its
        points, and the rivals that fit about as well: centimetres count between them.
        """
        config, chance = self.config, self.model.chance.inliers
        others = scores.elsewhere(scores.ranked[k].T_map_local)[: config.max_rivals]
        rivals: list[Score] = [scores.coarse(j) for j in others]
        evidence = scores.evidence(scores.coarse(k), rivals, chance)
        if self._is_below(HOPELESS, evidence):
            return evidence
        start, nearby = (None, []) if evidence.is_settled else scores.around(k)
        refined = scores.refined(k, start)
        evidence = scores.evidence(refined.coarse, rivals, chance)
        if self._is_below(HOPELESS, evidence):
            return evidence
        score, near = self._best_around(scores, refined, nearby)
        rough = scores.rough_overlap(score)
        narrowed = scores.narrowing(score, rough)
        rivals = [narrowed(rival) for rival in (*near, *rivals)]
        evidence = scores.evidence(score, rivals, chance)
        if self._is_below(UNLIKELY, evidence):
            return evidence
        if not self._is_certain(evidence):
            least = config.refined_from * rough
            strong = [j for j in others if scores.ranked[j].overlap >= least]
            weak = [scores.coarse(j) for j in others if j not in strong]
            rivals = [narrowed(rival) for rival in (*near, *map(scores.refined, strong), *weak)]
        rivals = [self._closer(scores, score, rival) for rival in rivals]
        if not evidence.is_settled:
            rivals = self._at_least_some_refined(scores, rivals)
        evidence = scores.evidence(score, rivals, chance)
        if self._is_below(UNLIKELY, evidence):
            return evidence
        least = config.rival_overlap_ratio * score.overlap
        rivals = [self._finished(scores, rival, least) for rival in rivals]
        return scores.evidence(scores.finished(score), rivals, chance)

    def _best_around(
        self, scores: CandidateScores, score: RefinedScore, nearby: Sequence[RankedCandidate]
    ) -> tuple[RefinedScore, list[Score]]:
        """The likeliest pose, and its rivals near it.

        A rival is refined where the clouds roughly fit nearly as well; of a pose that is unlikely
        by itself only where they fit better, since it is refused unless one of those is likelier;
        of a hopeless one none.
        """
        rough, rivals = scores.rough_overlap(score), list[Score]()
        for each in nearby:
            alone = self.model.standalone(score)
            least = 1.0 if alone < UNLIKELY else self.config.refined_from
            if alone < HOPELESS or each.overlap < least * rough:
                rivals.append(scores.roughly(each))
                continue
            rival = scores.closely(each.candidate)
            if self.model.advantage(rival, score) > 0.0:
                score, rival = rival, score
                rough = max(rough, each.overlap)
            rivals.append(rival)
        return score, rivals

    def _closer(self, scores: CandidateScores, best: Score, rival: Score) -> Score:
        """A rival, refined if it would be the equal of the best by what was roughly measured."""
        alone = Evidence(best, 1.0, (rival,))
        if isinstance(rival, CoarseScore) and equal_rival(alone, self.model, self.config):
            return scores.closely(Candidate(rival.T_map_local, rival.inliers))
        return rival

    @staticmethod
    def _at_least_some_refined(scores: CandidateScores, rivals: Sequence[Score]) -> list[Score]:
        """The rivals, best first, and the first of them refined: only there is it known how much of
        the walls is flush."""
        best_first = sorted(rivals, key=lambda rival: -rival.overlap)
        first, others = best_first[:FEWEST_REFINED], best_first[FEWEST_REFINED:]
        refined = [
            r
            if isinstance(r, RefinedScore)
            else scores.closely(Candidate(r.T_map_local, r.inliers))
            for r in first
        ]
        return [*refined, *others]

    @staticmethod
    def _finished(scores: CandidateScores, rival: Score, least: float) -> Score:
        if isinstance(rival, RefinedScore) and rival.overlap >= least:
            return scores.finished(rival)
        return rival

    def _is_below(self, probability: float, evidence: Evidence) -> bool:
        least = min(probability, self.config.min_confidence)
        return self.model.probability(evidence) < least and not self._may_be_equal(evidence)

    def _is_certain(self, evidence: Evidence) -> bool:
        enough = max(CERTAIN, self.config.min_confidence)
        return self.model.probability(evidence) >= enough and not self._may_be_equal(evidence)

    def _may_be_equal(self, evidence: Evidence) -> bool:
        """Whether a rival might turn out to be equal once it is refined."""
        slack = self.config.rival_overlap_ratio
        return equal_rival(evidence, self.model, self.config, slack) is not None
