"""The method: scans -> query -> proposals -> fits -> posterior."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

from .config import Config, query_config
from .descriptors import create
from .errors import ConfigError, MapMismatch
from .frontend.local_cloud import Accumulator, Scans
from .frontend.segmentation import Segmentation, Segmenter
from .likelihood import Likelihood, Posterior, shipped_model
from .likelihood.clouds import Clouds
from .likelihood.model import as_by_chance
from .likelihood.observation import MapCloud, QueryCloud
from .localization import Localization
from .map.info import tolerance_m
from .map.segment_map import SegmentMap
from .pipeline import Agreed, Search, answer
from .prior import Near, Prior, allowed, within
from .proposals.first_sight import FirstSight
from .proposals.matching import Matcher
from .proposals.occupancy import OccupancyProposer, is_storeyed
from .proposals.pose import PoseEstimator
from .proposals.proposer import Estimator, Proposer, Query, proposals_of
from .proposals.proposer import create as create_proposer
from .system.stage_times import Clock, StageTimes
from .types import Candidate, Descriptors, Float64, LocalCloud, Matches, Pose

_DEVIATIONS = 2.0
"""Tolerances of a map by which a point on a wall may be farther off. Chosen for plans, and judged
2026-11-28 on simulated clouds without ground (two parks, a town, a factory, a forest; noise
of 0.2 m, or of 0.1 m and two sessions 0.3 m apart): by 0, 1, 2 and 3 of them 148, 156, 158 and 159
of 160 scans were found, 0 of 480 elsewhere and in mirror images, where the highest log-ratio was
0.0, 2.3, 3.3 and 3.9 of the 4.6 that are accepted."""


class Localizer:
    """Finds the pose of the sensor in a prior map, without an initial guess.

    Parameters
    ----------
    prior_map : SegmentMap
        For tiles, see :class:`segloc.tiles.TiledLocalizer`.
    config : Config, optional
        By default the configuration of the map.
    estimator : Estimator, optional
        Estimates poses from matches of segments; by default that of ``config.pose``.
    proposers : sequence of Proposer, optional
        Tried in order if segments are inconclusive; by default those of ``config.proposers``, then
        occupancy, and first sight before segments are matched. If given, there is no first sight.
    likelihood : Likelihood, optional
        Compares clouds at poses; by default that of the map's own cloud.
    clock : callable
        Clock of the times of stages; returns seconds.

    Attributes
    ----------
    prior_map : SegmentMap
    notes : tuple of str
        Differences of the configuration from that of the map, and from that of the fit of the
        confidence.
    clock : callable

    Raises
    ------
    MapMismatch
        If the map has descriptors of another method, version or weights.
    ConfigError
        If it is not given a map, or there is no proposer of a name in ``config.proposers``.

    Notes
    -----
    Thread-safe: queries do not change it. It can be pickled, and used on both sides of a fork.
    """

    def __init__(
        self,
        prior_map: SegmentMap,
        config: Config | None = None,
        *,
        estimator: Estimator | None = None,
        proposers: Sequence[Proposer] | None = None,
        likelihood: Likelihood | None = None,
        clock: Clock = time.perf_counter,
    ) -> None:
        if not isinstance(prior_map, SegmentMap):
            raise ConfigError(
                f"a Localizer needs a SegmentMap, not {type(prior_map).__name__}: load one by "
                "SegmentMap.load(path), or pass tiles to segloc.tiles.TiledLocalizer"
            )
        config, self.notes = query_config(prior_map, config)
        threads = config.threads
        self.prior_map, self.config, self.clock = prior_map, config, clock
        self.accumulator = Accumulator(config.local_cloud)
        self.segmenter = Segmenter(config.segmentation)
        self.descriptor = create(prior_map.descriptor, threads, config.weights)
        if self.descriptor.dim != prior_map.dim:
            raise MapMismatch(
                f"the map's vectors have {prior_map.dim} numbers, needs {self.descriptor.dim}: "
                "build it again"
            )
        if self.descriptor.fingerprint != prior_map.fingerprint:
            raise MapMismatch(
                f"the map has descriptors of {prior_map.fingerprint}, not of "
                f"{self.descriptor.fingerprint}: pass the weights that it was built with, "
                "or build it again"
            )
        self.estimator = estimator or PoseEstimator(config.pose, threads=threads, seed=config.seed)
        self.first_sight = first_sight_of(prior_map, config) if proposers is None else None
        self.proposers = proposers_of(prior_map, config) if proposers is None else tuple(proposers)
        matching = config.matching if self.proposers else config.matching.alone(len(prior_map))
        pruner = self.descriptor.pruner
        self.matcher = Matcher(prior_map, matching, pruner=pruner, threads=threads)
        self.likelihood = likelihood or likelihood_of(
            cloud_of(prior_map, config), prior_map, config
        )
        self._again: Callable[[], Localizer] = partial(
            Localizer,
            prior_map,
            config,
            estimator=estimator,
            proposers=proposers,
            likelihood=likelihood,
            clock=clock,
        )

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle the map and the configuration; unpickling builds a new localizer."""
        return self._again, ()

    def localize(
        self,
        scans: Scans | LocalCloud,
        *,
        near: Near | None = None,
        deadline_ms: float | None = None,
    ) -> Localization:
        """Estimate the pose of the (last) scan in the map; otherwise return the reason.

        Parameters
        ----------
        scans : Scan, (N, 3) array, list of Scan, or LocalCloud
            One scan, or its points; or consecutive scans with odometry poses: the last one is the
            query.
        near : Prior or (position, radius_m), optional
            Known position, height or heading of the sensor, in the map's frame. Places elsewhere
            are not answered, and do not make the query ambiguous.
        deadline_ms : float, optional
            Time after which no further candidates are proposed. The first ones are always verified,
            so a query may take longer.

        Raises
        ------
        InvalidScan
            If several scans have no poses, or the type is wrong. Never raised for "not found".
        ConfigError
            If ``near`` is not a prior.
        """
        times, prior = StageTimes(self.clock), Prior.of(near)
        return self.locate(self.describe(scans, times), times, deadline_ms, prior)

    def describe(self, scans: Scans | LocalCloud, times: StageTimes | None = None) -> Query:
        """Compute the query: scans -> local cloud -> segments -> descriptors."""
        times = times or StageTimes(self.clock)
        with times("gathering"):
            cloud = self.accumulator.gather(scans)
        with times("segmentation"):
            scene = self.segmenter.segment(cloud)
        return Query(cloud, scene, partial(self._descriptors, scene, times))

    def _descriptors(self, scene: Segmentation, times: StageTimes) -> Descriptors:
        """Compute and describe segments, when they are matched."""
        with times("segmentation"):
            segments = scene.segments
        with times("preprocessing"):
            prepared = self.descriptor.prepare(segments)
        with times("descriptor"):
            return self.descriptor.encode(prepared)

    def locate(
        self,
        query: Query,
        times: StageTimes | None = None,
        deadline_ms: float | None = None,
        near: Prior | None = None,
    ) -> Localization:
        """Localize a query, the second half of :meth:`localize`."""
        return self.answer(query, times, deadline_ms, near)[1]

    def answer(
        self,
        query: Query,
        times: StageTimes | None = None,
        deadline_ms: float | None = None,
        near: Prior | None = None,
        known: Sequence[Pose] = (),
    ) -> tuple[Search, Localization]:
        """Search the map for a query and explain the result; every caller's queries end here."""
        times = times or StageTimes(self.clock)
        found = self.search(query, times, deadline_ms, near, known=known)
        result = answer(query, found, times.with_total(), self.config.local_cloud.radius_m)
        if result.localized or not found.posterior.repeats(self.config.verification.min_confidence):
            return found, result
        one, other = (place.T_map_sensor for place in result.places[:2])
        here = self.around(one[:3, 3])
        if here is None:
            return found, result
        return found, replace(result, next_view=here.likelihood.cloud.next_view(one, other))

    def around(self, position: Float64) -> Localizer | None:
        """Return the localizer of the map around a (3,) position; None if there is no map."""
        return self

    def search(
        self,
        query: Query,
        times: StageTimes | None = None,
        deadline_ms: float | None = None,
        near: Prior | None = None,
        *,
        known: Sequence[Pose] = (),
        thorough: bool = False,
    ) -> Search:
        """Search the map: proposals -> fits -> posterior, with all intermediate results.

        A pose at first sight is accepted if it is as sure as can be. Else segments are matched; if
        they are inconclusive, all proposers are used, and what they propose is measured together.

        Parameters
        ----------
        query : Query
        times : StageTimes, optional
        deadline_ms : float, optional
        near : Prior, optional
        known : sequence of (4, 4) float64
            Poses T_map_local that are measured beside what is proposed, as those of a tracker;
            those near the prior only.
        thorough : bool
            Use all proposers and measure everything, to fit the model.
        """
        times = times or StageTimes(self.clock)
        is_near, min_confidence = allowed(near), self.config.verification.min_confidence
        query_cloud = self.likelihood.query(query.scene)
        if not (known or thorough):
            seen = self._at_first_sight(query, query_cloud, times, near)
            if seen is not None and seen.reason is None:
                return seen
        rough = near and near.widened(self.config.pose.separation)
        agreed = self._agreed(query, times, rough)
        scorer = self.likelihood.scorer(query_cloud, agreed.inliers, is_near)
        known_near = [T for T in known if is_near(T)]
        found: Search | None = None
        for candidates, last in self._proposals(query, agreed, times, deadline_ms, rough):
            if not last and (thorough or not scorer.segments_suffice(candidates)):
                continue
            with times("verification"):
                scorer.add(candidates, known_near)
                posterior = scorer.measure(thorough=thorough)
            found = Search.of(
                self.prior_map, agreed, candidates, posterior, scorer.places, min_confidence, near
            )
            if found.reason is None and not thorough:
                return found
        assert found is not None  # the last proposals are always measured
        if near and near.anywhere:
            return self.search(query, times, deadline_ms, known=known, thorough=thorough)
        return found

    def compare(self, cloud: LocalCloud, known: Sequence[Pose]) -> Posterior:
        """Compare a cloud with the map at known poses T_map_local and around them, without search.

        The posterior has no places if the cloud has no points above the ground.
        """
        scene = self.segmenter.segment(cloud)
        if not len(scene.structure):
            return Posterior()
        return self.likelihood.compared(self.likelihood.query(scene), known)

    def _at_first_sight(
        self, query: Query, query_cloud: QueryCloud, times: StageTimes, near: Prior | None
    ) -> Search | None:
        """Return the result if a place at first sight is as sure as can be; else None.

        Segments are not matched: they count neither for nor against the pose.
        """
        if self.first_sight is None:
            return None
        with times("pose"):
            proposed = self.first_sight.propose(query, near)
        if not proposed:
            return None
        candidates = [replace(c, proposer=self.first_sight.name) for c in proposed]
        with times("verification"):
            scorer = self.likelihood.scorer(query_cloud, allowed=allowed(near))
            scorer.add(candidates)
            posterior = scorer.measure_at_once()
        if posterior is None:
            return None
        places = tuple(replace(place, inliers=0) for place in posterior.places)
        return Search.of(
            self.prior_map,
            Agreed(0, Matches.none(), [], as_by_chance),
            candidates,
            replace(posterior, places=places),
            scorer.places,
            self.config.verification.min_confidence,
            near,
        )

    def _agreed(self, query: Query, times: StageTimes, near: Prior | None) -> Agreed:
        """Match segments, and find the poses on which they agree."""
        described = query.descriptors
        where, matcher = (query.scene.segments.centroids, self.prior_map.centroids), self.matcher
        if near is not None and near.has_position:  # of the segments in view from there
            reach_m = self.config.local_cloud.radius_m
            matcher = matcher.among(near.rows(self.prior_map.centroids, reach_m))
        with times("matching"):
            nearest = matcher.match(described)
        with times("pruning"):
            matches = matcher.prune(described, nearest)
        with times("pose"):
            candidates = within(near, self.estimator.estimate(*where, matches))
            inliers = self.estimator.agreement(*where, matches)
        return Agreed(len(nearest), matches, candidates, inliers)

    def _proposals(
        self,
        query: Query,
        agreed: Agreed,
        times: StageTimes,
        deadline_ms: float | None,
        near: Prior | None,
    ) -> Iterator[tuple[list[Candidate], bool]]:
        """Yield all candidates after each proposer, segments first, and whether it was the last."""
        candidates = agreed.candidates
        for proposer in self.proposers:
            if times.beyond(deadline_ms):
                break
            yield candidates, False
            with times("pose"):
                proposed = within(near, proposals_of(proposer, query, near))
                counted = ((c, agreed.inliers(c.T_map_local)) for c in proposed)
                fresh = (replace(c, proposer=proposer.name, inliers=n) for c, n in counted)
                candidates = [*candidates, *fresh]
        yield candidates, True


