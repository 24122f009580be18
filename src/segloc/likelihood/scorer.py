"""Candidate poses -> fits at distinct places -> posterior."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from copy import copy
from dataclasses import replace

import numpy as np

from ..frontend.segmentation import Segmentation
from ..geometry import Separation
from ..types import Candidate, Float32, Float64, Pose
from .config import VerificationConfig
from .model import FREE, OBSTRUCTED, shipped_model
from .nearby import Surroundings
from .observation import DOUBTFUL, Count, MapCloud, Observation, QueryCloud, RankedCandidate
from .posterior import Posterior, ScoredPose, log_odds

_SLACK = 6.0
"""Largest gain of log-ratio by alignment with all points."""

Inliers = Callable[[Pose], int]
"""Counts the distinct query segments that agree with a pose T_map_local."""
Allowed = Callable[[Pose], bool]
"""Tests whether a prior permits a pose T_map_local."""


class Likelihood:
    """Compares queries with the map's own cloud.

    Parameters
    ----------
    cloud : (N, 3) float32
        Voxelised cloud of the map, relative to ``origin``.
    origin : (3,) float64
        Origin of the cloud in map coordinates.
    config : VerificationConfig, optional
    separation : Separation, optional
        Separation of distinct places.
    threads : int
        0 is all cores; results do not depend on it.
    storeyed : bool
        True if the map has several storeys.
    path : (M, 3) float64, optional
        Positions of the mapping sensor, in map coordinates.

    Attributes
    ----------
    model : Model
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
        path: Float64,
    ) -> None:
        self.config, self.model = config or VerificationConfig(), shipped_model()
        self.separation = separation or Separation()
        self.cloud = MapCloud(cloud, origin, self.config, self.separation, threads, storeyed, path)

    def query(self, scene: Segmentation) -> QueryCloud:
        """Preprocess a query's cloud for comparison with the map; reusable."""
        return self.cloud.query(scene)

    def scorer(self, query: QueryCloud, allowed: Allowed = lambda _: True) -> Scorer:
        """Return the scorer of one query; places that are not ``allowed`` are ignored."""
        return Scorer(self, query, allowed)

    def at(self, query: QueryCloud, T_map_local: Pose) -> ScoredPose:
        """Align and measure a query at a known pose, without search, segments and runner-up."""
        fit = self.cloud.refined(T_map_local, query, roughly=False)
        fit.intruding  # noqa: B018  (measured on first use)
        found = self.scored(fit, self.model.features(fit, [], 0))
        # Points off the map do not lower the ratio of a known pose.
        mapped = min(max(self.cloud.mapped(fit, query), 1e-9), 1.0 - 1e-9)
        off_map = min(0.0, math.log1p(-mapped) + self.model.consistency(fit))
        known_ratio = float(np.logaddexp(math.log(mapped) + found.log_ratio, off_map))
        return replace(found, known_ratio=known_ratio)

    def segments_decide(self, inliers: int, elsewhere: int) -> bool:
        """Return whether the inliers of a pose, against those elsewhere, suffice to accept it over
        a place without segment matches that fits as well."""
        margin = self.model.margin(inliers, elsewhere) - self.model.unseen
        return margin >= log_odds(self.config.min_confidence)

    def scored(self, fit: Observation, features: tuple[float, ...]) -> ScoredPose:
        """Return the fit at a pose with its log-ratio."""
        return ScoredPose(
            T_map_local=fit.T_map_local,
            log_ratio=self.model.log_ratio(features),
            inliers=fit.inliers,
            overlap=fit.overlap,
            seen=fit.seen.share,
            rmse=fit.rmse,
            covariance=fit.covariance,
            features=features,
        )


