"""What passes between the stages of a query."""

from __future__ import annotations

from dataclasses import dataclass

from .prior import Prior
from .segmentation import Segmentation
from .types import Candidate, Descriptors, LocalCloud, Matches
from .verification import Verdict


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
