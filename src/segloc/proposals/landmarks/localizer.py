"""Landmarks -> triangles -> matches -> poses -> verdict, on one page."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass
from typing import Any

from ...errors import ConfigError, InvalidScan
from ...geometry import Separation
from ...localization import Localization, Localized, NotLocalized, Reason, RunnerUp, ambiguous_with
from ...system.stage_times import Clock, StageTimes
from ...types import Candidate, Float64, Matches, Pose
from ..pose import PoseEstimator
from .agreement import Agreement, MapLandmarks
from .config import LandmarkConfig
from .landmark_map import LandmarkMap
from .landmarks import Landmarks, levelling
from .triangles import TriangleIndex

_NEARBY = Separation(metres=1.0, degrees=5.0)
"""Rivals of a pose are at least so far from it: rows of trees may stand 2 m apart."""
CHANCE_SUPPORT = 3.0
"""What some wrong place of a map has almost always; a rival is not taken to have less."""
CONFIDENCE = (2.42, 8.48, 14.81)
"""Log-odds that a pose is right: a constant, times log(share), times log(ratio). Fitted by
``segloc_lab.calibration.landmarks``."""
_LEAST = 1e-3


class LandmarkLocalizer:
    """Finds the pose of the sensor in a map of landmarks, with no initial guess.

    Parameters
    ----------
    prior_map : LandmarkMap
    config : LandmarkConfig, optional
    clock : callable
        What the times of the stages are measured by; returns seconds.

    Raises
    ------
    ConfigError
        If it is given something else than a map of landmarks.

    Notes
    -----
    Any number of threads may use one localizer at once: queries change nothing in it.
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
        """The pose of the sensor in the map, or the reason why there is none.

        Parameters
        ----------
        landmarks : Landmarks
            What one scan shows.

        Raises
        ------
        InvalidScan
            If it is given something else. Never raised for "not found".
        """
        if not isinstance(landmarks, Landmarks):
            raise InvalidScan(f"a query is Landmarks, not {type(landmarks).__name__}")
        times = StageTimes(self._clock)
        with times("gathering"):
            T_local_sensor = levelling(landmarks.directions)
            columns = landmarks.moved(T_local_sensor)
        best, counts = self.judged(columns, times)
        common = {"counts": counts, "times_ms": times.with_total(), "stamp": landmarks.stamp}
        return _answer(best, len(landmarks), T_local_sensor, common)

    def judged(
        self, columns: Float64, times: StageTimes | None = None
    ) -> tuple[LandmarkVerdict, dict[str, int]]:
        """The verdict on landmarks in a frame whose z axis points up, and the counts of stages.

        Parameters
        ----------
        columns : (N, 7) float64
            Positions, axes and diameters.
        times : StageTimes, optional
        """
        times = times or StageTimes(self._clock)
        counts: dict[str, int] = {"segments": len(columns)}
        best: LandmarkVerdict | None = None
        for effort, index in enumerate(self._indices, start=1):
            counts["efforts"] = effort
            verdict = self._attempt(columns, index, counts, times)
            if best is None or verdict.rank > best.rank:
                best = verdict
            if not verdict.undecided:
                break
        assert best is not None  # there is at least one effort
        return best, counts

    def _attempt(
        self, columns: Float64, index: TriangleIndex, counts: dict[str, int], times: StageTimes
    ) -> LandmarkVerdict:
        positions = columns[:, :3].copy()
        with times("matching"):
            matches = index.matches(positions, columns[:, 6])
        counts["matches"] = len(matches)
        with times("pose"):
            candidates = self._candidates(positions, matches)[: index.effort.most_candidates]
        counts["candidates"] = len(candidates)
        with times("verification"):
            return self._verdict(columns, candidates, counts)

    def _candidates(self, positions: Float64, matches: Matches) -> list[Candidate]:
        if not len(matches):
            return []
        return self._estimator.estimate(positions, self.prior_map.positions, matches)

    def _verdict(
        self, columns: Float64, candidates: list[Candidate], counts: dict[str, int]
    ) -> LandmarkVerdict:
        for what, reason in (
            ("segments", Reason.NO_SEGMENTS),
            ("matches", Reason.NO_MATCHES),
            ("candidates", Reason.NO_CONSISTENT_MATCHES),
        ):
            if not counts[what]:
                return LandmarkVerdict(reason, reason.value)
        best, *others = self._map.best(columns, candidates)
        rival = _best_elsewhere(best, others)
        verdict = decide(best, rival, len(columns), self.config)
        if verdict.reason is not None:
            return verdict
        shifted = self._map.shifted(columns, best)
        rival = _best_elsewhere(best, [a for a in (rival, shifted) if a is not None])
        return decide(best, rival, len(columns), self.config)


