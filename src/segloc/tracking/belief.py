"""Bayes filter over the possible places of a robot and "lost": none of them.

It needs no clouds and no clock: poses are ``T_map_odom``, and time is the distance travelled.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum

import numpy as np
from pydantic import Field

from .. import geometry
from ..system.section import Section
from ..types import Float64, Pose

_MIN_PROBABILITY = 1e-3
"""Hypotheses below this are dropped."""
_MAX_LOG_RATIO = 300.0
"""Larger log-ratios would overflow."""


class Status(str, Enum):
    """State of localization of a robot."""

    LOST = "lost"
    CANDIDATE = "candidate"
    LOCALIZED = "localized"
    DEGRADED = "degraded"

    def __str__(self) -> str:
        return self.value


class BeliefConfig(Section):
    """Errors of odometry, and weights of views."""

    localized_from: float = Field(
        0.95, gt=0.5, lt=1, description="probability from which a track is not degraded"
    )
    drift: float = Field(0.02, ge=0, description="position error of odometry per distance [m/m]")
    drift_deg: float = Field(0.05, ge=0, description="heading error of odometry [deg/m]")
    leak: float = Field(
        0.004, gt=0, description="probability to leave the track, kidnapped or slipping [1/m]"
    )
    jump_m: float = Field(
        75.0, ge=0, description="unobserved travel that a jump of the odometry counts as [m]"
    )
    max_log_ratio: float = Field(
        4.0, gt=0, description="bound of a view's log-ratio: a wrong view must not be final"
    )


@dataclass(frozen=True)
class Reading:
    """Fit of a view at one pose.

    Attributes
    ----------
    T_map_odom : (4, 4) float64
    log_ratio : float
        Log-likelihood ratio of the view from there against a view from outside the map.
    covariance : (6, 6) float64 or None
        Covariance of the sensor's pose in the map, as :attr:`segloc.Localized.covariance`.
    known_ratio : float
        Log-ratio of a pose that is a hypothesis already: it may be at the end of the map.
    """

    T_map_odom: Pose
    log_ratio: float
    covariance: Float64 | None = None
    known_ratio: float = 0.0


@dataclass(frozen=True)
class View:
    """Fits measured after ``at`` metres (:attr:`Belief.travelled`), from ``T_odom_sensor``.

    Attributes
    ----------
    new_check, new_search : float
        Shares of the newest scan, and of the cloud of the search, that no earlier view contained.
    checks : dict of int to Reading
        Fits of the newest scan at hypotheses, by their keys.
    places : sequence of Reading
        Places found by a search of the map.
    """

    at: float
    T_odom_sensor: Pose
    new_check: float = 1.0
    new_search: float = 1.0
    checks: Mapping[int, Reading] = field(default_factory=dict)
    places: Sequence[Reading] = ()


@dataclass
class Hypothesis:
    """A possible place of the robot; its pose was measured ``at`` and from ``T_odom_sensor``.

    ``counted`` is the log-ratio of searches that is part of ``probability``. ``views`` counts the
    views that support it, overlapping ones by their new share. It is ``accepted`` from
    ``min_confidence`` on, for as long as it is more probable than not. ``leaked`` is the
    probability lost since a scan last fitted.
    """

    key: int
    T_map_odom: Pose
    T_odom_sensor: Pose
    covariance: Float64 | None
    at: float
    probability: float
    counted: float
    views: float = 1.0
    accepted: bool = False
    leaked: float = 0.0


class Belief:
    """Probabilities of hypotheses, predicted by odometry and updated by views.

    Attributes
    ----------
    hypotheses : list of Hypothesis
        Hypotheses, the most probable first.
    lost : float
        Probability that the robot is at none of them.
    travelled : float
        Distance, with the unobserved travel of jumps [m].
    problem : str
        Why the track is contradicted or has ended; "" if neither.
    """

    def __init__(
        self, config: BeliefConfig, min_confidence: float, separation: geometry.Separation
    ) -> None:
        self.config, self._separation = config, separation
        self.min_confidence = min_confidence
        self.travelled, self._count = 0.0, 0
        self.clear()

    def clear(self) -> None:
        """Drop all hypotheses."""
        self.hypotheses: list[Hypothesis] = []
        self.lost, self.problem = 1.0, ""

    @property
    def track(self) -> Hypothesis | None:
        """The accepted hypothesis."""
        return next((h for h in self.hypotheses if h.accepted), None)

    def move(self, metres: float) -> None:
        """Predict by odometry: every hypothesis leaks to "lost"."""
        self.travelled += metres
        kept = math.exp(-self.config.leak * metres)
        self.lost = 1.0 - kept * (1.0 - self.lost)
        for h in self.hypotheses:
            h.leaked += (1.0 - kept) * h.probability
            h.probability *= kept
        self._normalize(self.track)

    def follow_jump(self, T_new_old: Pose, problem: str) -> None:
        """Follow a jump of the odometry, as of a robot at rest."""
        for h in self.hypotheses:
            h.T_map_odom = h.T_map_odom @ geometry.inverse(T_new_old)
            h.T_odom_sensor = T_new_old @ h.T_odom_sensor
        self.problem = problem
        self.move(self.config.jump_m)

    def update(self, view: View) -> bool:
        """Update the hypotheses by the places of a search and by the newest scan.

        A new place has the probability of "lost" times its ratio: from "lost" alone, one view gives
        the posterior of a single query. Overlap with earlier searches counts once.

        Returns
        -------
        bool
            True if the newest scan contradicts the track. The earlier scans may then be of another
            place, so the places found with them are ignored.
        """
        track = self.track
        gain = 0.0 if track is None else self._gain(track, view)
        contradicted = gain < -math.log(2.0)
        if gain:
            self.problem = "the map contradicts the track" if contradicted else ""
        for place in () if contradicted else view.places:
            self._add(place, view)
        for h in self.hypotheses:
            if h.key in view.checks:
                self._check(h, view.checks[h.key], view)
        self._merge(view.T_odom_sensor)
        self._normalize(track)
        return contradicted

    def status(self) -> tuple[Status, str]:
        """Return the status, and why it is not better."""
        if (track := self.track) is not None:
            if track.probability >= self.config.localized_from:
                return Status.LOCALIZED, ""
            return Status.DEGRADED, self.problem or self._unsupported(track)
        if self.lost < 0.5:
            several = sum(h.probability > 0.1 for h in self.hypotheses) > 1
            return Status.CANDIDATE, "several places fit" if several else "no agreement yet"
        return Status.LOST, self.problem or "nothing found"

    def covariance(self, T_odom_sensor: Pose) -> Float64 | None:
        """Return the covariance of the track's pose, with the drift since it was measured."""
        track = self.track
        if track is None or track.covariance is None:
            return None
        T_now_then = geometry.inverse(T_odom_sensor) @ track.T_odom_sensor
        path = max(0.0, self.travelled - track.at)
        turn, shift = math.radians(self.config.drift_deg) * path, self.config.drift * path
        grown = np.diag(np.repeat([turn**2, shift**2], 3))
        return geometry.carried_covariance(track.covariance, T_now_then) + grown

    def _add(self, place: Reading, view: View) -> None:
        """Add a place: support the hypotheses there, and take its share of "lost"."""
        new, unknown, most = view.new_search, 1.0, self.config.max_log_ratio
        for h in self.hypotheses:
            if self._same(h.T_map_odom, place.T_map_odom, view.T_odom_sensor):
                counted, unknown = (1.0 - new) * h.counted, new
                h.probability *= math.exp(min(max(0.0, place.log_ratio - counted), most))
                h.counted, h.views = max(place.log_ratio, counted), h.views + new
                self._update_pose(h, place, view)
        ratio = min(place.log_ratio, max(new, self.lost) * place.log_ratio)
        ratio = min(ratio, _MAX_LOG_RATIO if self.lost >= 0.5 else most)
        weight = unknown * self.lost * math.exp(ratio)
        self._count += 1
        where = self._count, place.T_map_odom, view.T_odom_sensor, place.covariance, view.at
        self.hypotheses.append(Hypothesis(*where, weight, ratio))

    def _gain(self, h: Hypothesis, view: View) -> float:
        """Return the log-ratio that the newest scan adds to a hypothesis."""
        seen, most = view.checks.get(h.key), self.config.max_log_ratio
        return 0.0 if seen is None else view.new_check * min(max(seen.known_ratio, -most), most)

    def _check(self, h: Hypothesis, seen: Reading, view: View) -> None:
        """Apply the newest scan. It was compared at few poses, so a fit restores leaked
        probability, and adds none beyond what a search of the map found."""
        gain, fits = self._gain(h, view), seen.log_ratio > 0.0
        if fits:
            h.views += view.new_check
            self._update_pose(h, seen, view)
        if gain > 0.0 and not h.accepted:
            back = h.leaked if fits else 0.0
            h.probability, self.lost = h.probability + back, max(0.0, self.lost - back)
        else:
            h.probability *= math.exp(gain)
        h.leaked = 0.0

    def _update_pose(self, h: Hypothesis, seen: Reading, view: View) -> None:
        """Replace the pose by the measured one, if that alone would be accepted."""
        p = self.min_confidence
        if seen.covariance is not None and seen.log_ratio >= math.log(p / (1.0 - p)):
            h.T_map_odom, h.covariance = seen.T_map_odom, seen.covariance
            h.T_odom_sensor, h.at = view.T_odom_sensor, view.at

    def _same(self, T_a: Pose, T_b: Pose, T_odom_sensor: Pose) -> bool:
        """Return whether two T_map_odom give the sensor the same place."""
        return not self._separation.apart(T_a @ T_odom_sensor, T_b @ T_odom_sensor)

    def _merge(self, T_odom_sensor: Pose) -> None:
        """Merge hypotheses of one place, at the pose of the most probable."""
        merged: list[Hypothesis] = []
        for h in sorted(self.hypotheses, key=lambda h: -h.probability):
            same = (m for m in merged if self._same(m.T_map_odom, h.T_map_odom, T_odom_sensor))
            if (m := next(same, None)) is None:
                merged.append(h)
            else:
                m.probability, m.key = m.probability + h.probability, min(m.key, h.key)
                m.views, m.counted = max(m.views, h.views), max(m.counted, h.counted)
                m.accepted = m.accepted or h.accepted
        self.hypotheses = merged

    def _normalize(self, before: Hypothesis | None) -> None:
        """Normalise, drop improbable hypotheses, and accept a probable one."""
        total = self.lost + sum(h.probability for h in self.hypotheses)
        kept = [h for h in self.hypotheses if h.probability >= _MIN_PROBABILITY * total]
        for h in kept:
            h.probability /= total
            h.accepted = h.probability >= (0.5 if h.accepted else self.min_confidence)
        self.hypotheses = sorted(kept, key=lambda h: -h.probability)
        self.lost = max(0.0, 1.0 - sum(h.probability for h in kept))
        if (track := self.track) is None:
            self.problem = self.problem or (self._unsupported(before) if before else "")
        elif before is None or track.key != before.key:
            self.problem = ""

    def _unsupported(self, track: Hypothesis) -> str:
        return f"no view supports the track for {self.travelled - track.at:.0f} m"
