"""What one query says of where a robot is, and what several of them make of it."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np
from pydantic import Field

from .. import geometry
from ..frontend.local_cloud import Scans
from ..system.section import Section
from ..types import Float64, LocalCloud, Pose, Scan


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
    steady_m: float = Field(
        0.25,
        gt=0,
        description="a scan that fits farther from where odometry leads confirms nothing",
    )
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
    reach_m : float
        How far back the oldest of its scans is.
    ambiguous : bool
        Whether the query fits several places.
    check : Check
        What the newest scan says at the pose of the track.
    T_checked, checked_covariance
        Where the check has put the track; None where there was none.
    """

    at: float
    T_odom_sensor: Pose
    T_map_odom: Pose | None = None
    confidence: float = 0.0
    believed: bool = False
    covariance: Float64 | None = None
    reach_m: float = 0.0
    ambiguous: bool = False
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
    begun : float
        Metres travelled at the first of them.
    at, since : float
        Metres travelled at the last independent view that supported it, and at the last of all.
    """

    T_map_odom: Pose
    covariance: Float64 | None
    T_odom_sensor: Pose
    confidence: float
    views: int
    believed: bool
    begun: float
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
            view.at,
        )

    def joined(self, view: View, T_map_odom: Pose, independent: bool) -> Hypothesis:
        """With one more view that agrees with it."""
        both = 1.0 - (1.0 - self.confidence) * (1.0 - view.confidence)
        return Hypothesis(
            T_map_odom,
            view.covariance,
            view.T_odom_sensor,
            both if independent else max(self.confidence, view.confidence),
            self.views + independent,
            self.believed or view.believed,
            self.begun,
            view.at if independent else self.at,
            view.at,
        )

    def placed(self, view: View) -> Hypothesis:
        """The same where the view's newest scan alone fits, if that was checked."""
        if view.T_checked is None:
            return self
        return replace(
            self,
            T_map_odom=view.T_checked,
            covariance=view.checked_covariance,
            T_odom_sensor=view.T_odom_sensor,
            since=view.at,
        )

    def apart(self, view: View, T_map_odom: Pose) -> tuple[float, float]:
        """How far a view's pose is from where this has its sensor: metres, degrees."""
        T = view.T_odom_sensor
        moved = geometry.inverse(self.T_map_odom @ T) @ T_map_odom @ T
        turned_deg = math.degrees(geometry.rotation_angle(moved))
        return float(np.linalg.norm(moved[:3, 3])), turned_deg


@dataclass(frozen=True)
class Track:
    """Where the tracker stands after a query.

    Attributes
    ----------
    status : Status
    T_map_odom : (4, 4) float64 or None
        Takes poses of the odometry to the map; None while lost or candidate.
    confidence : float
        In [0, 1]: that of the views that agree, taken as independent. Unlike that of a single
        query it is not calibrated.
    views : int
        Independent views that agree with the track.
    reason : str
        Why it is no better than that; "" when localized.
    covariance : (6, 6) float64 or None
        Of the sensor's pose in the map, as :attr:`segloc.Localized.covariance`.
    """

    status: Status
    T_map_odom: Pose | None
    confidence: float
    views: int
    reason: str = ""
    covariance: Float64 | None = None

    @property
    def localized(self) -> bool:
        """Whether a pose is believed: localized or degraded."""
        return self.T_map_odom is not None


@dataclass(frozen=True)
class Question:
    """A query that is due, with all that it takes to ask it, elsewhere and later.

    Attributes
    ----------
    search : bool
        Whether the place is searched for; otherwise the track is only checked.
    scans : Scans or LocalCloud
    newest : Scan, LocalCloud or None
        What the track is checked by.
    T_odom_sensor : (4, 4) float64
    T_map_odom : (4, 4) float64 or None
        Of the track.
    at : float
        Metres travelled.
    reach_m : float
        How far back the oldest of its scans is.
    epoch : int
        Grows where the frame of the odometry changes: older answers are not taken.
    """

    search: bool
    scans: Scans | LocalCloud
    newest: Scan | LocalCloud | None
    T_odom_sensor: Pose
    T_map_odom: Pose | None
    at: float
    reach_m: float
    epoch: int