def _best_elsewhere(best: Agreement, others: list[Agreement]) -> Agreement | None:
    elsewhere = [a for a in others if _NEARBY.apart(a.T_map_local, best.T_map_local)]
    return max(elsewhere, key=lambda found: found.support, default=None)


def _answer(
    verdict: LandmarkVerdict, landmarks: int, T_local_sensor: Pose, common: dict[str, Any]
) -> Localization:
    best, rival = verdict.best, verdict.rival
    if best is not None:
        common["inliers"], common["rmse"] = best.inliers, best.rmse
        common["overlap"] = best.support / landmarks
        common["inlier_ratio"] = ratio_to_rival(best, rival)
    if best is not None and rival is not None:
        T = rival.T_map_local @ T_local_sensor
        common["runner_up"] = RunnerUp(T, rival.inliers, rival.support / landmarks)
    common["confidence"] = verdict.confidence
    if verdict.reason is not None or best is None:
        return NotLocalized(
            reason=verdict.reason or Reason.NO_SEGMENTS, message=verdict.message, **common
        )
    return Localized(T_map_sensor=best.T_map_local @ T_local_sensor, **common)


@dataclass(frozen=True)
class LandmarkVerdict:
    """What is decided of a query.

    Attributes
    ----------
    reason : Reason or None
        Why no pose is believed; None where the best is.
    message : str
        The same as a sentence with its figures; "" where a pose is believed.
    confidence : float
        Probability that the best is right, in [0, 1].
    best, rival : Agreement or None
        The best pose, and the best one at another place.
    """

    reason: Reason | None
    message: str = ""
    confidence: float = 0.0
    best: Agreement | None = None
    rival: Agreement | None = None

    @property
    def undecided(self) -> bool:
        """Whether too little spoke for any pose, so that more matches may help."""
        return self.reason is not None and self.reason is not Reason.AMBIGUOUS

    @property
    def rank(self) -> tuple[bool, float]:
        """The better of two verdicts on one query has the higher one."""
        return self.reason is None, self.best.support if self.best else 0.0


def decide(
    best: Agreement, rival: Agreement | None, landmarks: int, config: LandmarkConfig
) -> LandmarkVerdict:
    """Believe a pose, or say why not.

    A pose is believed when enough of the query's landmarks lie on the map's, in number and as a
    share, no other place has nearly as many, and its calibrated probability is high enough.
    """
    share, ratio = best.support / max(landmarks, 1), ratio_to_rival(best, rival)
    confidence = probability(share, ratio)
    reason, message = None, ""
    if best.support < config.min_support:
        reason = Reason.TOO_FEW_INLIERS
        message = f"too few inliers (support {best.support:.1f} < {config.min_support:g})"
    elif share < config.min_share:
        reason = Reason.TOO_LITTLE_OVERLAP
        message = reason.below(share, config.min_share)
    elif rival is not None and rival.support > config.max_rival * best.support:
        reason, message = Reason.AMBIGUOUS, ambiguous_with(rival.T_map_local)
    elif confidence < config.min_confidence:
        reason = Reason.TOO_UNCERTAIN
        message = reason.below(confidence, config.min_confidence)
    return LandmarkVerdict(reason, message, confidence, best, rival)


def ratio_to_rival(best: Agreement, rival: Agreement | None) -> float:
    """How many times as much support as the rival, or as chance."""
    return best.support / max(rival.support if rival else 0.0, CHANCE_SUPPORT)


def probability(share: float, ratio: float) -> float:
    """How likely a pose with enough support is to be right, in [0, 1]."""
    constant, of_share, of_ratio = CONFIDENCE
    logit = constant + of_share * math.log(max(share, _LEAST))
    logit += of_ratio * math.log(max(ratio, _LEAST))
    return 1 / (1 + math.exp(-max(-50.0, min(50.0, logit))))
