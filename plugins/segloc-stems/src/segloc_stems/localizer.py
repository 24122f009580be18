"""Landmarks -> triangles -> matches -> poses -> posterior."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from segloc.errors import ConfigError, InvalidScan
from segloc.geometry import Separation
from segloc.likelihood.posterior import Posterior, ScoredPose
from segloc.localization import Localization, Localized, NotLocalized, Place, Reason
from segloc.proposals.pose import PoseEstimator
from segloc.system.stage_times import Clock, StageTimes
from segloc.types import Candidate, Float64, Matches, Pose

from .agreement import Agreement, MapLandmarks
from .config import LandmarkConfig
from .landmark_map import LandmarkMap
from .landmarks import Landmarks, levelling
from .triangles import TriangleIndex

_NEARBY = Separation(metres=1.0, degrees=5.0)
"""Least separation of a runner-up: rows of trees may be 2 m apart."""
_CHANCE_SUPPORT = 3.0
"""Support of some wrong place of a map by chance: the least support of a runner-up."""
_WEIGHTS = (0.96, 6.21, 11.83, 0.13)
"""Weights of a pose's log-ratio: a constant, and the logarithms of its share, of its ratio to the
runner-up, and of its support. Fitted by ``segloc_lab.calibration.landmarks``."""
_MIN_VALUE = 1e-3


class LandmarkLocalizer:
    """Finds the pose of the sensor in a map of landmarks, without an initial guess.

    Parameters
    ----------
    prior_map : LandmarkMap
    config : LandmarkConfig, optional
    clock : callable
        Clock of the times of stages; returns seconds.

    Raises
    ------
    ConfigError
        If the map is not a map of landmarks.

    Notes
    -----
    Thread-safe: queries do not change it.
    """

    def __init__(
        self,
        prior_map: LandmarkMap,
        config: LandmarkConfig | None = None,
        *,
        clock: Clock = time.perf_counter,
    ) -> None:
        if not isinstance(prior_map, LandmarkMap):
            raise ConfigError(
                f"a LandmarkLocalizer needs a LandmarkMap, not {type(prior_map).__name__}: "
                "load one by LandmarkMap.load(path)"
            )
        self.prior_map, self.config, self._clock = prior_map, config or LandmarkConfig(), clock
        where = prior_map.positions, prior_map.diameters
        self._indices = [TriangleIndex(*where, e, self.config) for e in self.config.efforts]
        self._estimator = PoseEstimator(self.config.pose, threads=1)
        self._map = MapLandmarks(prior_map, self.config)

    def localize(self, landmarks: Landmarks) -> Localization:
        """Return the pose of the sensor in the map, or the reason why there is none.

        Parameters
        ----------
        landmarks : Landmarks
            Landmarks of one scan.

        Raises
        ------
        InvalidScan
            If the argument is not Landmarks. Never raised for "not found".
        """
        if not isinstance(landmarks, Landmarks):
            raise InvalidScan(f"a query must be Landmarks, not {type(landmarks).__name__}")
        times = StageTimes(self._clock)
        with times("gathering"):
            T_local_sensor = levelling(landmarks.directions)
            columns = landmarks.transform(T_local_sensor)
        found, counts = self.search(columns, times)
        common = {"counts": counts, "times_ms": times.with_total(), "stamp": landmarks.stamp}
        return _answer(found, len(landmarks), T_local_sensor, common)

    def search(
        self, columns: Float64, times: StageTimes | None = None
    ) -> tuple[LandmarkSearch, dict[str, int]]:
        """Search the map for landmarks in a frame with a vertical z axis; also count by stage.

        Parameters
        ----------
        columns : (N, 7) float64
            Positions, axes and diameters.
        times : StageTimes, optional
        """
        times = times or StageTimes(self._clock)
        counts: dict[str, int] = {"segments": len(columns)}
        best: LandmarkSearch | None = None
        for effort, index in enumerate(self._indices, start=1):
            counts["efforts"] = effort
            found = self._attempt(columns, index, counts, times)
            if best is None or found.posterior.confidence > best.posterior.confidence:
                best = found
            if found.reason in (None, Reason.AMBIGUOUS):
                break
        assert best is not None  # there is at least one effort
        return best, counts

    def _attempt(
        self, columns: Float64, index: TriangleIndex, counts: dict[str, int], times: StageTimes
    ) -> LandmarkSearch:
        positions = columns[:, :3].copy()
        with times("matching"):
            matches = index.matches(positions, columns[:, 6])
        counts["matches"] = len(matches)
        with times("pose"):
            candidates = self._candidates(positions, matches)[: index.effort.most_candidates]
        counts["candidates"] = len(candidates)
        with times("verification"):
            return self._decide(columns, candidates, counts)

    def _candidates(self, positions: Float64, matches: Matches) -> list[Candidate]:
        if not len(matches):
            return []
        return self._estimator.estimate(positions, self.prior_map.positions, matches)

    def _decide(
        self, columns: Float64, candidates: list[Candidate], counts: dict[str, int]
    ) -> LandmarkSearch:
        for what, reason in (
            ("segments", Reason.NO_SEGMENTS),
            ("matches", Reason.NO_MATCHES),
            ("candidates", Reason.NO_CONSISTENT_MATCHES),
        ):
            if not counts[what]:
                return LandmarkSearch(Posterior(), reason, reason.value)
        best, *others = self._map.best(columns, candidates)
        found = self._conclude(best, others, len(columns))
        if found.reason is None and (shifted := self._map.shift(columns, best)) is not None:
            found = self._conclude(best, [*others, shifted], len(columns))
        return found

    def _conclude(self, best: Agreement, others: list[Agreement], count: int) -> LandmarkSearch:
        """Compute the posterior of the best place and the runner-up."""
        elsewhere = [a for a in others if _NEARBY.apart(a.T_map_local, best.T_map_local)]
        runner_up = max(elsewhere, key=lambda found: found.support, default=None)
        found = [best] if runner_up is None else [best, runner_up]
        supports = [best.support, 0.0 if runner_up is None else runner_up.support]
        posterior = Posterior.of([scored_pose(a, supports, count) for a in found])
        needed = self.config.min_confidence
        return LandmarkSearch(posterior, posterior.reason(needed), posterior.message(needed), found)


@dataclass(frozen=True)
class LandmarkSearch:
    """Result of one search.

    Attributes
    ----------
    posterior : Posterior
    reason : Reason or None
        Why the most probable place is rejected; None if it is accepted.
    message : str
        The reason as a sentence with its figures.
    agreements : sequence of Agreement
        The best pose, and the runner-up.
    """

    posterior: Posterior
    reason: Reason | None
    message: str
    agreements: Sequence[Agreement] = ()


def scored_pose(agreement: Agreement, supports: Sequence[float], count: int) -> ScoredPose:
    """Return a pose with its log-ratio.

    Parameters
    ----------
    agreement : Agreement
    supports : sequence of float
        Supports of this pose and of the runner-up, in any order.
    count : int
        Number of landmarks of the query.
    """
    other = min(supports) if agreement.support == max(supports) else max(supports)
    share, ratio = agreement.support / count, agreement.support / max(other, _CHANCE_SUPPORT)
    logs = (math.log(max(value, _MIN_VALUE)) for value in (share, ratio, agreement.support))
    features = (1.0, *logs)
    return ScoredPose(
        T_map_local=agreement.T_map_local,
        log_ratio=sum(weight * x for weight, x in zip(_WEIGHTS, features, strict=True)),
        inliers=agreement.inliers,
        overlap=share,
        rmse=agreement.rmse,
        features=features,
    )


def _answer(
    found: LandmarkSearch, count: int, T_local_sensor: Pose, common: dict[str, Any]
) -> Localization:
    posterior = found.posterior
    if found.agreements:
        best = found.agreements[0]
        common["inliers"], common["rmse"] = best.inliers, best.rmse
        common["overlap"] = best.support / count
    common["confidence"], common["not_in_map"] = posterior.confidence, posterior.not_in_map
    common["places"] = tuple(
        Place(place.T_map_local @ T_local_sensor, p, place.inliers, place.overlap)
        for place, p in zip(posterior.places, posterior.probabilities, strict=True)
    )
    if found.reason is not None or posterior.best is None:
        reason = found.reason or Reason.NO_SEGMENTS
        return NotLocalized(reason=reason, message=found.message, **common)
    return Localized(T_map_sensor=posterior.best.T_map_local @ T_local_sensor, **common)
