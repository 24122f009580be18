"""Intermediate results of a query."""

from __future__ import annotations

from dataclasses import dataclass, replace

from ..likelihood import Verdict
from ..prior import Prior
from ..proposals.proposer import Query
from ..types import Candidate, Matches


@dataclass(frozen=True)
class Search:
    """What was found for one query, with all that was considered.

    Attributes
    ----------
    proposed : int
        Matches before pruning.
    matches : Matches
    candidates : list of Candidate
        T_map_local, best first, at different places, before verification.
    verdict : Verdict
    by_segments : bool
        Whether the candidates come from matches alone.
    near : Prior or None
        Where alone was searched; None where all over the map.
    """

    proposed: int
    matches: Matches
    candidates: list[Candidate]
    verdict: Verdict
    by_segments: bool = True
    near: Prior | None = None

    def or_better(self, other: Search, decisive: bool) -> Search:
        """This, or the next attempt, which had more neighbours: the one with the better verdict.

        Among more neighbours more agree by chance, and the confidence was fitted on fewer: where
        the verdict on the other was put off, it counts alone only if its segments are ``decisive``;
        else its poses are tried, too.
        """
        if other.verdict.is_judged:
            return other if other.verdict.rank > self.verdict.rank else self
        if decisive and not self.verdict.is_judged:
            return other
        return replace(self, candidates=[*self.candidates, *other.candidates])

    def or_surer(self, found: Search) -> Search:
        """The later search, unless this one is surer that there is nothing."""
        judged = self.verdict.reason is None or not self.verdict.is_judged
        return found if judged or found.verdict.rank > self.verdict.rank else self

    def counts(self, query: Query) -> dict[str, int]:
        """How many items each stage produced."""
        return {
            "scans": query.cloud.num_scans,
            "points": len(query.cloud.points),
            "segments": len(query.scene.segments),
            "proposed": self.proposed,
            "matches": len(self.matches),
            "candidates": len(self.candidates),
        }
