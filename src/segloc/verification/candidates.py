"""The candidates of one query: each is scored when it is needed, and at most once."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from ..geometry import Separation
from ..types import Candidate, Pose
from .config import VerificationConfig
from .evidence import CoarseScore, Evidence, RankedCandidate, RefinedScore, Score
from .overlap_check import MapCloud, QueryCloud


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
    ) -> None:
        self.ranked = map_cloud.ranked(candidates, query)
        self._map, self._query = map_cloud, query
        self._config, self._separation = config, separation
        self._coarse: dict[int, CoarseScore] = {}
        self._refined: dict[int, RefinedScore] = {}

    def coarse(self, k: int) -> CoarseScore:
        """Candidate k where it stands."""
        if k not in self._coarse:
            self._coarse[k] = self._map.coarse(self.ranked[k], self._query)
        return self._coarse[k]

    def refined(self, k: int) -> RefinedScore:
        """Candidate k where the clouds fit best."""
        if k not in self._refined:
            self._refined[k] = self._map.refined(self.ranked[k].candidate, self._query)
        return self._refined[k]

    def runner_up(self, T_map_local: Pose) -> RankedCandidate | None:
        """The best supported candidate at a different place or with a different heading."""
        apart = self._separation.apart
        return next((c for c in self.ranked if apart(c.T_map_local, T_map_local)), None)

    def worth_judging(self) -> list[int]:
        """The best candidates, without those far below the very best."""
        least = 0.5 * self.ranked[0].support
        best = self.ranked[: self._config.max_refined]
        return [k for k, candidate in enumerate(best) if candidate.support >= least]

    def evidence(
        self,
        k: int,
        own: Callable[[int], Score],
        rival: Callable[[int], Score],
        chance_inliers: int,
    ) -> Evidence:
        """Candidate k compared with those at other places.

        ``own`` and ``rival`` say how its own score and those of its rivals are taken:
        :meth:`coarse` or :meth:`refined`. Its rivals are those where the clouds roughly fit best.
        """
        others = self._elsewhere(k)
        most = max((self.ranked[j].inliers for j in others), default=0)
        score = own(k)
        rivals = [rival(j) for j in others[: self._config.max_refined]]
        apart = self._separation.apart
        return Evidence(
            score,
            score.inliers / max(chance_inliers, most),
            tuple(r for r in rivals if apart(r.T_map_local, score.T_map_local)),
        )

    def _elsewhere(self, k: int) -> list[int]:
        """Candidates at other places than k, first those where the clouds roughly fit best."""
        here, apart = self.ranked[k].T_map_local, self._separation.apart
        others = [j for j, c in enumerate(self.ranked) if apart(c.T_map_local, here)]
        return sorted(others, key=lambda j: -self.ranked[j].overlap)
