"""The probability of every place that a robot may be at, carried on from view to view.

A Bayes filter of few hypotheses, and of "lost": that the robot is at none of them. No clouds, no
clocks: poses are ``T_map_odom``, and time is the distance travelled.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np
from pydantic import Field

from .. import geometry
from ..system.section import Section
from ..types import Float64, Pose

CONTRADICTED = "the map contradicts the track"
_LEAST = 1e-3
"""A hypothesis less probable than this is dropped."""


class Status(str, Enum):
    """How well the pose of a robot is known."""

    LOST = "lost"
    CANDIDATE = "candidate"
    LOCALIZED = "localized"
    DEGRADED = "degraded"

    def __str__(self) -> str:
        return self.value


class BeliefConfig(Section):
    """How odometry errs, and how much a view counts."""

    min_confidence: float | None = Field(
        None,
        gt=0.5,
        lt=1,
        description="probability from which a pose is believed; none: that of a single query",
    )
    drift: float = Field(0.02, ge=0, description="position error of odometry per distance [m/m]")
    drift_deg: float = Field(0.05, ge=0, description="heading error of odometry [deg/m]")
    leak: float = Field(
        0.006,
        gt=0,
        description="probability that the robot leaves its track, carried away or slipping [1/m]",
    )
    jump_m: float = Field(
        50.0, ge=0, description="unobserved travel that a jump of the odometry counts as [m]"
    )
    max_log_ratio: float = Field(
        4.0,
        gt=0,
        description="bound of the log-likelihood ratio of a view, so that no wrong one is final",
    )


@dataclass(frozen=True)
class Reading:
    """How well a view fits at one pose.

    Attributes
    ----------
    T_map_odom : (4, 4) float64
    log_ratio : float
        Natural logarithm of how much likelier the view is from there than from none of the map,
        the prior probability of the place included.
    log_prior : float
        The same of a pose that shows nothing of the map.
    covariance : (6, 6) float64 or None
        Of the sensor's pose in the map, as :attr:`segloc.Localized.covariance`.
    """

    T_map_odom: Pose
    log_ratio: float
    log_prior: float = 0.0
    covariance: Float64 | None = None


@dataclass(frozen=True)
class View:
    """What one view shows.

    Attributes
    ----------
    at : float
        Distance travelled [m], as :attr:`Belief.travelled`.
    T_odom_sensor : (4, 4) float64
    checks : dict of int to Reading
        Of the newest scan alone, at the hypotheses with these keys.
    places : tuple of Reading
        Where a search over the map found it.
    new_check, new_search : float
        Share of the newest scan, and of the search's cloud, that no earlier view has, in [0, 1].
    """

    at: float
    T_odom_sensor: Pose
    checks: Mapping[int, Reading]
    places: Sequence[Reading] = ()
    new_check: float = 1.0
    new_search: float = 1.0


@dataclass(frozen=True)
class Hypothesis:
    """One place that the robot may be at.

    Attributes
    ----------
    key : int
        Unique.
    T_map_odom : (4, 4) float64
    T_odom_sensor : (4, 4) float64
        Where the sensor was when that was measured.
    covariance : (6, 6) float64 or None
        Of the sensor's pose there and then.
    at : float
        Distance travelled then [m].
    log_weight : float
        Logarithm of its probability.
    views : float
        Views that speak for it; of overlapping ones, the share that is new.
    believed : bool
        Whether it is, or was and is still more probable than not.
    """

    key: int
    T_map_odom: Pose
    T_odom_sensor: Pose
    covariance: Float64 | None
    at: float
    log_weight: float
    views: float = 1.0
    believed: bool = False

    @property
    def probability(self) -> float:
        """In [0, 1]."""
        return math.exp(min(0.0, self.log_weight))


class Belief:
    """Hypotheses with their probabilities.

    Parameters
    ----------
    min_confidence : float
        Probability from which a hypothesis is believed, above 0.5.
    config : BeliefConfig, optional
    separation : Separation, optional
        Hypotheses closer than this are one.

    Attributes
    ----------
    hypotheses : tuple of Hypothesis
        The most probable first; the rest to 1 is the probability of "lost".
    travelled : float
        Distance travelled, jumps of the odometry included [m].
    doubt : str
        What speaks against the track, or ended it; "" if nothing.
    """

    def __init__(
        self,
        min_confidence: float,
        config: BeliefConfig | None = None,
        separation: geometry.Separation | None = None,
    ) -> None:
        self.config = config or BeliefConfig()
        self._min_confidence = self.config.min_confidence or min_confidence
        self._log_odds = math.log(self._min_confidence / (1.0 - self._min_confidence))
        self._apart = (separation or geometry.Separation()).apart
        self.hypotheses: tuple[Hypothesis, ...] = ()
        self.travelled, self.doubt = 0.0, ""
        self._log_lost, self._count = 0.0, 0

    @property
    def track(self) -> Hypothesis | None:
        """The hypothesis that is believed."""
        return next((h for h in self.hypotheses if h.believed), None)

    @property
    def lost(self) -> float:
        """Probability that the robot is at none of the hypotheses."""
        return math.exp(min(0.0, self._log_lost))

    def same(self, T_a: Pose, T_b: Pose) -> bool:
        """Whether two poses in the map are of one place."""
        return not self._apart(T_a, T_b)

    def clear(self) -> None:
        """Forget everything but the distance."""
        self.hypotheses, self._log_lost, self.doubt = (), 0.0, ""

    def move(self, metres: float) -> None:
        """Follow the odometry: all hypotheses move with it, and leak to "lost"."""
        self.travelled += metres
        kept = -self.config.leak * metres
        leaked = (1.0 - self.lost) * -math.expm1(kept)
        moved = [replace(h, log_weight=h.log_weight + kept) for h in self.hypotheses]
        self._settle(moved, math.log(self.lost + leaked) if self.lost + leaked else -math.inf)

    def carry(self, T_new_old: Pose, doubt: str) -> None:
        """Follow a jump of the odometry, as if the robot had stood still, with less certainty."""
        back = geometry.inverse(T_new_old)
        self.hypotheses = tuple(
            replace(h, T_map_odom=h.T_map_odom @ back, T_odom_sensor=T_new_old @ h.T_odom_sensor)
            for h in self.hypotheses
        )
        self.doubt = doubt
        self.move(self.config.jump_m)

    def update(self, view: View) -> None:
        """Weigh the hypotheses by a view; places that none of them is at become hypotheses.

        A new place takes the probability of "lost" and the view's whole log-ratio: from "lost"
        alone, one view gives what a single query does. A hypothesis takes the share of the ratio
        that is new, bounded, without the prior.
        """
        updated = [self._seen(h, view) for h in self.hypotheses]
        speaks_against = bool(updated) and self._speaks_against(self.hypotheses[0], updated[0])
        had_track = self.track
        for place in view.places:
            if not any(self._is_at(h.T_map_odom, place, view) for h in self.hypotheses):
                updated.append(self._new(place, view))
        self._settle(self._merged(updated, view), self._log_lost)
        if speaks_against and had_track is not None:
            self.doubt = CONTRADICTED
        elif self.track is not None and self.track.at >= view.at:
            self.doubt = ""

    def status(self) -> tuple[Status, str]:
        """How well the pose is known, and why not better."""
        track = self.track
        if track is None and self.lost < 0.5:
            several = len([h for h in self.hypotheses if h.probability > 0.1]) > 1
            return Status.CANDIDATE, "several places fit" if several else "no agreement yet"
        if track is None:
            return Status.LOST, self.doubt or "nothing found"
        if track.probability >= self._min_confidence:
            return Status.LOCALIZED, ""
        return Status.DEGRADED, self.doubt or self._unsupported(track)

    def covariance(self, T_odom_sensor: Pose) -> Float64 | None:
        """Of the sensor's pose in the map, grown by the drift since it was measured."""
        track = self.track
        if track is None or track.covariance is None:
            return None
        T_now_then = geometry.inverse(T_odom_sensor) @ track.T_odom_sensor
        carried = geometry.carried_covariance(track.covariance, T_now_then)
        path = max(0.0, self.travelled - track.at)
        turn, shift = math.radians(self.config.drift_deg) * path, self.config.drift * path
        return carried + np.diag(np.repeat([turn**2, shift**2], 3))

    # --- inside --------------------------------------------------------------------------------

    def _seen(self, old: Hypothesis, view: View) -> Hypothesis:
        """A hypothesis after a view: its weight, and its pose where that was measured."""
        place = next((p for p in view.places if self._is_at(old.T_map_odom, p, view)), None)
        check, most = view.checks.get(old.key), self.config.max_log_ratio
        seen = old
        for reading, share in ((place, view.new_search), (check, view.new_check)):
            if reading is None:
                continue
            ratio = share * min(max(reading.log_ratio - reading.log_prior, -most), most)
            views = seen.views + share * (ratio > 0)
            seen = replace(seen, log_weight=seen.log_weight + ratio, views=views)
            if reading.log_ratio >= self._log_odds and reading.covariance is not None:
                seen = self._measured(seen, reading, view)
        return seen

    @staticmethod
    def _measured(old: Hypothesis, reading: Reading, view: View) -> Hypothesis:
        return replace(
            old,
            T_map_odom=reading.T_map_odom,
            T_odom_sensor=view.T_odom_sensor,
            covariance=reading.covariance,
            at=view.at,
        )

    def _new(self, place: Reading, view: View) -> Hypothesis:
        self._count += 1
        weight = self._log_lost + place.log_ratio
        T, covariance = place.T_map_odom, place.covariance
        return Hypothesis(self._count, T, view.T_odom_sensor, covariance, view.at, weight)

    @staticmethod
    def _speaks_against(old: Hypothesis, new: Hypothesis) -> bool:
        return new.log_weight < old.log_weight

    def _is_at(self, T_map_odom: Pose, place: Reading, view: View) -> bool:
        T = view.T_odom_sensor
        return self.same(T_map_odom @ T, place.T_map_odom @ T)

    def _merged(self, hypotheses: Sequence[Hypothesis], view: View) -> list[Hypothesis]:
        """Each place once, with the weight of all hypotheses that are there."""
        merged: list[Hypothesis] = []
        T = view.T_odom_sensor
        for h in sorted(hypotheses, key=lambda h: -h.log_weight):
            for k, other in enumerate(merged):
                if self.same(other.T_map_odom @ T, h.T_map_odom @ T):
                    weight = float(np.logaddexp(other.log_weight, h.log_weight))
                    believed = other.believed or h.believed
                    merged[k] = replace(other, log_weight=weight, believed=believed)
                    break
            else:
                merged.append(h)
        return merged

    def _settle(self, hypotheses: Sequence[Hypothesis], log_lost: float) -> None:
        """Normalise, drop the improbable, and decide which is believed."""
        weights = [log_lost, *(h.log_weight for h in hypotheses)]
        total = float(np.logaddexp.reduce(weights))
        kept, before = list[Hypothesis](), self.track
        for h in sorted(hypotheses, key=lambda h: -h.log_weight):
            h = replace(h, log_weight=h.log_weight - total)
            believed = h.probability >= (0.5 if h.believed else self._min_confidence)
            if h.probability >= _LEAST:
                kept.append(replace(h, believed=believed))
        self.hypotheses = tuple(kept)
        rest = 1.0 - sum(h.probability for h in kept)
        self._log_lost = log_lost - total if len(kept) == len(hypotheses) else math.log(rest)
        if before is not None and self.track is None:
            self.doubt = self.doubt or self._unsupported(before)

    def _unsupported(self, track: Hypothesis) -> str:
        return f"nothing supports the track since {self.travelled - track.at:.0f} m"
