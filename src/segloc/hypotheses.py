"""What successive views say of where a robot is: one believed track, and candidates for another.

Pure bookkeeping: no clouds, no clocks. Poses are ``T_map_odom``; how old they are is measured by
the distance travelled.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np
from pydantic import Field

from . import geometry
from .section import Section
from .types import Float64, Pose

OFF_THE_MAP = "little of what is seen is in the map"


class Status(str, Enum):
    """How well it is known where the robot is."""

    LOST = "lost"
    CANDIDATE = "candidate"
    LOCALIZED = "localized"
    DEGRADED = "degraded"

    def __str__(self) -> str:
        return self.value


class Check(Enum):
    """What the newest scan says of the track, at its pose alone.

    It fits; it tells nothing; the map has what is not there; or little of it is in the map: its
    end, or another place.
    """

    HOLDS = "holds"
    UNDECIDED = "undecided"
    CONTRADICTS = "contradicts"
    UNMAPPED = "unmapped"


class HypothesesConfig(Section):
    """When hypotheses of different views support each other, and when they are given up."""

    min_confidence: float = Field(0.3, ge=0, le=1, description="less likely ones are not kept")
    tolerance_m: float = Field(1.0, gt=0, description="hypotheses that agree differ by less")
    tolerance_deg: float = Field(3.0, gt=0, description="the same for their headings, degrees")
    drift: float = Field(
        0.02, ge=0, description="odometry errs by this share of the distance travelled"
    )
    drift_deg: float = Field(0.05, ge=0, description="and turns by so many degrees a metre")
    apart_m: float = Field(
        4.0, ge=0, description="travel between two views that witness independently, metres"
    )
    agreeing: int = Field(2, ge=2, description="views that must agree on a hypothesis")
    doubts: int = Field(2, ge=1, description="contradictions in a row that end a track")
    support_m: float = Field(
        30.0, gt=0, description="a track that is not supported for longer is degraded, metres"
    )
    confirm_m: float = Field(
        20.0, gt=0, description="one carried over a jump of the odometry ends without support"
    )
    memory_m: float = Field(150.0, gt=0, description="unsupported hypotheses are kept this long")
    max_kept: int = Field(16, ge=1, description="hypotheses kept between queries")


@dataclass(frozen=True)
class View:
    """What one query says.

    Attributes
    ----------
    at : float
        Metres travelled when its scan was taken.
    T_odom_sensor : (4, 4) float64
        Of its scan.
    T_map_odom : (4, 4) float64 or None
        The best pose; None where nothing is worth keeping.
    confidence : float
        In [0, 1].
    believed : bool
        Whether it passed all gates of verification.
    covariance : (6, 6) float64 or None
        As :attr:`segloc.Localized.covariance`.
    check : Check
        What the newest scan says at the pose of the track.
    T_checked, checked_covariance
        Where the check has put the track; None where it does not hold.
    """

    at: float
    T_odom_sensor: Pose
    T_map_odom: Pose | None = None
    confidence: float = 0.0
    believed: bool = False
    covariance: Float64 | None = None
    check: Check = Check.UNDECIDED
    T_checked: Pose | None = None
    checked_covariance: Float64 | None = None


@dataclass(frozen=True)
class Hypothesis:
    """A pose with the last view that supported it.

    Attributes
    ----------
    T_map_odom : (4, 4) float64
    covariance : (6, 6) float64 or None
        Of the sensor's pose where it was at the last view.
    T_odom_sensor : (4, 4) float64
        Where that was.
    confidence : float
        Of the views that agree, taken as independent.
    views : int
        Independent views that agree.
    believed : bool
        Whether a single one of them passed all gates.
    at, since : float
        Metres travelled at the last independent view that supported it, and at the last of all.
    """

    T_map_odom: Pose
    covariance: Float64 | None
    T_odom_sensor: Pose
    confidence: float
    views: int
    believed: bool
    at: float
    since: float

    @classmethod
    def of(cls, view: View, T_map_odom: Pose) -> Hypothesis:
        return cls(
            T_map_odom,
            view.covariance,
            view.T_odom_sensor,
            view.confidence,
            1,
            view.believed,
            view.at,
            view.at,
        )


class Hypotheses:
    """Keeps a track while views support it, and gives it up when they speak against it.

    A view that passes all gates of verification is believed at once. A pose that is only likely is
    kept as a candidate until views from different positions agree on it. Once there is a track,
    what counts is what was seen last: a single view that contradicts it makes it doubtful, the next
    one ends it, however many views supported it before.

    Attributes
    ----------
    track : Hypothesis or None
    doubt : str
        Why the track is doubted; "" where it is not.
    """

    def __init__(self, config: HypothesesConfig | None = None) -> None:
        self.config = config or HypothesesConfig()
        self.track: Hypothesis | None = None
        self.doubt = ""
        self._doubts = 0
        self._ends_at = math.inf  # travelled distance at which an unconfirmed track ends
        self._candidates: list[Hypothesis] = []

    @property
    def candidates(self) -> tuple[Hypothesis, ...]:
        """What is likely but not believed, the likeliest first."""
        return tuple(self._candidates)

    def clear(self) -> None:
        """Forget everything."""
        self._end("")
        self._candidates = []

    def carry(self, T_new_old: Pose, travelled: float, doubt: str) -> None:
        """Follow a jump of the odometry: the robot is taken to stand where it stood before.

        Parameters
        ----------
        T_new_old : (4, 4) float64
            From the odometry's frame before the jump to that after it.
        travelled : float
            Metres. Without support the track ends ``confirm_m`` later.
        doubt : str
            Why the track is doubted until then.
        """
        self._candidates = []
        if self.track is not None:
            T = self.track.T_map_odom @ geometry.inverse(T_new_old)
            where = T_new_old @ self.track.T_odom_sensor
            self.track = replace(self.track, T_map_odom=T, T_odom_sensor=where)
            self.doubt, self._doubts = doubt, max(self._doubts, self.config.doubts - 1)
            self._ends_at = travelled + self.config.confirm_m

    def take(self, view: View) -> None:
        """Let a view support the track, or speak against it."""
        self.forget(view.at)
        if self.track is None:
            self._look(view)
        elif view.check is Check.CONTRADICTS:
            self._doubt(view, "the map contradicts the track")
        elif view.T_map_odom is not None and self._agree(self.track, view, view.T_map_odom):
            if view.check is Check.UNMAPPED:  # what agrees was seen before
                self.doubt = OFF_THE_MAP
                return
            self._support(view, view.T_map_odom)
        elif view.check is Check.HOLDS and view.T_checked is not None:
            self._hold(view, view.T_checked)
        elif view.believed and view.T_map_odom is not None:
            self._add(view, view.T_map_odom)
            self._doubt(view, "another place fits better")
        elif view.check is Check.UNMAPPED:
            self.doubt = self.doubt or OFF_THE_MAP

    def forget(self, travelled: float) -> None:
        """Drop what nothing has supported for long."""
        config, track = self.config, self.track
        if track is not None and travelled - track.since > config.memory_m:
            self._end(f"nothing supported the track for {config.memory_m:g} m")
        if self.track is not None and travelled > self._ends_at:
            self._end(self.doubt)
        fresh = [k for k in self._candidates if travelled - k.since <= config.memory_m]
        fresh.sort(key=lambda k: (-k.views, -k.believed, -k.confidence))
        self._candidates = fresh[: config.max_kept]

    def status(self, travelled: float) -> tuple[Status, str]:
        """How well it is known where the robot is, and why not better."""
        if self.track is None:
            if self._candidates:
                return Status.CANDIDATE, self._undecided()
            return Status.LOST, self.doubt or "nothing found"
        if self.doubt:
            return Status.DEGRADED, self.doubt
        unsupported = travelled - self.track.since
        if unsupported > self.config.support_m:
            return Status.DEGRADED, f"nothing supports the track since {unsupported:.0f} m"
        return Status.LOCALIZED, ""

    def covariance(self, travelled: float, T_odom_sensor: Pose) -> Float64 | None:
        """Of the sensor's pose in the map, grown by what odometry errs since the last support."""
        track = self.track
        if track is None or track.covariance is None:
            return None
        T_now_then = geometry.inverse(T_odom_sensor) @ track.T_odom_sensor
        carried = geometry.carried_covariance(track.covariance, T_now_then)
        path = max(0.0, travelled - track.since)
        turn, shift = math.radians(self.config.drift_deg) * path, self.config.drift * path
        return carried + np.diag(np.repeat([turn**2, shift**2], 3))

    # --- inside --------------------------------------------------------------------------------

    def _look(self, view: View) -> None:
        """Without a track: a candidate more, and perhaps one to be believed."""
        if view.T_map_odom is None:
            return
        self._add(view, view.T_map_odom)
        standing = [k for k in self._candidates if k.believed or k.views >= self.config.agreeing]
        standing.sort(key=lambda k: (-k.views, -k.confidence))
        if standing and (len(standing) == 1 or standing[0].views > standing[1].views):
            self._begin(standing[0])

    def _begin(self, found: Hypothesis) -> None:
        self.track, self.doubt, self._doubts, self._ends_at = found, "", 0, math.inf
        self._candidates = []

    def _end(self, doubt: str) -> None:
        self.track, self.doubt, self._doubts, self._ends_at = None, doubt, 0, math.inf

    def _support(self, view: View, T_map_odom: Pose) -> None:
        assert self.track is not None
        self._begin(_joined(self.track, view, T_map_odom, self.config.apart_m))

    def _hold(self, view: View, T_map_odom: Pose) -> None:
        """The newest scan fits where the track is; another place that fits, too, is no rival yet.

        Before as many views have spoken for the track as for that place it is chance which of the
        two came first.
        """
        assert self.track is not None
        if view.believed and view.T_map_odom is not None:
            rival = self._add(view, view.T_map_odom)
            if rival.views >= self.track.views:
                self._doubt(view, "another place fits as well")
                return
        track, candidates = self.track, self._candidates
        self._begin(
            replace(
                track,
                T_map_odom=T_map_odom,
                covariance=view.checked_covariance,
                T_odom_sensor=view.T_odom_sensor,
                since=view.at,
            )
        )
        self._candidates = candidates

    def _doubt(self, view: View, why: str) -> None:
        """Speak against the track; the last doubt ends it, and another place may take over."""
        self._doubts += 1
        self.doubt = why
        if self._doubts < self.config.doubts:
            return
        self._end(why)
        standing = [k for k in self._candidates if k.believed and k.since >= view.at]
        if len(standing) == 1 and view.check is not Check.HOLDS:
            self._begin(standing[0])

    def _add(self, view: View, T_map_odom: Pose) -> Hypothesis:
        """Let a view support the candidate that it agrees with, or be one itself."""
        for i, old in enumerate(self._candidates):
            if self._agree(old, view, T_map_odom):
                self._candidates[i] = _joined(old, view, T_map_odom, self.config.apart_m)
                return self._candidates[i]
        self._candidates.append(Hypothesis.of(view, T_map_odom))
        return self._candidates[-1]

    def _agree(self, old: Hypothesis, view: View, T_map_odom: Pose) -> bool:
        config, T = self.config, view.T_odom_sensor
        apart = geometry.inverse(old.T_map_odom @ T) @ T_map_odom @ T
        slack = config.tolerance_m + config.drift * max(0.0, view.at - old.since)
        turned = math.degrees(geometry.rotation_angle(apart))
        return bool(np.linalg.norm(apart[:3, 3]) <= slack and turned <= config.tolerance_deg)

    def _undecided(self) -> str:
        standing = [k for k in self._candidates if k.believed or k.views >= self.config.agreeing]
        return self.doubt or ("contradiction" if standing else "no agreement yet")


def _joined(old: Hypothesis, view: View, T_map_odom: Pose, apart_m: float) -> Hypothesis:
    """A hypothesis with one more view that agrees with it."""
    independent = view.at - old.at >= apart_m
    both = 1.0 - (1.0 - old.confidence) * (1.0 - view.confidence)
    return Hypothesis(
        T_map_odom,
        view.covariance,
        view.T_odom_sensor,
        both if independent else max(old.confidence, view.confidence),
        old.views + independent,
        old.believed or view.believed,
        view.at if independent else old.at,
        view.at,
    )
