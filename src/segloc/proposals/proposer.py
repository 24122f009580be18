"""Interfaces of proposers and pose estimators; your own can replace those of segloc."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from ..frontend.segmentation import Segmentation
from ..prior import Prior
from ..types import Candidate, Descriptors, Float64, LocalCloud, Matches, Pose


@dataclass(frozen=True)
class Query:
    """A local cloud, its segments and their descriptors."""

    cloud: LocalCloud
    scene: Segmentation
    descriptors: Descriptors


@dataclass(frozen=True)
class Proposals:
    """Poses that a proposer found.

    Attributes
    ----------
    candidates : list of Candidate
        T_map_local, best first, with their ``fit`` in [0, 1].
    decided : bool
        True if the proposer accepts the first one by its own measure.
    """

    candidates: list[Candidate]
    decided: bool = False


class Proposer(Protocol):
    """Proposes poses by something other than matches of segments.

    Attributes
    ----------
    name : str
        Name of the proposer in answers.
    exhaustive : bool
        True if the whole map is searched. Candidates that segment matches do not decide are then
        verified together with those of the proposers.
    """

    @property
    def name(self) -> str: ...

    @property
    def exhaustive(self) -> bool: ...

    def propose(self, query: Query, prior: Prior | None = None) -> Proposals:
        """Propose poses. At each, the query's cloud is compared with the map."""
        ...


class Estimator(Protocol):
    """Estimates poses from matches of segments."""

    def estimate(self, query: Float64, map_centroids: Float64, matches: Matches) -> list[Candidate]:
        """Estimate poses T_map_local, best first.

        Parameters
        ----------
        query : (P, 3) float64
            Segment centroids of the query [m], local frame.
        map_centroids : (M, 3) float64
            Segment centroids of the map [m], map frame.
        matches : Matches
        """
        ...

    def agreement(
        self, query: Float64, map_centroids: Float64, matches: Matches
    ) -> Callable[[Pose], int]:
        """Return a function that counts the query segments that agree with a T_map_local (4, 4)."""
        ...
