"""The method on one page: scans -> query -> proposals -> fits -> posterior."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import Any, Protocol

from .config import Config, query_config
from .descriptors import create
from .errors import ConfigError, MapMismatch
from .frontend.local_cloud import Accumulator, Scans, listed
from .frontend.segmentation import Segmenter
from .likelihood import Likelihood, Scorer
from .localization import Localization
from .map.segment_map import SegmentMap
from .pipeline import Proposed, Search, answer, explained
from .prior import Near, Prior, allowed, within
from .proposals.landmarks import StemProposer
from .proposals.matching import Matcher
from .proposals.occupancy import OccupancyProposer, is_storeyed
from .proposals.pose import PoseEstimator
from .proposals.proposer import Estimator, Proposer, Query
from .system.stage_times import Clock, StageTimes
from .types import Candidate, Float64, LocalCloud, Pose


class TileSearch(Protocol):
    """Searches the tiles of a map that a query may be in."""

    def search(
        self, query: Query, times: StageTimes, deadline_ms: float | None, near: Prior | None
    ) -> Search: ...

    def around(self, position: Float64) -> Localizer | None: ...


class InTiles(Protocol):
    """A map in tiles, which says itself how it is searched: a :class:`segloc.tiles.TiledMap`."""

    def coarse(self) -> SegmentMap:
        """The thin map of all tiles."""
        ...

    def search(self, coarse: Localizer) -> TileSearch:
        """The search in tiles, by the settings of a localizer in the thin map of all."""
        ...


class Localizer:
    """Finds the pose of the sensor in a prior map, with no initial guess.

    Parameters
    ----------
    prior_map : SegmentMap or TiledMap
        Of a map in tiles those are fetched and searched as one that a query may be in: near its
        prior, or else where most of it agrees with a thin map of all tiles.
    config : Config, optional
        By default the one that the map was built with.
    estimator : Estimator, optional
        Estimates poses from matches of segments; by default as ``config.pose`` says.
    proposers : sequence of Proposer, optional
        Tried in their order where segments are inconclusive; by default stems, then occupancy.
    likelihood : Likelihood, optional
        Compares clouds at poses; by default one for the map's own cloud.
    clock : callable
        What the times of the stages are measured by; returns seconds.

    Attributes
    ----------
    prior_map : SegmentMap
        Of tiles the thin map of all.
    tiles : TiledMap or None
    notes : tuple of str
        In what the configuration differs from the one that the map was built with, and from the
        one that the confidence was fitted under.
    clock : callable
        As given.

    Raises
    ------
    MapMismatch
        If the map was described by another method, by other weights or by another version of its
        descriptor.
    ConfigError
        If it is given something else than a map, or proposers or a likelihood for tiles.
    MapFormatError
        If the thin map of all tiles cannot be read.

    Notes
    -----
    Any number of threads may use one localizer at once: queries change nothing in it. It can be
    pickled, and used on both sides of a fork.
    """

    def __init__(
        self,
        prior_map: SegmentMap | InTiles,
        config: Config | None = None,
        *,
        estimator: Estimator | None = None,
        proposers: Sequence[Proposer] | None = None,
        likelihood: Likelihood | None = None,
        clock: Clock = time.perf_counter,
    ) -> None:
        self._given = estimator, proposers, likelihood, clock
        self.tiles = None if isinstance(prior_map, SegmentMap) else _tiles(prior_map)
        if self.tiles is not None:
            if proposers is not None or likelihood is not None:
                raise ConfigError("proposers and a likelihood are of one map: tiles have none")
            prior_map = self.tiles.coarse()
        assert isinstance(prior_map, SegmentMap)
        config, self.notes = query_config(prior_map, config)
        threads = config.threads
        self.prior_map, self.config, self.clock = prior_map, config, clock
        self.accumulator = Accumulator(config.local_cloud)
        self.segmenter = Segmenter(config.segmentation)
        self.descriptor = create(prior_map.descriptor, threads, config.weights)
        if self.descriptor.dim != prior_map.dim:
            raise MapMismatch(
                f"the map's vectors have {prior_map.dim} numbers, not {self.descriptor.dim}"
            )
        if self.descriptor.fingerprint != prior_map.fingerprint:
            raise MapMismatch(
                f"the map was described by {prior_map.fingerprint}, not by "
                f"{self.descriptor.fingerprint}: give the weights that it was built with, "
                "or build it anew"
            )
        pruner = self.descriptor.pruner
        self.matcher = Matcher(prior_map, config.matching, pruner=pruner, threads=threads)
        self.estimator = estimator or PoseEstimator(config.pose, threads=threads, seed=config.seed)
        self.proposers = _proposers(prior_map, config) if proposers is None else tuple(proposers)
        self.likelihood = likelihood or _likelihood(prior_map, config)
        self._tile_search = None if self.tiles is None else self.tiles.search(self)

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickled by its map and configuration, and made anew: so it goes to other processes."""
        return _restored, (self.tiles or self.prior_map, self.config, *self._given)

    def in_one_piece(self) -> Localizer:
        """This localizer, if its map is not in tiles.

        Raises
        ------
        ConfigError
            If it is: what is asked of it needs the whole map.
        """
        if self.tiles is not None:
            raise ConfigError("this needs a map in one piece: a file, and not tiles")
        return self

    def around(self, position: Float64) -> Localizer | None:
        """Return what holds the map around a (3,) position: of tiles the one there, if any.

        Raises
        ------
        MapFormatError
            If the tile cannot be had; names its file.
        """
        return self if self._tile_search is None else self._tile_search.around(position)

    def localize(
        self,
        scans: Scans | LocalCloud,
        *,
        near: Near | None = None,
        deadline_ms: float | None = None,
    ) -> Localization:
        """The pose of the (last) scan in the map, or the reason why there is none.

        Parameters
        ----------
        scans : Scan, (N, 3) array, list of Scan, or LocalCloud
            One scan, or its points; or consecutive ones with odometry poses, of which the last is
            the query.
        near : Prior or (position, radius_m), optional
            Where the sensor is known to be, in the map's frame: no other place is proposed or
            answered, and none elsewhere makes it ambiguous. Where it is not found there, the
            reason says so.
        deadline_ms : float, optional
            No more candidates are tried after it: the answer is the verdict on those so far. The
            first ones always are, so that a query may take longer.

        Raises
        ------
        InvalidScan
            If several scans are given without poses, or something else. Never raised for "not
            found".
        ConfigError
            If ``near`` is no prior.
        MapFormatError
            If a tile that is needed is missing, damaged, or takes too long to come; names its
            file. Nothing is answered from the others alone: they could not tell whether the place
            is ambiguous.
        """
        times, prior = StageTimes(self.clock), Prior.of(near)
        result = self.locate(self.describe(scans, times), times, deadline_ms, prior)
        if result.localized:
            return result
        given = [] if isinstance(scans, LocalCloud) else listed(scans)
        radius_m = self.config.local_cloud.radius_m
        return explained(result, given, self.prior_map, radius_m, prior)

    def describe(self, scans: Scans | LocalCloud, times: StageTimes | None = None) -> Query:
        """Scans -> local cloud -> segments -> descriptors."""
        times = times or StageTimes(self.clock)
        with times("gathering"):
            cloud = scans if isinstance(scans, LocalCloud) else self.accumulator.gather(scans)
        with times("segmentation"):
            scene = self.segmenter.segment(cloud)
        with times("preprocessing"):
            prepared = self.descriptor.prepare(scene.segments)
        with times("descriptor"):
            descriptors = self.descriptor.encode(prepared)
        return Query(cloud, scene, descriptors)

    def locate(
        self,
        query: Query,
        times: StageTimes | None = None,
        deadline_ms: float | None = None,
        near: Prior | None = None,
    ) -> Localization:
        """The second half of :meth:`localize`."""
        times = times or StageTimes(self.clock)
        found = self.search(query, times, deadline_ms, near)
        result = answer(query, found, times.with_total())
        if result.localized or not found.posterior.repeats(self.config.verification.min_confidence):
            return result
        one, other = (place.T_map_sensor for place in result.places[:2])
        here = self.around(one[:3, 3])
        if here is None:
            return result
        return replace(result, next_view=here.likelihood.cloud.next_view(one, other))

    def search(
        self,
        query: Query,
        times: StageTimes | None = None,
        deadline_ms: float | None = None,
        near: Prior | None = None,
        *,
        thorough: bool = False,
    ) -> Search:
        """Proposals -> fits -> posterior, with all that was considered.

        Where segments alone are decisive nothing else is asked. Else they are matched again with
        more neighbours, and then the proposers are asked.

        Parameters
        ----------
        query : Query
        times : StageTimes, optional
        deadline_ms : float, optional
        near : Prior, optional
        thorough : bool
            Ask all proposers, and measure everything: for fitting the model.

        Raises
        ------
        ConfigError
            If the map is in tiles, and ``thorough``.
        MapFormatError
            If a tile that is needed cannot be had; names its file.
        """
        times = times or StageTimes(self.clock)
        if self._tile_search is not None:
            if thorough:
                self.in_one_piece()
            return self._tile_search.search(query, times, deadline_ms, near)
        scorer = self.likelihood.scorer(self.likelihood.query(query.scene), allowed(near))
        enough = self.config.verification.min_confidence
        found: Search | None = None
        for proposed in self._proposals(query, scorer, times, deadline_ms, near):
            if not proposed.suffices:
                continue
            with times("verification"):
                posterior = scorer.fit(proposed.candidates, proposed.inliers, thorough=thorough)
            found = Search.of(proposed, posterior, scorer.fits, enough, near)
            if found.reason is None and not thorough:
                return found
        assert found is not None  # the last proposals have to suffice
        if near and near.anywhere:
            return self.search(query, times, deadline_ms, thorough=thorough)
        return found

    def _proposals(
        self,
        query: Query,
        scorer: Scorer,
        times: StageTimes,
        deadline_ms: float | None,
        near: Prior | None,
    ) -> Iterator[Proposed]:
        """All candidates so far, time and again: by matches of segments, then by the proposers."""
        where = query.scene.segments.centroids, self.prior_map.centroids
        matcher = self._matcher_near(near)
        neighbours = matcher.neighbours(query.descriptors)
        candidates: list[Candidate] = []
        for count in matcher.schedule:
            with times("matching"):
                nearest = neighbours.matches(count)
            with times("pruning"):
                matches = matcher.prune(query.descriptors, nearest)
            with times("pose"):
                fresh = within(near, self.estimator.estimate(*where, matches))
                inliers = self.estimator.agreement(*where, matches)
                candidates = [*fresh, *_counted(candidates, inliers)]
            over = times.beyond(deadline_ms)
            last = over or (count == matcher.schedule[-1] and not self.proposers)
            decisive = scorer.segments_decide(candidates)
            yield Proposed(len(nearest), matches, candidates, inliers, decisive or last)
            if over:
                return
        candidates = _counted(candidates, inliers)
        for k, proposer in enumerate(self.proposers, start=1):
            with times("pose"):
                proposals = proposer.propose(query, near)
                fresh = within(
                    near, [replace(c, proposer=proposer.name) for c in proposals.candidates]
                )
                candidates = [*candidates, *_counted(fresh, inliers)]
            over = times.beyond(deadline_ms)
            suffices = proposals.decided or over or k == len(self.proposers)
            yield Proposed(len(nearest), matches, candidates, inliers, suffices)
            if over:
                return

    def _matcher_near(self, near: Prior | None) -> Matcher:
        """What matches segments that are in view from near a prior."""
        if near is None:
            return self.matcher
        reach_m = self.config.local_cloud.radius_m
        return self.matcher.among(near.rows(self.prior_map.centroids, reach_m))


