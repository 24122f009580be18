"""Bayes filter over the possible places of a robot and "lost": none of them.

It needs no clouds and no clock: poses are ``T_map_odom``, and time is the distance travelled.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np
from pydantic import Field

from .. import geometry
from ..system.section import Section
from ..types import Float64, Pose

_MIN_PROBABILITY = 1e-3
"""Hypotheses below this are dropped."""
_WRONG_HEIGHT, _CONTRADICTS = 0.002, -4.5
"""Share of observed heights that are wrong, and log-ratio below which one contradicts a place."""
_LEAST_HEIGHT_M = 0.3
"""Least standard deviation of a height: floors are not level, and maps lean."""


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
    drift_tilt_deg: float = Field(
        1.0,
        ge=0,
        description="tilt error of odometry, as of a planar one on ramps [deg/m]",
    )
    drift_up: float = Field(
        0.3, ge=0, description="height error of odometry, as of a planar one on stairs [m/m]"
    )
    leak: float = Field(
        0.004, gt=0, description="probability to leave the track, kidnapped or slipping [1/m]"
    )
    jump_m: float = Field(
        75.0, ge=0, description="unobserved travel that a jump of the odometry counts as [m]"
    )


@dataclass(frozen=True)
class Reading:
    """Fit of a view at one place.

    Attributes
    ----------
    T_map_odom : (4, 4) float64
    evidence : float
        Log-ratio of the view from a pose that is known already against one from elsewhere.
    told : float
        How much a view from there can say, in [0, 1].
    log_ratio : float
        Log-ratio of a place that was not known, as of a single query, against none of the places.
    covariance : (6, 6) float64 or None
        Covariance of the sensor's pose in the map, as :attr:`segloc.Localized.covariance`.
    """

    T_map_odom: Pose
    evidence: float
    told: float = 1.0
    log_ratio: float = -math.inf
    covariance: Float64 | None = None


@dataclass(frozen=True)
class View:
    """One cloud, measured at all places after ``at`` metres (:attr:`Belief.travelled`).

    Attributes
    ----------
    new : float
        Share of the view that no earlier view contained.
    places : sequence of Reading
        Fits at hypotheses and, after a search of the map, at places that it found.
    searched : bool
        Whether the map was searched: new places may enter.
    """

    at: float
    T_odom_sensor: Pose
    new: float = 1.0
    places: Sequence[Reading] = ()
    searched: bool = False

    def reading(self, T_map_odom: Pose, separation: geometry.Separation) -> Reading | None:
        """Return the fit at the place of a pose T_map_odom; None if it was not compared."""
        T_sensor = _upright(self.T_odom_sensor)
        T = T_map_odom @ T_sensor
        here = (p for p in self.places if not separation.apart(T, p.T_map_odom @ T_sensor))
        return next(here, None)


@dataclass(frozen=True)
class Height:
    """Height of the sensor in the map [m], observed after ``at`` metres from ``T_odom_sensor``."""

    metres: float
    sigma_m: float
    at: float
    T_odom_sensor: Pose

    def expected(self, T_odom_sensor: Pose, at: float, drift_up: float) -> tuple[float, float]:
        """Return the height elsewhere on the path, and its standard deviation [m]."""
        climbed = float(T_odom_sensor[2, 3] - self.T_odom_sensor[2, 3])
        sigma = math.hypot(self.sigma_m, drift_up * (at - self.at), _LEAST_HEIGHT_M)
        return self.metres + climbed, sigma


@dataclass
class Hypothesis:
    """A possible place of the robot; its pose was measured ``at`` and from ``T_odom_sensor``.

    ``evidence`` is that of the newest view here, taken at ``seen_at``; ``height`` is the log-ratio
    of the newest observed height, which the probability contains. ``views`` counts the views
    that support it, overlapping ones by their new share. It is ``accepted`` from ``min_confidence``
    on, for as long as it is more probable than not. ``doubted`` has the pose to which a single
    view has moved it too far.
    """

    key: int
    T_map_odom: Pose
    T_odom_sensor: Pose
    covariance: Float64 | None
    at: float
    probability: float
    evidence: float
    seen_at: float = -math.inf
    views: float = 1.0
    accepted: bool = False
    doubted: Hypothesis | None = None
    height: float = 0.0


class Belief:
    """Probabilities of hypotheses, predicted by odometry and updated by views.

    Parameters
    ----------
    config : BeliefConfig
    min_confidence : float
        Probability from which a hypothesis is accepted.
    separation : Separation
        Of distinct places.
    alike : callable
        Returns how alike the evidence of two views so many metres apart is, in [0, 1].

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
        self,
        config: BeliefConfig,
        min_confidence: float,
        separation: geometry.Separation,
        alike: Callable[[float], float],
    ) -> None:
        self.config, self._separation, self._alike = config, separation, alike
        self.min_confidence = min_confidence
        self.travelled, self._count = 0.0, 0
        self.height: Height | None = None
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
            h.probability *= kept
        self._normalize(self.track)

    def follow_jump(self, T_new_old: Pose, problem: str) -> None:
        """Follow a jump of the odometry, as of a robot at rest."""
        for h in self.hypotheses:
            h.T_map_odom = h.T_map_odom @ geometry.inverse(T_new_old)
            h.T_odom_sensor, h.doubted = T_new_old @ h.T_odom_sensor, None
        if self.height is not None:
            self.height = replace(self.height, T_odom_sensor=T_new_old @ self.height.T_odom_sensor)
        self.problem = problem
        self.move(self.config.jump_m)

    def suppose(self, T_map_odom: Pose, T_odom_sensor: Pose, probability: float) -> None:
        """Take a pose known from elsewhere instead of all hypotheses, until views confirm it."""
        self.clear()
        self._count += 1
        where = self._count, T_map_odom, T_odom_sensor, None, self.travelled
        self.hypotheses, self.lost = (
            [Hypothesis(*where, probability, 0.0, views=0.0)],
            1.0 - probability,
        )

    def observe(self, height: Height) -> bool:
        """Update by an observed height of the sensor.

        Of the errors of heights, as of a barometer in changing weather, one is much like the next:
        an observation replaces the one before. It excludes places, and confirms none: that of a
        robot that is lost is unknown.

        Returns
        -------
        bool
            True if it contradicts the track, as :meth:`update`.
        """
        track, self.height = self.track, height
        contradicted = False
        for h in self.hypotheses:
            told = self._height_ratio(h)
            h.probability *= math.exp(told - h.height)
            if h is track and (contradicted := told < _CONTRADICTS <= h.height):
                self.problem = "the height contradicts the track"
            h.height = told
        self._normalize(track)
        return contradicted

    def _height_ratio(self, h: Hypothesis) -> float:
        """Return the log-ratio of the observed height at a hypothesis against "lost"."""
        if self.height is None:
            return 0.0
        metres, sigma = self.height.expected(h.T_odom_sensor, h.at, self.config.drift_up)
        off = float((h.T_map_odom @ h.T_odom_sensor)[2, 3]) - metres
        fits = math.exp(-0.5 * (off / sigma) ** 2)
        return math.log((1.0 - _WRONG_HEIGHT) * fits + _WRONG_HEIGHT)

    def update(self, view: View) -> bool:
        """Update by Bayes' rule: every place is compared with the same cloud.

        A hypothesis gains what the view says beside the one before it: what looks like the map, or
        does not, is seen again in the next view. (Evidence is taken as a process of first order,
        whose correlation decays with the way.) A place that a search finds has at least the
        probability of "lost" times its ratio: from "lost" alone, one view gives the posterior of a
        single query.

        Returns
        -------
        bool
            True if the view contradicts the track. Earlier scans may then be of another place.
        """
        track, fresh = self.track, list(view.places)
        contradicted = False
        for h in self.hypotheses:
            seen = view.reading(h.T_map_odom, self._separation)
            if seen is None:
                continue
            fresh = [p for p in fresh if p is not seen]
            alike = self._alike(view.at - h.seen_at)
            before = alike * h.evidence
            gain = (seen.evidence - seen.told * before) / (1.0 + alike)
            h.probability *= math.exp(gain)
            h.evidence, h.seen_at = seen.evidence + (1.0 - seen.told) * before, view.at
            if view.searched:
                h.probability = max(h.probability, self._share_of(seen) * math.exp(h.height))
            if seen.evidence > 0.0:
                h.views += view.new
                self._move(h, seen, view)
            if h is track:
                contradicted = gain < -math.log(2.0)
                if contradicted or seen.evidence > 0.0:
                    self.problem = "the map contradicts the track" if contradicted else ""
        for place in fresh if view.searched else ():
            self._add(place, view)
        self._merge(view)
        self._normalize(track)
        return contradicted

    def status(self) -> tuple[Status, str]:
        """Return the status, and why it is not better."""
        if (track := self.track) is not None:
            if track.probability >= self.config.localized_from:
                return Status.LOCALIZED, ""
            return Status.DEGRADED, self.problem or self._loss_reason(track)
        if self.lost < 0.5:
            several = sum(h.probability > 0.1 for h in self.hypotheses) > 1
            return Status.CANDIDATE, "several places fit" if several else "no agreement yet"
        return Status.LOST, self.problem or "nothing found"

    def covariance(self, T_odom_sensor: Pose) -> Float64 | None:
        """Return the covariance of the track's pose, with the drift since it was measured."""
        track = self.track
        return None if track is None else self._predict(track, T_odom_sensor, self.travelled)

    def _predict(self, h: Hypothesis, T_odom_sensor: Pose, at: float) -> Float64 | None:
        """Return the covariance of a pose after ``at`` metres, with the drift until then."""
        if h.covariance is None:
            return None
        path, config = max(0.0, at - h.at), self.config
        tilt, turn = math.radians(config.drift_tilt_deg), math.radians(config.drift_deg)
        drift = tilt, tilt, turn, config.drift, config.drift, config.drift_up
        R = np.kron(np.eye(2), T_odom_sensor[:3, :3])  # from the sensor's axes to the odometry's
        grown = R.T @ np.diag(np.square(path * np.array(drift))) @ R
        T_now_then = geometry.inverse(T_odom_sensor) @ h.T_odom_sensor
        predicted: Float64 = geometry.carried_covariance(h.covariance, T_now_then) + grown
        return predicted

    def _add(self, place: Reading, view: View) -> None:
        """Add a place: it takes its share of "lost"."""
        self._count += 1
        where = self._count, place.T_map_odom, view.T_odom_sensor, place.covariance, view.at
        h = Hypothesis(*where, self._share_of(place), place.evidence, view.at)
        h.height = self._height_ratio(h)
        h.probability *= math.exp(h.height)
        self.hypotheses.append(h)

    def _share_of(self, place: Reading) -> float:
        """Return the probability of a place, before normalisation, if it was lost before."""
        return self.lost * math.exp(place.log_ratio)

    def _move(self, h: Hypothesis, seen: Reading, view: View) -> None:
        """Correct the pose by a measured one, both by their covariances.

        A correction beyond what both allow is made once another view repeats it.
        """
        T_sensor = view.T_odom_sensor
        before = self._predict(h, T_sensor, view.at)
        if seen.covariance is None or view.new == 0.0:
            return
        T, covariance = seen.T_map_odom, seen.covariance
        if before is not None:
            step, both = _step(h, seen, T_sensor), before + seen.covariance / view.new
            if geometry.allows(both, step):
                gain = np.linalg.solve(both, before).T
                T = geometry.displace(h.T_map_odom @ T_sensor, gain @ step)
                T = T @ geometry.inverse(T_sensor)
                covariance = before - gain @ before
            elif not self._repeats(h.doubted, seen, T_sensor, view.at):
                there = replace(h, T_map_odom=T, T_odom_sensor=T_sensor, covariance=covariance)
                h.doubted = replace(there, at=view.at, doubted=None)
                return
        h.T_map_odom, h.covariance = T, (covariance + covariance.T) / 2.0
        h.T_odom_sensor, h.at, h.doubted = T_sensor, view.at, None

    def _repeats(
        self, doubted: Hypothesis | None, seen: Reading, T_odom_sensor: Pose, at: float
    ) -> bool:
        """Return whether a measured pose agrees with a doubted one, carried on by odometry."""
        if doubted is None:
            return False
        predicted = self._predict(doubted, T_odom_sensor, at)
        assert seen.covariance is not None and predicted is not None
        return geometry.allows(predicted + seen.covariance, _step(doubted, seen, T_odom_sensor))

    def _merge(self, view: View) -> None:
        """Merge hypotheses of one place, at the pose of the most probable."""
        merged, T_sensor = list[Hypothesis](), _upright(view.T_odom_sensor)
        for h in sorted(self.hypotheses, key=lambda h: -h.probability):
            T, apart = h.T_map_odom @ T_sensor, self._separation.apart
            same = (m for m in merged if not apart(m.T_map_odom @ T_sensor, T))
            if (m := next(same, None)) is None:
                merged.append(h)
            else:
                m.probability, m.key = m.probability + h.probability, min(m.key, h.key)
                m.views, m.accepted = max(m.views, h.views), m.accepted or h.accepted
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
            self.problem = self.problem or (self._loss_reason(before) if before else "")
        elif before is None or track.key != before.key:
            self.problem = ""

    def _loss_reason(self, track: Hypothesis) -> str:
        metres = self.travelled - track.at
        if metres < 0.5:
            return "no agreement yet"
        return f"no view supports the track for {metres:.0f} m"


def _upright(T_odom_sensor: Pose) -> Pose:
    """Return a pose without its rotation: z must be up where places are told apart."""
    return geometry.rigid(np.eye(3), T_odom_sensor[:3, 3])


def _step(h: Hypothesis, seen: Reading, T_odom_sensor: Pose) -> Float64:
    """Return the displacement of the sensor from a hypothesis to a measured pose, (6,)."""
    return geometry.displacement(h.T_map_odom @ T_odom_sensor, seen.T_map_odom @ T_odom_sensor)
