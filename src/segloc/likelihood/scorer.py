"""Candidate poses -> fits at distinct places -> posterior."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..frontend.segmentation import Segmentation
from ..geometry import Separation
from ..types import Bools, Candidate, Float64, Pose
from .clouds import Clouds
from .config import VerificationConfig
from .model import (
    CHANCE_WALLS,
    Model,
    aligned_measures,
    as_by_chance,
    best_case_measures,
    by_name,
    features_of,
    rough_measures,
    walls_over,
)
from .nearby import MOST_BESIDE
from .observation import Aligned, Observation, QueryCloud, Walls
from .posterior import Posterior, ScoredPose, log_odds

_MOST_PLACES = 8
"""Most promising places, which are aligned."""
_MOST_ALIGNED = 20
"""Places that a thorough search aligns."""
_FIRST = 2
"""Candidates of each proposer that are aligned, by its own order: in offices, places that overlap
more may leave out the right one, which a thorough search finds."""
_FEW_RIVALS = 3
"""Places that overlap most: a pose is compared with them first, and its walls with theirs alone."""

Rival = tuple[Pose, tuple[float, ...]]
"""A place T_map_local with which others are compared, and its :func:`aligned_measures`."""
Inliers = Callable[[Pose], int]
"""Counts the distinct query segments that agree with a pose T_map_local."""
Allowed = Callable[[Pose], bool]
"""Tests whether a prior permits a pose T_map_local."""


class Likelihood:
    """Compares queries with the map's own cloud.

    Parameters
    ----------
    cloud : Clouds
        Cloud of the map, or those of its tiles.
    config : VerificationConfig, optional
    separation : Separation, optional
        Separation of distinct places.
    model : Model, optional
        By default the shipped one.
    """

    def __init__(
        self,
        cloud: Clouds,
        config: VerificationConfig,
        separation: Separation,
        model: Model,
    ) -> None:
        self.cloud, self.config, self.separation, self.model = cloud, config, separation, model

    def query(self, scene: Segmentation) -> QueryCloud:
        """Preprocess a query's cloud for comparison with the map; reusable."""
        return self.cloud.query(scene)

    def scorer(
        self,
        query: QueryCloud,
        inliers: Inliers = as_by_chance,
        allowed: Allowed = lambda _: True,
    ) -> Scorer:
        """Return the scorer of one query; places that are not ``allowed`` are ignored."""
        return Scorer(self, query, inliers, allowed)

    def compared(self, query: QueryCloud, poses: Sequence[Pose]) -> Posterior:
        """Compare a query at known poses T_map_local, and at those around them, without search.

        Segments are not matched: they count neither for nor against a pose.
        """
        scorer = self.scorer(query)
        scorer.add((), poses)
        return scorer.measure()

    def segments_suffice(self, inliers: int, elsewhere: int) -> bool:
        """Return whether a place with these inliers may be accepted before other proposers."""
        proposed = self.model.margin(inliers, elsewhere) - self.model.unseen
        return proposed >= log_odds(self.config.min_confidence)

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
            evidence=self.model.known.evidence(by_name(features), fit.known.unknown),
            unknown=fit.known.unknown,
        )


@dataclass
class Trial:
    """A pose under consideration, and what is measured of it so far.

    Attributes
    ----------
    T_map_local : (4, 4) float64
    inliers : int
        Number of distinct query segments that agree with the pose.
    overlap : float
        Overlap before alignment.
    known : (4, 4) float64 or None
        Pose, known from elsewhere, that is measured to the end, whatever it promises.
    measures : tuple of float
        What is known before alignment, by :func:`rough_measures`.
    aligned : Aligned or None
        After alignment with some of the points.
    fit : Observation or None
        After alignment with all points.
    finest : Observation or None
        The same at the most accurate pose, once it competes.
    beside : Walls or None
        Walls with which those of the fit are compared: of another place, or of chance.
    scored : ScoredPose or None
        Score of the fit beside the other places.
    rough, promise : float
        Log-odds that the place competes: before alignment, and by what is measured so far.
    """

    T_map_local: Pose
    inliers: int
    overlap: float
    known: Pose | None = None
    measures: tuple[float, ...] = ()
    aligned: Aligned | None = None
    fit: Observation | None = None
    finest: Observation | None = None
    beside: Walls | None = None
    scored: ScoredPose | None = None
    rough: float = -math.inf
    promise: float = -math.inf

    @property
    def log_ratio(self) -> float:
        """The log-ratio, or minus infinity before it is known."""
        return -math.inf if self.scored is None else self.scored.log_ratio

    def expect(self, model: Model) -> None:
        """Update the promise by what is measured so far."""
        self.rough = self.promise = model.rough.log_odds(self.measures)
        if self.aligned is not None:
            measures = (*self.measures, *aligned_measures(self.aligned))
            self.promise = model.aligned.log_odds(measures)