def _tiles(given: InTiles) -> InTiles:
    if not (callable(getattr(given, "coarse", None)) and callable(getattr(given, "search", None))):
        raise ConfigError(
            f"a Localizer needs a SegmentMap or a TiledMap, not {type(given).__name__}: see "
            "SegmentMap.load(path) and segloc.tiles.TiledMap(place)"
        )
    return given


def _proposers(prior_map: SegmentMap, config: Config) -> tuple[Proposer, ...]:
    """The proposers that the configuration enables, in the order in which they are tried."""
    cloud, origin = prior_map.cloud, prior_map.origin
    found: list[Proposer] = []
    if config.stems.enabled:
        voxel = prior_map.cloud_voxel
        found.append(StemProposer(cloud, origin, voxel, config.stems, config.segmentation))
    if config.occupancy.enabled:
        path = prior_map.trajectory
        found.append(OccupancyProposer(cloud, origin, path, config.occupancy, config.segmentation))
    return tuple(found)


def _likelihood(prior_map: SegmentMap, config: Config) -> Likelihood:
    """Compares a query with the map's own cloud."""
    viewpoints = prior_map.trajectory[:, :3, 3]
    return Likelihood(
        prior_map.cloud,
        prior_map.origin,
        config.verification,
        separation=config.pose.separation,
        threads=config.threads,
        storeyed=is_storeyed(viewpoints - prior_map.origin),
        path=prior_map.sensor_positions,
    )


def _counted(candidates: Sequence[Candidate], inliers: Callable[[Pose], int]) -> list[Candidate]:
    """The candidates with the segments that agree with them by the newest matches."""
    return [replace(c, inliers=inliers(c.T_map_local)) for c in candidates]


def _restored(
    prior_map: SegmentMap | InTiles,
    config: Config,
    estimator: Estimator | None,
    proposers: Sequence[Proposer] | None,
    likelihood: Likelihood | None,
    clock: Clock,
) -> Localizer:
    return Localizer(
        prior_map,
        config,
        estimator=estimator,
        proposers=proposers,
        likelihood=likelihood,
        clock=clock,
    )
