"""The method on one page: scans -> segments -> descriptors -> matches -> poses -> verdict."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

from . import geometry
from .config import Config
from .descriptors import create
from .errors import MapMismatch
from .local_cloud import Accumulator
from .map.segment_map import SegmentMap
from .matching import Matcher
from .pose import PoseEstimator
from .segmentation import Segmentation, Segmenter
from .types import Descriptors, Hypothesis, LocalCloud, Localization, Matches, Scan
from .verification.verifier import Verdict, Verifier


@dataclass(frozen=True)
class Search:
    """What was found for one local cloud, with all that was considered.

    Attributes
    ----------
    candidates : int
        Matches before pruning.
    matches : Matches
    hypotheses : list of Hypothesis
        T_map_local, best first, at different places, before verification.
    verdict : Verdict
    """

    candidates: int
    matches: Matches
    hypotheses: list[Hypothesis]
    verdict: Verdict


class Localizer:
    """Finds the pose of the sensor in a map, with no initial guess.

    Parameters
    ----------
    prior_map : SegmentMap
    config : Config, optional
        The preset of the map's own method by default.

    Raises
    ------
    MapMismatch
        If the map was described by other weights or by another version of its descriptor.
    """

    def __init__(self, prior_map: SegmentMap, config: Config | None = None) -> None:
        config = config or Config.preset(prior_map.descriptor)
        self.prior_map = prior_map
        self.config = config
        self.accumulator = Accumulator(config.local_cloud)
        self.segmenter = Segmenter(config.segmentation)
        self.descriptor = create(prior_map.descriptor, config.threads)
        if self.descriptor.fingerprint != prior_map.fingerprint:
            raise MapMismatch(
                f"the map was described by {prior_map.fingerprint}, not by {self.descriptor.fingerprint}"
            )
        self.matcher = Matcher(
            prior_map, config.matching, pruner=self.descriptor.pruner, threads=config.threads
        )
        self.estimator = PoseEstimator(config.pose, threads=config.threads, seed=config.seed)
        self.verifier = Verifier(
            prior_map.cloud, prior_map.origin, config.verification, threads=config.threads
        )

    def localize(self, scans: Scan | Sequence[Scan] | LocalCloud) -> Localization:
        """The pose of the (last) scan in the map, or the reason why there is none.

        Parameters
        ----------
        scans : Scan, sequence of Scan, or LocalCloud
            One scan; or consecutive ones with odometry poses, the last one being asked for.

        Raises
        ------
        InvalidScan
            If several scans are given without poses. Never raised for "not found".
        """
        watch = Stopwatch()
        with watch("preprocessing"):
            cloud = scans if isinstance(scans, LocalCloud) else self.accumulator.gather(scans)
        with watch("segmentation"):
            scene = self.segmenter.segment(cloud)
        with watch("preprocessing"):
            prepared = self.descriptor.prepare(scene.segments)
        with watch("descriptor"):
            descriptors = self.descriptor.encode(prepared)
        return self.locate(cloud, scene, descriptors, watch)

    def locate(
        self,
        cloud: LocalCloud,
        scene: Segmentation,
        descriptors: Descriptors,
        watch: Stopwatch | None = None,
    ) -> Localization:
        """The second half of :meth:`localize`, for a cloud that is segmented and described."""
        watch = watch or Stopwatch()
        found = self.search(scene, descriptors, watch)
        counts = {
            "scans": cloud.num_scans,
            "points": len(cloud.points),
            "segments": len(scene.segments),
            "candidates": found.candidates,
            "matches": len(found.matches),
            "hypotheses": len(found.hypotheses),
        }
        return _localization(cloud, counts, found.verdict, watch)

    def search(
        self, scene: Segmentation, descriptors: Descriptors, watch: Stopwatch | None = None
    ) -> Search:
        """Match, find poses and verify them, and keep all that was considered.

        Where too little speaks for any pose, it is tried once more with more neighbours.
        """
        watch = watch or Stopwatch()
        proposals = self.matcher.proposals(descriptors)
        for _ in self.matcher.attempts:
            with watch("matching"):
                candidates = next(proposals)
            with watch("pruning"):
                matches = self.matcher.prune(descriptors, candidates)
            with watch("pose"):
                hypotheses = self.estimator.estimate(
                    scene.segments.centroids, self.prior_map.centroids, matches
                )
            with watch("verification"):
                verdict = self.verifier.verify(scene, hypotheses)
            if not verdict.unsure:
                break
        return Search(len(candidates), matches, hypotheses, verdict)


class Stopwatch:
    """Adds up the milliseconds spent in named blocks."""

    def __init__(self) -> None:
        self.times_ms: dict[str, float] = {}

    @contextmanager
    def __call__(self, stage: str) -> Iterator[None]:
        start = time.perf_counter()
        yield
        elapsed = 1e3 * (time.perf_counter() - start)
        self.times_ms[stage] = self.times_ms.get(stage, 0.0) + elapsed


def _localization(
    cloud: LocalCloud, counts: dict[str, int], verdict: Verdict, watch: Stopwatch
) -> Localization:
    reason, best = verdict.reason, verdict.best
    for what in ("points", "segments", "matches"):
        if counts[what] == 0:
            reason = f"no {what}"
            break
    times_ms = {**watch.times_ms, "total": sum(watch.times_ms.values())}
    if best is None:
        return Localization(False, reason, counts=counts, times_ms=times_ms, stamp=cloud.stamp)
    return Localization(
        localized=not reason,
        reason=reason,
        T_map_sensor=None if reason else best.T_map_local @ cloud.T_local_sensor,
        inliers=best.inliers,
        overlap=best.overlap,
        seen=best.seen,
        margin=best.margin,
        rmse=best.rmse,
        confidence=verdict.confidence,
        covariance=(
            None if reason else geometry.rotated_covariance(best.covariance, cloud.T_local_sensor)
        ),
        runner_up=verdict.runner_up,
        counts=counts,
        times_ms=times_ms,
        stamp=cloud.stamp,
    )