class Scorer:
    """Measures one query at proposed places, the most promising first, until the decision is sure.

    Attributes
    ----------
    places : list of Trial
        Distinct places under consideration.
    """

    def __init__(
        self, likelihood: Likelihood, query: QueryCloud, inliers: Inliers, allowed: Allowed
    ) -> None:
        self._likelihood, self._query = likelihood, query
        self._inliers, self._allowed = inliers, allowed
        self._model = likelihood.model
        self._map, self._separation = likelihood.cloud, likelihood.separation
        self._threshold = log_odds(likelihood.config.min_confidence)
        self._sure = log_odds(1.0 - self._model.lapse)
        self._thorough = False
        self._surrounded: list[Pose] = []
        self._rivals: list[Rival] = []
        self.places: list[Trial] = []

    def add(self, candidates: Sequence[Candidate], known: Sequence[Pose] = ()) -> None:
        """Replace the candidates, and consider their places.

        Parameters
        ----------
        candidates : sequence of Candidate
            T_map_local, those of earlier calls included, those of each proposer best first. One
            that a prior excludes counts where alignment brings it, if that is permitted.
        known : sequence of (4, 4) float64
            Poses T_map_local that are measured to the end, whatever they promise; where they are
            if what fits is another place.
        """
        candidates = [
            c for c in map(self._within_prior, candidates) if self._allowed(c.T_map_local)
        ]
        self._candidates = _poses(candidates)
        self._inliers_there = np.array([c.inliers for c in candidates], np.int64)
        by = [c.proposer for c in candidates]
        self._first = self._candidates[[k for k, n in enumerate(by) if by[:k].count(n) < _FIRST]]
        self._consider([(c.T_map_local, c.inliers) for c in candidates], known)

    def _within_prior(self, candidate: Candidate) -> Candidate:
        """Return a candidate, one that a prior excludes where alignment brings it."""
        if self._allowed(candidate.T_map_local):
            return candidate
        aligned = self._map.aligned(candidate.T_map_local, self._query)
        return replace(candidate, T_map_local=aligned.T_map_local)

    def segments_suffice(self, candidates: Sequence[Candidate]) -> bool:
        """Return whether the best of the candidates may be accepted before other proposers."""
        if not candidates:
            return False
        best = max(candidates, key=lambda c: c.inliers)
        poses = _poses(candidates)
        apart = self._separation.apart_from(best.T_map_local[None], poses)[0]
        there = (c.inliers for c, far in zip(candidates, apart, strict=True) if far)
        return self._likelihood.segments_suffice(best.inliers, max(there, default=0))

    def measure(self, *, thorough: bool = False) -> Posterior:
        """Measure places until it is unlikely that any other competes; return the posterior.

        More rivals than those that overlap most are met unless one place is as sure as can be: of
        5688 such places of the fit none was refused beside all rivals. ``thorough`` measures the
        most promising ones to the end, whatever they promise.
        """
        self._thorough = thorough
        first = self._begin()
        if thorough or not self._is_sure(first, -self._threshold):
            self._rivals = []
            self._meet(self._promising())
            self._decide()
        return self.posterior()

    def measure_at_once(self) -> Posterior | None:
        """Measure the most promising place beside few; None if it is not as sure as can be."""
        return self.posterior() if self._is_sure(self._begin(), self._threshold) else None

    def _is_sure(self, first: Trial | None, least: float) -> bool:
        """Measure beside few rivals; return whether a place is as sure as can be.

        Nothing is measured if the ``first`` place promises less than ``least``.
        """
        # What a view says of known poses was fitted beside rivals that were met.
        known = any(place.known is not None for place in self.places)
        stages = [(_FEW_RIVALS, least)] if known else [(0, self._sure), (_FEW_RIVALS, least)]
        return first is not None and any(
            first.promise >= needed and self._try_beside(rivals) for rivals, needed in stages
        )

    def _promising(self) -> list[Trial]:
        """Return the places to align: known ones and the first of each proposer, then others."""
        apart = self._separation.apart_from(_poses(self.places), self._first)
        first = [
            place.known is not None or not away.all()
            for place, away in zip(self.places, apart, strict=True)
        ]
        order = sorted(range(len(first)), key=lambda k: (not first[k], -self.places[k].rough))
        return [self.places[k] for k in order[:_MOST_PLACES]]

    def _try_beside(self, rivals: int) -> bool:
        """Measure beside few rivals; return whether a place is as sure as can be.

        Otherwise nothing was tried: a place that is measured now would replace a better one that is
        aligned later. Beside none, a pose is compared with the best case of the others.
        """
        places, surrounded = [replace(place) for place in self.places], list(self._surrounded)
        most = sorted(self.places, key=lambda place: -place.overlap)
        self._rivals = []
        self._meet(most[:rivals])
        first = max(self.places, key=lambda place: place.promise)
        # One may be itself, and more may have become it.
        while self._met_beside(first) < rivals - 1 and len(self._rivals) < len(most):
            self._meet([most[len(self._rivals)]])
        self._decide()
        leader = self._leader()
        if (
            leader is not None
            and leader.log_ratio >= self._sure
            and self._met_beside(leader) >= rivals - 1
        ):
            return True
        self.places, self._surrounded = places, surrounded
        return False

    def _met_beside(self, place: Trial) -> int:
        """Return how many of the rivals that were met are elsewhere."""
        met = np.array([T for T, _ in self._rivals]).reshape(-1, 4, 4)
        return int(self._separation.apart_from(place.T_map_local[None], met).sum())

    def posterior(self) -> Posterior:
        """Return the posterior of what was measured; the rest has a share by its promise.

        Poses that compete are the most accurate that can be had.
        """
        scored = [self._finest(place) for place in self.places if place.scored is not None]
        left = [place.promise for place in self.places if place.fit is None]
        return Posterior.of(scored, self._model.lapse, left)

    def _finest(self, place: Trial) -> ScoredPose:
        """Return a scored place, with a more accurate pose if it competes."""
        assert place.scored is not None and place.fit is not None
        if place.log_ratio < -self._threshold:
            return place.scored
        if place.finest is None:
            place.finest = self._map.finest(place.fit, self._query)
        T_map_local, covariance = place.finest.T_map_local, place.finest.covariance
        return replace(place.scored, T_map_local=T_map_local, covariance=covariance)

    def _begin(self) -> Trial | None:
        """Align the most promising place, consider those about it, and return it."""
        if not self.places:
            return None
        first = max(self.places, key=lambda place: place.rough)
        self._align(first)
        if not self._is_hopeless(first, first.promise):
            self._surround(first)
        return first

    def _meet(self, rivals: Sequence[Trial]) -> None:
        """Align more rivals: with the best of all each pose is compared."""
        if not rivals:
            return
        for place in rivals:
            aligned = self._align(place)
            self._rivals.append((aligned.T_map_local, aligned_measures(aligned)))
        every, poses = list(self.places), _poses(self.places)
        near = (~self._separation.apart_from(poses, poses)).sum(axis=1)
        for k in np.flatnonzero(near > 1):  # another one beside itself
            self._merge(every[k])
        self._score()

    def _decide(self) -> None:
        """Measure places, the most promising first, until none other is likely to compete."""
        while (place := self._next()) is not None:
            self._advance(place)
            leader = self._leader()
            if leader is None:
                continue
            if self._thorough or leader.known is not None or leader.log_ratio >= self._threshold:
                self._surround(leader)

    def _next(self) -> Trial | None:
        """Return the most promising place to measure; None if no other is likely to compete."""
        begun = sum(place.aligned is not None for place in self.places)
        most = _MOST_PLACES + MOST_BESIDE
        may_begin = begun < (_MOST_ALIGNED if self._thorough else most)
        for place in self.places:
            if place.known is not None and place.fit is None:
                return place
        left = [p for p in self.places if p.fit is None and (p.aligned is not None or may_begin)]
        if self._thorough:
            fresh = [place for place in left if place.aligned is None]
            measured = sum(place.fit is not None for place in self.places)
            left = fresh or ([] if measured >= _MOST_PLACES else left)
        elif (leader := self._leader()) is not None and leader.log_ratio >= self._threshold:
            any_other = sum(1.0 / (1.0 + math.exp(-place.promise)) for place in left)
            left = left if log_odds(any_other) >= -self._threshold else []
        else:  # of places that hardly compete, an aligned one, if nothing is measured yet
            left = [
                place
                for place in left
                if place.promise >= -self._threshold
                or (leader is None and place.aligned is not None)
            ]
        return max(left, key=lambda place: place.promise, default=None)

    def _advance(self, place: Trial) -> None:
        """Measure a place more exactly; a hopeless one where it is, unless it then may compete."""
        if place.aligned is None:
            self._align(place)
            self._merge(place)
            return
        is_out = self._is_out(place, place.promise)
        self._measure(place, align=not is_out)
        if is_out and not self._is_out(place, place.log_ratio):
            self._measure(place)

    def _is_out(self, place: Trial, odds: float) -> bool:
        """Return whether a hopeless place is out; in a thorough search none is."""
        return not self._thorough and self._is_hopeless(place, odds)

    def _is_hopeless(self, place: Trial, odds: float) -> bool:
        """Return whether a place cannot compete by its log-odds; a known one always may."""
        return place.known is None and odds < -self._threshold

    def _measure(self, place: Trial, *, align: bool = True) -> None:
        """Measure a place to the end; one that meets another place is the same."""
        fit = self._map.measured(place.T_map_local, self._query, place.known, align=align)
        place.fit, place.T_map_local = fit, fit.T_map_local
        self._count(place)
        self._merge(place)
        self._score()

    def _align(self, place: Trial) -> Aligned:
        """Align a place with some of the points, once."""
        if place.aligned is None:
            place.aligned = self._map.aligned(place.T_map_local, self._query, place.known)
            place.T_map_local = place.aligned.T_map_local
            self._count(place)
            place.expect(self._model)
        return place.aligned

    def _count(self, place: Trial) -> None:
        """Count the inliers of a place."""
        place.inliers = self._inliers(place.T_map_local)
        if place.fit is not None:
            place.fit.inliers = place.inliers

    def _surround(self, place: Trial) -> None:
        """Consider the poses around a place at which the clouds fit, once."""
        here, apart = place.T_map_local, self._separation.apart
        if all(apart(here, T) for T in self._surrounded):
            self._surrounded.append(here)
            around = [T for T in self._map.around(here, self._query) if self._allowed(T)]
            self._consider([(T, self._inliers(T)) for T in around])

    def _consider(self, proposed: Sequence[tuple[Pose, int]], known: Sequence[Pose] = ()) -> None:
        """Add poses with their inliers, known ones or the most promising at a place."""
        poses = [*((T, self._inliers(T)) for T in known), *proposed]
        if not poses:
            return
        overlaps = self._map.rough_overlap([T for T, _ in poses], self._query)
        fresh = [Trial(T, n, o) for (T, n), o in zip(poses, overlaps, strict=True)]
        for place, T in zip(fresh, known, strict=False):
            place.known = T
        begun = [place for place in self.places if place.aligned is not None]
        fresh += [place for place in self.places if place.aligned is None]
        apart = self._describe(fresh, begun)
        kept: list[int] = []
        for k in sorted(range(len(fresh)), key=lambda k: (fresh[k].known is None, -fresh[k].rough)):
            if apart[k, [*kept, *range(len(fresh), len(fresh) + len(begun))]].all():
                kept.append(k)
        self.places = [*begun, *(fresh[k] for k in kept)]

    def _describe(self, places: Sequence[Trial], others: Sequence[Trial]) -> Bools:
        """Update what is known of places before alignment, beside others.

        Return which are apart, (N, N + M).
        """
        every = [*places, *others]
        poses = _poses(every)
        apart = self._separation.apart_from(poses[: len(places)], poses)
        overlaps = np.array([place.overlap for place in every])
        rivals = np.where(apart, overlaps, 0.0).max(axis=1)
        elsewhere = self._most_elsewhere(poses[: len(places)])
        for place, rival, most in zip(places, rivals.tolist(), elsewhere, strict=True):
            place.measures = rough_measures(place.overlap, rival, place.inliers, most)
            place.expect(self._model)
        return apart

    def _merge(self, place: Trial) -> None:
        """Keep the better of two that were measured at one place."""
        for other in self._same(place):
            worse, better = sorted((place, other), key=_merit)
            better.known = worse.known if better.known is None else better.known
            self.places = [each for each in self.places if each is not worse]
            if worse is place:
                return

    def _same(self, place: Trial) -> list[Trial]:
        """Return the other places that are the same."""
        others = [other for other in self.places if other is not place]
        apart = self._separation.apart_from(place.T_map_local[None], _poses(others))[0]
        return [other for other, far in zip(others, apart, strict=True) if not far]

    def _leader(self) -> Trial | None:
        """Return the most probable place of those measured to the end."""
        done = [place for place in self.places if place.scored is not None]
        return max(done, key=lambda place: place.log_ratio, default=None)

    def _score(self) -> None:
        """Score all places measured to the end, each beside the others."""
        done = [place for place in self.places if place.fit is not None]
        poses = _poses(done)
        apart, elsewhere = self._separation.apart_from(poses, poses), self._most_elsewhere(poses)
        met = self._rivals or [
            (place.T_map_local, best_case_measures(place.overlap)) for place in self.places
        ]
        rival_apart = self._separation.apart_from(poses, np.stack([T for T, _ in met]))
        for k, place in enumerate(done):
            assert place.fit is not None
            others = [o.fit for o, away in zip(done, apart[k], strict=True) if away and o.fit]
            inliers = max([elsewhere[k], *(other.inliers for other in others)])
            rivals = [rival for rival, away in zip(met, rival_apart[k], strict=True) if away]
            self._weigh(place, rivals, inliers, CHANCE_WALLS)
            # Beside rivals it is no more: a place that is out by chance stays out.
            if self._rivals and not self._is_out(place, place.log_ratio):
                self._weigh(place, rivals, inliers, self._walls_beside(place.fit, rivals))

    def _weigh(self, place: Trial, rivals: Sequence[Rival], inliers: int, beside: Walls) -> None:
        """Score a place by its fit, beside rivals, the most inliers elsewhere, and walls."""
        assert place.fit is not None and place.aligned is not None
        overlap, _ = aligned_measures(place.aligned)
        measured, walls = [each for _, each in rivals], walls_over(place.fit.walls, beside)
        features = features_of(place.fit, overlap, measured, inliers, walls)
        place.beside, place.scored = beside, self._likelihood.scored(place.fit, features)

    def _walls_beside(self, fit: Observation, rivals: Sequence[Rival]) -> Walls:
        """Return the walls of chance, or of one of the best rivals, over which a fit has least."""
        best = sorted(rivals, key=lambda rival: -rival[1][0])[:_FEW_RIVALS]
        there = [self._walls_at(T) for T, _ in best]
        return min((CHANCE_WALLS, *there), key=lambda other: walls_over(fit.walls, other))

    def _walls_at(self, T_map_local: Pose) -> Walls:
        """Return the walls where a place is aligned; measured to the end if it may compete.

        Alignments with some of the points err by centimetres, which must not tell copies apart.
        """
        for place in self.places:
            if place.fit is None or self._is_hopeless(place, place.promise):
                continue
            if not self._separation.apart(place.T_map_local, T_map_local):
                return place.fit.walls
        return self._map.walls(T_map_local, self._query)

    def _most_elsewhere(self, poses: Float64) -> list[int]:
        """Return the most inliers of any candidate at another place than each of (N, 4, 4)."""
        apart = self._separation.apart_from(poses, self._candidates)
        most: list[int] = np.where(apart, self._inliers_there, 0).max(axis=1, initial=0).tolist()
        return most


def _poses(places: Sequence[Trial | Candidate]) -> Float64:
    """Return the poses T_map_local of places, (N, 4, 4)."""
    return np.array([place.T_map_local for place in places]).reshape(-1, 4, 4)


def _merit(place: Trial) -> tuple[bool, bool, float]:
    """Order of places that are the same: by how far they are measured, then by overlap."""
    best = place.fit or place.aligned or place
    return place.fit is not None, place.aligned is not None, best.overlap
