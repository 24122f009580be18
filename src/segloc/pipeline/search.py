"""What passes between the stages of a query."""

from __future__ import annotations

from dataclasses import dataclass, replace

from ..frontend.segmentation import Segmentation
from ..likelihood import Verdict
from ..prior import Prior
from ..types import Candidate, Descriptors, LocalCloud, Matches


@dataclass(frozen=True)
class Query:
    """What one or several scans show, cut into segments and described."""

    cloud: LocalCloud
    scene: Segmentation
    descriptors: Descriptors


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
