"""Where segments say little: candidates by stems and by occupancy; the clouds judge."""

from __future__ import annotations

from copy import copy
from dataclasses import replace

from ..config import Config
from ..likelihood import QueryCloud, Verifier
from ..map.segment_map import SegmentMap
from ..prior import Prior, allowed, within
from ..proposals.landmarks.stem_search import StemSearch
from ..proposals.occupancy import OccupancySearch
from ..proposals.pose import PoseEstimator
from ..system.stage_times import StageTimes
from ..types import Candidate
from .search import Query, Search


class Fallback:
    """Compares the clouds all over the map, and judges what it finds among what was tried.

    Parameters
    ----------
    prior_map : SegmentMap
    config : Config
    estimator : PoseEstimator
        Counts how many segments agree with a pose.
    verifier : Verifier
    """

    def __init__(
        self, prior_map: SegmentMap, config: Config, estimator: PoseEstimator, verifier: Verifier
    ) -> None:
        self._config, self._centroids = config, prior_map.centroids
        self._estimator, self._verifier = estimator, verifier
        cloud, origin = prior_map.cloud, prior_map.origin
        self.stems = StemSearch(
            cloud, origin, prior_map.cloud_voxel, config.stems, config.segmentation
        )
        self.occupancy = OccupancySearch(
            cloud, origin, prior_map.trajectory, config.occupancy, config.segmentation
        )

    def on_the_cloud_of(self, other: Fallback) -> Fallback:
        """The same for another map of the same place, whose cloud is the one that is compared."""
        changed = copy(self)
        changed._verifier = other._verifier
        changed.stems, changed.occupancy = other.stems, other.occupancy
        return changed

    @property
    def is_enabled(self) -> bool:
        """Whether the clouds are compared all over the map."""
        return self._config.occupancy.enabled

    def search(
        self,
        query: Query,
        tried: Search,
        cloud: QueryCloud,
        times: StageTimes,
        deadline_ms: float | None = None,
        near: Prior | None = None,
    ) -> Search:
        """Stems, where there are any; where those do not settle it, occupancy, too."""
        found, proposed = None, list[Candidate]()
        if not times.beyond(deadline_ms):
            found, proposed = self._by_stems(query, tried, cloud, times, near)
        if found is not None:
            return found
        if self.is_enabled and not times.beyond(deadline_ms):
            with times("pose"):
                proposed = [*proposed, *self.occupancy.candidates(query.scene, near)]
        if tried.verdict.is_judged and not proposed:
            return tried
        return _better(tried, self.judged(query, proposed, tried, cloud, times, near))

    def _by_stems(
        self,
        query: Query,
        tried: Search,
        cloud: QueryCloud,
        times: StageTimes,
        near: Prior | None,
    ) -> tuple[Search | None, list[Candidate]]:
        """What stems and clouds both settle on, if they do; and where the stems may stand."""
        if not self._config.stems.enabled:
            return None, []
        with times("pose"):
            alone = query.cloud.num_scans == 1
            stems = self.stems.search(query.scene, seen_from_origin=alone)
        candidates = within(near, stems.candidates)
        if not (stems.decided and candidates):
            return None, candidates
        found = self.judged(query, candidates, tried, cloud, times, near)
        best = found.verdict.best
        apart = self._config.pose.separation.apart
        if found.verdict.reason is not None or best is None:
            return None, candidates
        if apart(best.T_map_local, candidates[0].T_map_local):
            return None, candidates
        return _better(tried, found), candidates

    def judged(
        self,
        query: Query,
        proposed: list[Candidate],
        tried: Search,
        cloud: QueryCloud,
        times: StageTimes,
        near: Prior | None = None,
    ) -> Search:
        """The verdict on candidates that no matches propose, among all that were tried before."""
        with times("pose"):
            inliers = self._estimator.agreement(
                query.scene.segments.centroids, self._centroids, tried.matches
            )
            # By the clouds alone, as all are compared here: what matches propose needs no `fit`.
            candidates = [
                replace(c, inliers=inliers(c.T_map_local), fit=c.fit or 0.0)
                for c in (*proposed, *tried.candidates)
            ]
        if tried.verdict.is_judged and (best := tried.verdict.best) is not None:
            fit = None if tried.verdict.is_decided else best.overlap  # what segments say counts
            candidates.append(Candidate(best.T_map_local, best.inliers, fit=fit))
        with times("verification"):
            verdict = self._verifier.verify(cloud, candidates, inliers, allowed(near))
        return replace(tried, candidates=candidates, verdict=verdict, by_segments=False)


def _better(tried: Search, found: Search) -> Search:
    """What was found last, unless it is less sure that there is nothing than what was tried."""
    counts = tried.verdict.reason is None or not tried.verdict.is_judged
    return found if counts or found.verdict.rank > tried.verdict.rank else tried
