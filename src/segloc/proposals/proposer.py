"""Interfaces of proposers and pose estimators; your own can replace those of segloc."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import numpy as np

from ..errors import ConfigError
from ..frontend.segmentation import Segmentation, SegmentationConfig
from ..map.config import BuildConfig
from ..map.segment_map import SegmentMap
from ..prior import Prior
from ..system.once import once
from ..system.plugins import plugins, require_attributes
from ..types import Candidate, Descriptors, Float64, LocalCloud, Matches, Pose
from .view import View


class Query:
    """A local cloud, its segments and their descriptors.

    Parameters
    ----------
    cloud : LocalCloud
    scene : Segmentation
    descriptors : Descriptors or callable
        Descriptors of the segments; or computes them when they are needed.
    """

    def __init__(
        self,
        cloud: LocalCloud,
        scene: Segmentation,
        descriptors: Descriptors | Callable[[], Descriptors],
    ) -> None:
        self.cloud, self.scene, self._described = cloud, scene, descriptors
        self._views: dict[tuple[float, float, SegmentationConfig], View] = {}

    @once
    def descriptors(self) -> Descriptors:
        """Descriptors of the segments."""
        return self._described() if callable(self._described) else self._described

    def view(self, cell_m: float, range_m: float, segmentation: SegmentationConfig) -> View:
        """Return the occupancy around the sensor, as a :class:`View`; computed once."""
        key = cell_m, range_m, segmentation
        if key not in self._views:
            self._views[key] = View(self.scene, *key)
        return self._views[key]


class Proposer(Protocol):
    """Proposes poses by something other than matches of segments.

    Attributes
    ----------
    name : str
        Name of the proposer in answers.
    """

    @property
    def name(self) -> str: ...

    def propose(self, query: Query, prior: Prior | None = None) -> list[Candidate]:
        """Propose poses T_map_local, best first, with their ``fit`` in [0, 1].

        At each, the query's cloud is compared with the map.
        """
        ...


PLUGINS = "segloc.proposers"
"""Entry point group of proposers of other packages: ``name = "module:factory"``."""

Factory = Callable[[SegmentMap, BuildConfig], Proposer]
"""Makes the proposer of a map; the second argument is a :class:`segloc.Config`."""


def create(name: str, prior_map: SegmentMap, config: BuildConfig) -> Proposer:
    """Create the proposer of another package by the name of its entry point.

    Raises
    ------
    ConfigError
        If there is none of that name, or it cannot be loaded.
    """
    factories, faults = plugins(PLUGINS)
    if name in faults:
        raise ConfigError(f"proposer {name!r} cannot be loaded ({faults[name]})")
    if name not in factories:
        known = ", ".join(sorted(factories)) or "none"
        raise ConfigError(f"no proposer {name!r}: install its package; installed are {known}")
    factory: Factory = factories[name]
    made = factory(prior_map, config)
    require_attributes(f"proposer {name!r}", made, ("name", "propose"))
    return made


def proposals_of(proposer: Proposer, query: Query, prior: Prior | None) -> list[Candidate]:
    """Return what a proposer proposes.

    Raises
    ------
    ConfigError
        If it is no list of candidates with finite poses.
    """
    proposed = proposer.propose(query, prior)
    for each in proposed:
        if not isinstance(each, Candidate) or not np.isfinite(each.T_map_local).all():
            raise ConfigError(
                f"proposer {proposer.name!r} must return candidates with finite poses, not "
                f"{' '.join(repr(each).split()):.60}"
            )
    return proposed


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