def first_sight_of(prior_map: SegmentMap, config: Config) -> FirstSight | None:
    """Return the proposer that comes before segments; None if it is not enabled."""
    if not (config.first_sight.enabled and config.occupancy.enabled):
        return None
    sections = config.first_sight, config.occupancy, config.segmentation
    return FirstSight(prior_map, *sections, config.threads)


def proposers_of(
    prior_map: SegmentMap, config: Config, occupancy: Proposer | None = None
) -> tuple[Proposer, ...]:
    """Return the enabled proposers, in order of use; ``occupancy`` is by default of the map."""
    found = [create_proposer(name, prior_map, config) for name in config.proposers]
    if config.occupancy.enabled:
        cloud, path = prior_map.voxel_cloud, prior_map.trajectory
        found.append(
            occupancy or OccupancyProposer(cloud, path, config.occupancy, config.segmentation)
        )
    return tuple(found)


def likelihood_of(cloud: Clouds, prior_map: SegmentMap, config: Config) -> Likelihood:
    """Return the likelihood of a map's own cloud."""
    model = shipped_model(ground=prior_map.has_ground)
    return Likelihood(cloud, config.verification, config.pose.separation, model)


def cloud_of(prior_map: SegmentMap, config: Config) -> MapCloud:
    """Return the map's own cloud, preprocessed for comparison with query clouds.

    A point is on a wall that is farther off by twice the tolerance of the map.
    """
    viewpoints = prior_map.trajectory[:, :3, 3]
    return MapCloud(
        prior_map.cloud,
        prior_map.origin,
        config.pose.separation,
        config.threads,
        is_storeyed(viewpoints - prior_map.origin),
        prior_map.sensor_positions,
        thicker_m=_DEVIATIONS * tolerance_m(prior_map.metadata),
        refine=config.verification.refine,
    )
