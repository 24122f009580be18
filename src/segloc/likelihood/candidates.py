"""The candidates of one query: each is scored when it is needed, and at most once."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

from ..geometry import Separation
from ..types import Candidate, Pose
from .config import VerificationConfig
from .evidence import CoarseScore, Evidence, RankedCandidate, RefinedScore, Score
from .observation import MapCloud, QueryCloud

Inliers = Callable[[Pose], int]
"""How many distinct query segments agree with a pose T_map_local."""
Allowed = Callable[[Pose], bool]
"""Whether the sensor may be at a pose T_map_local at all."""


class CandidateScores:
    """Candidates, the best supported first, with their scores.

    Attributes
    ----------
    ranked : list of RankedCandidate
    """

    def __init__(
        self,
        candidates: Sequence[Candidate],
        map_cloud: MapCloud,
        query: QueryCloud,
        config: VerificationConfig,
        separation: Separation,
        inliers: Inliers,
        allowed: Allowed = lambda _: True,
    ) -> None:
        self.ranked = map_cloud.ranked(candidates, query)
        self._map, self._query, self._inliers = map_cloud, query, inliers
        self._config, self._separation, self._allowed = config, separation, allowed
        self._coarse: dict[int, CoarseScore] = {}
        self._refined: dict[int, RefinedScore] = {}
        self._all_refined: list[RefinedScore] = []

    def coarse(self, k: int) -> CoarseScore:
        """Candidate k where it stands."""
        if k not in self._coarse:
            self._coarse[k] = self._map.coarse(self.ranked[k], self._query)
        return self._coarse[k]

    def refined(self, k: int, start: Pose | None = None) -> RefinedScore:
        """Candidate k where the clouds fit best; ICP sets out from ``start``, too."""
        if k not in self._refined:
            self._refined[k] = self._measured(self.ranked[k].candidate, start)
        return self._refined[k]

    def finished(self, score: RefinedScore) -> RefinedScore:
        """A refined candidate after ICP of all points."""
        return self._map.finished(score, self._query)

    def around(self, k: int) -> tuple[Pose, list[RankedCandidate]]:
        """A better start for candidate k, and rivals near it, the best supported first."""
        found = self._map.around(self.ranked[k].T_map_local, self._query)
        rivals = [Candidate(T, self._inliers(T)) for T in found.rivals if self._allowed(T)]
        return found.start, self._map.ranked(rivals, self._query) if rivals else []

    def rough_overlap(self, score: Score) -> float:
        """The overlap at a refined pose as it is measured of candidates that are not."""
        return self._map.ranked([Candidate(score.T_map_local, 0)], self._query)[0].overlap

    @staticmethod
    def narrowing(best: RefinedScore, rough: float) -> Callable[[Score], Score]:
        """What makes coarse scores comparable with a refined one, whose rough overlap is given.

        Within the narrower neighbourhood of refined ones less overlaps: at the best pose, and so
        at its rivals.
        """
        share = min(1.0, best.overlap / max(rough, 1e-9))

        def narrowed(score: Score) -> Score:
            coarse = isinstance(score, CoarseScore)
            return replace(score, overlap=share * score.overlap) if coarse else score

        return narrowed

    def roughly(self, rival: RankedCandidate) -> CoarseScore:
        """A rival near a candidate, where it stands."""
        return self._map.coarse(rival, self._query)

    def closely(self, rival: Candidate) -> RefinedScore:
        """A rival where the clouds fit best."""
        return self._measured(rival)

    def _measured(self, candidate: Candidate, start: Pose | None = None) -> RefinedScore:
        score = self._map.refined(candidate, self._query, start)
        self._all_refined.append(score)
        return score

    def runner_up(self, T_map_local: Pose) -> RankedCandidate | None:
        """The best supported candidate at a different place or with a different heading."""
        apart = self._separation.apart
        return next((c for c in self.ranked if apart(c.T_map_local, T_map_local)), None)

    def worth_judging(self) -> list[int]:
        """The best candidates, without those far below the very best; and where the clouds roughly
        fit best."""
        least = 0.5 * self.ranked[0].support
        best = self.ranked[: self._config.max_refined]
        chosen = [k for k, candidate in enumerate(best) if candidate.support >= least]
        fits = max(range(len(self.ranked)), key=lambda k: self.ranked[k].overlap)
        return chosen if fits in chosen else [*chosen, fits]

    def widely(self, but: Sequence[int], most: int) -> list[int]:
        """Other candidates, no two of one place, where the clouds roughly fit best."""
        apart, chosen = self._separation.apart, list[int]()
        for k in sorted(range(len(self.ranked)), key=lambda k: -self.ranked[k].overlap):
            T = self.ranked[k].T_map_local
            if k not in but and all(apart(T, self.ranked[j].T_map_local) for j in chosen):
                chosen.append(k)
            if len(chosen) == most:
                break
        return chosen

    def likeliest(self, by: Callable[[Score], float]) -> RefinedScore | None:
        """The best of all that were refined."""
        return max(self._all_refined, key=by, default=None)

    def moved(self, score: RefinedScore) -> int:
        """The number of another candidate: where a refined one is."""
        there = Candidate(score.T_map_local, score.inliers)
        self.ranked += self._map.ranked([there], self._query)
        return len(self.ranked) - 1

    def elsewhere(self, T_map_local: Pose) -> list[int]:
        """Candidates at other places: that of most segments, then those where clouds fit best."""
        apart = self._separation.apart
        others = [j for j, c in enumerate(self.ranked) if apart(c.T_map_local, T_map_local)]
        most = max(others, key=lambda j: self.ranked[j].inliers, default=None)
        return sorted(others, key=lambda j: (j != most, -self.ranked[j].overlap))

    def evidence(self, score: Score, rivals: Sequence[Score], chance_inliers: int) -> Evidence:
        """A score compared with those at other places; all candidates there count as rivals, too.

        So does whatever was refined for another candidate: two that set out from one place may end
        on two storeys. Rivals that turn out to be at the same place are none.
        """
        apart = self._separation.apart
        known = {id(rival): rival for rival in (*rivals, *self._all_refined)}.values()
        rivals = [r for r in known if apart(r.T_map_local, score.T_map_local)]
        others = [c.inliers for c in self.ranked if apart(c.T_map_local, score.T_map_local)]
        most = max([*others, *(rival.inliers for rival in rivals), chance_inliers])
        found = Evidence(score, score.inliers / most, tuple(rivals))
        if found.is_settled:
            return found
        extent, off_path = self._query.extent, self._map.off_path(score.T_map_local)
        return replace(
            found, extent=extent, off_path=off_path, other_storeys=self._other_storeys(found)
        )

    def _other_storeys(self, found: Evidence) -> tuple[Score, ...]:
        """The rivals that are where the pose is but for their height, if the map has storeys."""
        if not self._map.storeyed:
            return ()
        apart, T = self._separation.apart, found.score.T_map_local

        def at_its_height(rival: Score) -> Pose:
            level: Pose = rival.T_map_local.copy()
            level[2, 3] = T[2, 3]
            return level

        return tuple(r for r in found.rivals if not apart(at_its_height(r), T))
