"""The method on one page: scans -> segments -> descriptors -> matches -> poses -> verdict."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

from .answer import answer
from .config import Config, query_config
from .descriptors import create
from .errors import ConfigError, MapMismatch
from .landmarks.stem_search import StemSearch
from .local_cloud import Accumulator, Scans
from .localization import Localization
from .map.segment_map import SegmentMap
from .matching import Matcher
from .occupancy import OccupancySearch
from .pose import PoseEstimator
from .segmentation import Segmentation, Segmenter
from .stage_times import Clock, StageTimes
from .types import Candidate, Descriptors, LocalCloud, Matches, Pose
from .verification import Verdict, Verifier


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
    """

    proposed: int
    matches: Matches
    candidates: list[Candidate]
    verdict: Verdict
    by_segments: bool = True


class Localizer:
    """Finds the pose of the sensor in a prior map, with no initial guess.

    Parameters
    ----------
    prior_map : SegmentMap
    config : Config, optional
        By default the one that the map was built with.
    clock : callable
        What the times of the stages are measured by; returns seconds.

    Attributes
    ----------
    notes : tuple of str
        In what the configuration differs from the one that the map was built with, and from the
        one that the confidence was fitted under.

    Raises
    ------
    MapMismatch
        If the map was described by another method, by other weights or by another version of its
        descriptor.
    ConfigError
        If it is given something else than a map.

    Notes
    -----
    Any number of threads may use one localizer at once: queries change nothing in it. It can be
    pickled, and used on both sides of a fork.
    """

    def __init__(
        self,
        prior_map: SegmentMap,
        config: Config | None = None,
        *,
        clock: Clock = time.perf_counter,
    ) -> None:
        if not isinstance(prior_map, SegmentMap):
            raise ConfigError(
                f"a Localizer needs a SegmentMap, not {type(prior_map).__name__}: "
                "load one by SegmentMap.load(path)"
            )
        config, self.notes = query_config(prior_map, config)
        threads = config.threads
        self.prior_map, self.config, self._clock = prior_map, config, clock
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
        self.estimator = PoseEstimator(config.pose, threads=threads, seed=config.seed)
        self.occupancy = OccupancySearch(
            prior_map.cloud,
            prior_map.origin,
            prior_map.trajectory,
            config.occupancy,
            config.segmentation,
        )
        self.stems = StemSearch(
            prior_map.cloud,
            prior_map.origin,
            prior_map.cloud_voxel,
            config.stems,
            config.segmentation,
        )
        self.verifier = Verifier(
            prior_map.cloud,
            prior_map.origin,
            config.verification,
            separation=config.pose.separation,
            threads=threads,
        )

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickled by its map and configuration, and made anew: so it goes to other processes."""
        return _restored, (self.prior_map, self.config, self._clock)

    def localize(self, scans: Scans | LocalCloud) -> Localization:
        """The pose of the (last) scan in the map, or the reason why there is none.

        Parameters
        ----------
        scans : Scan, (N, 3) array, list of Scan, or LocalCloud
            One scan, or its points; or consecutive ones with odometry poses, of which the last is
            the query.

        Raises
        ------
        InvalidScan
            If several scans are given without poses, or something else. Never raised for "not
            found".
        """
        times = StageTimes(self._clock)
        return self.locate(self.describe(scans, times), times)

    def describe(self, scans: Scans | LocalCloud, times: StageTimes | None = None) -> Query:
        """Scans -> local cloud -> segments -> descriptors."""
        times = times or StageTimes(self._clock)
        with times("gathering"):
            cloud = scans if isinstance(scans, LocalCloud) else self.accumulator.gather(scans)
        with times("segmentation"):
            scene = self.segmenter.segment(cloud)
        with times("preprocessing"):
            prepared = self.descriptor.prepare(scene.segments)
        with times("descriptor"):
            descriptors = self.descriptor.encode(prepared)
        return Query(cloud, scene, descriptors)

    def locate(self, query: Query, times: StageTimes | None = None) -> Localization:
        """The second half of :meth:`localize`."""
        times = times or StageTimes(self._clock)
        found = self.search(query, times)
        counts = {
            "scans": query.cloud.num_scans,
            "points": len(query.cloud.points),
            "segments": len(query.scene.segments),
            "proposed": found.proposed,
            "matches": len(found.matches),
            "candidates": len(found.candidates),
        }
        return answer(query.cloud, found.verdict, counts, times.with_total())

    def search(self, query: Query, times: StageTimes | None = None) -> Search:
        """Descriptors -> matches -> candidate poses -> verdict, with all that was considered.

        Where too little speaks for any pose, it is tried again with more neighbours; the better
        of the verdicts counts. Where segments still say little, for or against one, stems do, if
        there are any; and where those do not settle it, the clouds are compared all over the map.
        """
        times = times or StageTimes(self._clock)
        centroids = query.scene.segments.centroids
        neighbours = self.matcher.neighbours(query.descriptors)
        best: Search | None = None
        for count in self.matcher.schedule:
            with times("matching"):
                proposed = neighbours.matches(count)
            with times("pruning"):
                matches = self.matcher.prune(query.descriptors, proposed)
            with times("pose"):
                candidates = self.estimator.estimate(centroids, self.prior_map.centroids, matches)
            with times("verification"):
                verdict = self.verifier.verify(
                    query.scene, candidates, self._inliers(query, matches)
                )
            found = Search(len(proposed), matches, candidates, verdict)
            if best is None or found.verdict.rank > best.verdict.rank:
                best = found
            if not verdict.undecided:
                break
        assert best is not None  # no schedule is empty
        if not best.verdict.is_thin:
            return best
        if self.config.stems.enabled:
            best, settled = self.search_stems(query, best, times)
            if settled:
                return best
        if not self.config.occupancy.enabled:
            return best
        return _better(best, self.search_occupancy(query, best, times))

    def search_stems(
        self, query: Query, tried: Search, times: StageTimes | None = None
    ) -> tuple[Search, bool]:
        """Candidate poses by stems -> verdict, and whether stems and clouds both settle on it."""
        times = times or StageTimes(self._clock)
        with times("pose"):
            alone = query.cloud.num_scans == 1
            stems = self.stems.search(query.scene, seen_from_origin=alone)
        if not stems.candidates:
            return tried, False
        found = self._by_clouds(query, stems.candidates, tried, times)
        best = found.verdict.best
        settled = stems.decided and found.verdict.reason is None and best is not None
        if settled and best is not None:
            apart = self.config.pose.separation.apart
            settled = not apart(best.T_map_local, stems.candidates[0].T_map_local)
        # What comes next compares its own candidates with these.
        return replace(_better(tried, found), candidates=found.candidates), settled

    def search_occupancy(
        self, query: Query, tried: Search, times: StageTimes | None = None
    ) -> Search:
        """Candidate poses by what stands where -> verdict: what :meth:`search` tries last.

        The candidates so far, and the best pose, are judged among them.
        """
        times = times or StageTimes(self._clock)
        with times("pose"):
            candidates = self.occupancy.candidates(query.scene)
        return self._by_clouds(query, candidates, tried, times)

    def _by_clouds(
        self, query: Query, proposed: list[Candidate], tried: Search, times: StageTimes
    ) -> Search:
        """The verdict on candidates that no matches propose, among all that were tried before."""
        inliers = self._inliers(query, tried.matches)
        with times("pose"):
            candidates = [replace(c, inliers=inliers(c.T_map_local)) for c in proposed]
        # By the clouds alone, as all are compared here: `fit` is not asked for.
        candidates += [replace(c, fit=0.0) for c in tried.candidates]
        if (best := tried.verdict.best) is not None:
            candidates.append(Candidate(best.T_map_local, best.inliers, fit=best.overlap))
        with times("verification"):
            verdict = self.verifier.verify(query.scene, candidates, inliers)
        return replace(tried, candidates=candidates, verdict=verdict, by_segments=False)

    def _inliers(self, query: Query, matches: Matches) -> Callable[[Pose], int]:
        """How many segments of the query agree with a pose that was not estimated of them."""
        centroids, map_centroids = query.scene.segments.centroids, self.prior_map.centroids
        return partial(self.estimator.inliers, centroids, map_centroids, matches)


def _better(tried: Search, found: Search) -> Search:
    """What was found last, unless it is less sure that there is nothing than what was tried."""
    believed = tried.verdict.reason is None
    return found if believed or found.verdict.rank > tried.verdict.rank else tried


def _restored(prior_map: SegmentMap, config: Config, clock: Clock) -> Localizer:
    return Localizer(prior_map, config, clock=clock)