class Scorer:
    """Measures one query at proposed places, each at most once.

    Attributes
    ----------
    fits : list of Observation
        Fits at the distinct places measured.
    """

    def __init__(self, likelihood: Likelihood, query: QueryCloud, allowed: Allowed) -> None:
        self._likelihood, self._query, self._allowed = likelihood, query, allowed
        self._config, self._model = likelihood.config, likelihood.model
        self._map, self._apart = likelihood.cloud, likelihood.separation.apart
        self._threshold = log_odds(self._config.min_confidence)
        self._candidates: Sequence[Candidate] = ()
        self._finished: list[Observation] = []
        self.fits: list[Observation] = []

    def segments_decide(self, candidates: Sequence[Candidate]) -> bool:
        """Return whether segment matches decide for one of the candidates."""
        if not candidates:
            return False
        best = max(candidates, key=lambda c: c.inliers)
        elsewhere = self._most_elsewhere(candidates, best.T_map_local)
        return self._likelihood.segments_decide(best.inliers, elsewhere)

    def fit(
        self, candidates: Sequence[Candidate], inliers: Inliers, *, thorough: bool = False
    ) -> Posterior:
        """Measure the most promising candidates.

        A few candidates are aligned with some of the points. Alignment with all points, and the
        measurement of free space, are only for those that may be accepted or be the runner-up.

        Parameters
        ----------
        candidates : sequence of Candidate
            All so far, T_map_local.
        inliers : callable
            Counts the segments that agree with a pose.
        thorough : bool
            Measure more candidates, and all features.
        """
        self._candidates = candidates
        ranked = self._map.ranked(candidates, self._query) if candidates else []
        for fit in self.fits:
            fit.inliers = inliers(fit.T_map_local)
        decisive = not thorough and self.segments_decide(candidates)
        if decisive:
            best = min(ranked, key=by_segments)
            fit = self._measure(best.T_map_local, inliers, roughly=False)
            place = self._at_least(fit, ranked)
            if place.log_ratio >= self._threshold:
                self.fits = [fit]
                return Posterior.of([place], self._model.lapse)
        chosen = self._promising(ranked, thorough)
        around = None
        if chosen and not decisive:
            around = self._map.around(chosen[0].T_map_local, self._query)
        for k, c in enumerate(chosen):
            start = around.start if around and k == 0 else None
            self._take(self._measure(c.T_map_local, inliers, start))
        if around and (thorough or self._best_case() >= self._threshold - _SLACK):
            for T in self._rivals(around, chosen[0]):
                self._take(self._measure(T, inliers))
        while (fit_left := self._undecided(thorough)) is not None:
            finished = self._map.finished(fit_left, self._query)
            self._finished.append(finished)
            self.fits.remove(fit_left)
            self._take(finished)  # two that converge to one pose are one place
            if thorough or not self._is_believed_anyway(finished):
                finished.intruding  # noqa: B018  (measured on first use)
        return self.posterior()

    def posterior(self) -> Posterior:
        """Return the posterior of all fits."""
        rivals = FREE if self._finished else DOUBTFUL
        places = [
            self._scored(fit, DOUBTFUL if fit in self._finished else rivals) for fit in self.fits
        ]
        return Posterior.of(places, self._model.lapse)

    def _is_believed_anyway(self, fit: Observation) -> bool:
        """Return whether a place is accepted even with all its free space occupied, none elsewhere.

        Measuring free space takes as long as several alignments.
        """
        place = self._scored(fit, OBSTRUCTED)
        others = [self._scored(other, FREE) for other in self.fits if other is not fit]
        posterior = Posterior.of([place, *others], self._model.lapse)
        return posterior.best is place and posterior.confidence >= self._config.min_confidence

    def _undecided(self, thorough: bool) -> Observation | None:
        """Return the most probable place whose unmeasured features could change the result.

        With its free space unoccupied, such a place might be accepted, or be the runner-up.
        """
        known, left = -math.inf, list[tuple[float, Observation]]()
        for fit in self.fits:
            log_ratio = self._scored(fit, FREE).log_ratio
            if fit in self._finished:
                known = max(known, log_ratio)
            else:
                left.append((log_ratio, fit))
        if not left:
            return None
        most, fit = max(left, key=lambda each: each[0])
        matters = known - most < self._threshold + _SLACK and max(known, most) >= self._threshold
        return fit if matters or thorough else None

    def _measure(
        self, T: Pose, inliers: Inliers, start: Pose | None = None, *, roughly: bool = True
    ) -> Observation:
        fit = self._map.refined(T, self._query, start, roughly=roughly)
        fit.inliers = inliers(fit.T_map_local)
        return fit

    def _at_least(self, fit: Observation, ranked: Sequence[RankedCandidate]) -> ScoredPose:
        """Score a pose against the best that another place can be by rough overlaps."""
        apart, T = self._apart, fit.T_map_local
        others = [c for c in ranked if apart(c.T_map_local, T)]
        fit.flush, fit.ground  # noqa: B018  (measured on first use, and shared by the copy)
        rival = copy(fit)
        rival.overlap = max((c.overlap for c in others), default=fit.overlap)
        features = self._model.features(fit, [rival], self._most_elsewhere(self._candidates, T))
        return self._likelihood.scored(fit, features)

    def _promising(
        self, ranked: Sequence[RankedCandidate], thorough: bool
    ) -> list[RankedCandidate]:
        """Return the candidates to measure."""
        most = self._config.max_refined * (3 if thorough or self._map.storeyed else 1)
        least = self._config.refined_from * max((c.overlap for c in ranked), default=0.0)
        chosen: list[RankedCandidate] = []
        for key in (by_segments, by_clouds, by_overlap):
            best = [c for c in sorted(ranked, key=key) if self._is_new(c, chosen)][:most]
            apart = [c for k, c in enumerate(best) if self._is_new(c, best[:k])]
            chosen += [c for k, c in enumerate(apart) if not k or thorough or c.overlap >= least]
        return chosen

    def _rivals(self, around: Surroundings, candidate: RankedCandidate) -> Iterator[Pose]:
        """Yield the poses around a candidate at which the clouds fit nearly as well."""
        near = [Candidate(T, 0) for T in around.rivals if self._allowed(T)]
        least = self._config.refined_from * candidate.overlap
        for rival in self._map.ranked(near, self._query) if near else []:
            if rival.overlap >= least:
                yield rival.T_map_local

    def _best_case(self) -> float:
        """Return the largest log-ratio of a place if all its free space is unoccupied."""
        return max((self._scored(fit, FREE).log_ratio for fit in self.fits), default=-math.inf)

    def _is_new(self, candidate: RankedCandidate, chosen: Sequence[RankedCandidate]) -> bool:
        T = candidate.T_map_local
        return all(self._apart(T, other.T_map_local) for other in chosen)

    def _take(self, fit: Observation) -> None:
        """Keep the better of two fits at one place."""
        same = [f for f in self.fits if not self._apart(f.T_map_local, fit.T_map_local)]
        if all(fit.overlap > f.overlap for f in same):
            self.fits = [f for f in self.fits if f not in same] + [fit]

    def _most_elsewhere(self, candidates: Sequence[Candidate], T: Pose) -> int:
        """Return the most inliers of any candidate at another place."""
        by_inliers = sorted(candidates, key=lambda c: -c.inliers)
        return next((c.inliers for c in by_inliers if self._apart(c.T_map_local, T)), 0)

    def _scored(self, fit: Observation, unknown: Count) -> ScoredPose:
        apart, T = self._apart, fit.T_map_local
        others = [f for f in self.fits if f is not fit and apart(f.T_map_local, T)]
        inliers = max([self._most_elsewhere(self._candidates, T), *(f.inliers for f in others)])
        return self._likelihood.scored(fit, self._model.features(fit, others, inliers, unknown))


def by_segments(candidate: RankedCandidate) -> float:
    """Sort key: inliers times overlap."""
    return -candidate.inliers * candidate.overlap


def by_clouds(candidate: RankedCandidate) -> float:
    """Sort key: overlap times the seen share of the map in view."""
    return -candidate.overlap * candidate.seen


def by_overlap(candidate: RankedCandidate) -> float:
    """Sort key: overlap."""
    return -candidate.overlap
