"""Result of one query: a pose in the map, or the reason why there is none."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum
from typing import TYPE_CHECKING, Any, Literal, TypeAlias, TypeVar

from . import geometry
from .types import AttitudeSource, Float64, Pose

if TYPE_CHECKING:
    from matplotlib.axes import Axes


_E = TypeVar("_E", bound="Explained")


class Explained(str, Enum):
    """Base of reasons: text with its likely cause and remedy.

    Attributes
    ----------
    likely_cause, remedy : str

    Raises
    ------
    TypeError
        If a member is defined without them.
    """

    _value_: str
    likely_cause: str
    remedy: str

    def __new__(cls: type[_E], value: str, likely_cause: str = "", remedy: str = "") -> _E:
        if not (likely_cause and remedy):
            raise TypeError(f"{value!r} has no cause or no remedy")
        member = str.__new__(cls, value)
        member._value_, member.likely_cause, member.remedy = value, likely_cause, remedy
        return member


class Reason(Explained):
    """Why a query is not localized, with the likely cause and its remedy."""

    NO_POINTS = (
        "no points",
        "no point in range: coordinates are in millimetres, or not in the sensor's frame",
        "pass metres in the sensor's frame",
    )
    UNKNOWN_ATTITUDE = (
        "unknown attitude",
        "roll and pitch are unknown: a single scan with hardly any flat surface",
        "pass gravity (`Scan(points, gravity=...)`, an IMU in the bag), or accumulate scans",
    )
    NO_SEGMENTS = (
        "no segments",
        "nothing above the ground in view, a sparse cloud, or units or axes other than metres with "
        "z up",
        "accumulate scans; for sparse clouds raise `segmentation.tolerance` and lower "
        "`segmentation.min_points`",
    )
    NO_MATCHES = (
        "no matches",
        "the map has no segments",
        "build the map again; `segloc map info` shows its content",
    )
    NO_CONSISTENT_MATCHES = (
        "no consistent matches",
        "no segments are arranged as in the map: the place is not in the map, or the scan sees too "
        "little",
        "accumulate scans of a recording by its poses or odometry",
    )
    AMBIGUOUS = (
        "ambiguous",
        "two places look alike, such as corridors or rows of equal pillars",
        "drive on with a tracker, or pass a prior",
    )
    TOO_LITTLE_IN_VIEW = (
        "too little in view",
        "a wall or a piece of corridor: nothing fixes the position along it",
        "turn or drive on, or accumulate scans of a recording by its poses or odometry",
    )
    NOT_IN_MAP = (
        "not in the map",
        "nothing in the map fits: the scan is from another place, or sees too little",
        "drive on, or map the place",
    )
    TOO_UNCERTAIN = (
        "too uncertain",
        "the scan sees too little, or is at the edge of the map; the message names a pose far off "
        "the mapped trajectory, or points in known free space",
        "drive on with a tracker, or map what is missing",
    )
    NOT_NEAR_PRIOR = (
        "not near the prior",
        "the scan fits somewhere else than the prior",
        "widen `--radius`, or add `--anywhere`",
    )

    def __str__(self) -> str:
        return str.__str__(self)

    def below(self, value: float, least: float) -> str:
        """Format a share or probability below its limit, with enough digits to distinguish them."""
        digits = 2
        while digits < 6 and round(least, digits) in (round(value, digits), 1.0):
            digits += 1
        return f"{self} ({value:.{digits}f} < {least:.{digits}f})"


def pose_text(T: Pose) -> str:
    """Format position and heading with units."""
    x, y, z = (float(v) for v in T[:3, 3])
    yaw = math.degrees(geometry.heading(T))
    return f"x {x:.2f}, y {y:.2f}, z {z:.2f} m, yaw {yaw:.1f} deg"


def ambiguous_with(T_map_other: Pose) -> str:
    """Format the reason of a query that also fits another (4, 4) pose."""
    x, y = T_map_other[:2, 3]
    return f"ambiguous (another place, at {x:.0f}, {y:.0f}, explains the query about as well)"


@dataclass(frozen=True)
class Place:
    """A possible place of a query.

    Attributes
    ----------
    T_map_sensor : (4, 4) float64
    probability : float
        In [0, 1].
    inliers : int
        Number of query segments that agree with the pose.
    overlap : float
        Share of the query cloud that lies on the map at the pose, in [0, 1].
    """

    T_map_sensor: Pose
    probability: float
    inliers: int
    overlap: float


@dataclass(frozen=True)
class NextView:
    """A step after which two similar places can be distinguished.

    Attributes
    ----------
    metres : float
        Distance to go.
    bearing_deg : float
        Direction from the sensor's x axis, positive to the left [deg].
    """

    metres: float
    bearing_deg: float

    def __str__(self) -> str:
        degrees = abs(self.bearing_deg)
        side = "left" if self.bearing_deg > 0 else "right"
        if degrees < 1.0:
            return f"go about {self.metres:.0f} m forward"
        if degrees > 179.0:
            return f"go about {self.metres:.0f} m back"
        return f"go about {self.metres:.0f} m, {degrees:.0f} deg to the {side}"


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class _Answer:
    """Fields of both answers, about the best candidate.

    Attributes
    ----------
    inliers : int
        Number of distinct segments that agree with the pose; 0 at first sight.
    overlap : float
        Share of the query cloud that lies on the map at the pose, in [0, 1]; points above the map's
        height there are excluded.
    seen : float or None
        Share of the compared map points that the query sees, in [0, 1]; the others are free-space
        violations. None if no map points are in view.
    proposer : str or None
        Source of the pose: "first sight", before segments are matched, "segments" (their matches),
        "occupancy", or the name of another proposer. None if no pose was proposed.
    rmse : float or None
        Residual of the alignment [m]. None without an alignment.
    confidence : float
        Probability that the pose is correct, in [0, 1]: that of the first of ``places``.
    places : tuple of Place
        Distinct possible places, the most probable first.
    not_in_map : float
        Probability of none of these places, in [0, 1].
    counts : dict
        Number of items of each stage; 0 where first sight needs none.
    times_ms : dict
        Time of each stage [ms].
    stamp : float or None
        Stamp of the query's scan [s].
    attitude : "given", "estimated" or "assumed"
        Source of the query's roll and pitch: a pose or gravity, the scan, or none.
    """

    inliers: int = 0
    overlap: float = 0.0
    seen: float | None = None
    proposer: str | None = None
    rmse: float | None = None
    confidence: float = 0.0
    places: tuple[Place, ...] = ()
    not_in_map: float = 1.0
    counts: Mapping[str, int] = field(default_factory=dict)
    times_ms: Mapping[str, float] = field(default_factory=dict)
    stamp: float | None = None
    attitude: AttitudeSource = "given"

    def plot(self, prior_map: Any, axes: Axes | None = None) -> Axes:
        """Plot the answer on the map, from above.

        Parameters
        ----------
        prior_map : SegmentMap
            Map of the query.
        axes : matplotlib Axes, optional
            Default: axes of a new figure.

        Raises
        ------
        MissingDependency
            If matplotlib is not installed.
        """
        from .tools.inspect.plots import plot_result

        answer: Any = self  # one of the two that this is the base of
        return plot_result(answer, prior_map, axes)


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class Localized(_Answer):
    """An accepted pose; ``str`` formats it in one line.

    Attributes
    ----------
    T_map_sensor : (4, 4) float64
    covariance : (6, 6) float64 or None
        Covariance of a small rotation [rad] (about x, y, z) and then a translation [m], both in the
        sensor's frame: the true pose is ``T_map_sensor @ exp(delta)``. None if unknown. It matches
        the errors in simulated worlds, and excludes distortion of the map and drift within an
        accumulated query. :func:`segloc.ros_covariance` converts it to ROS.
    """

    T_map_sensor: Pose
    covariance: Float64 | None = None
    localized: Literal[True] = True
    reason: None = None
    message: Literal[""] = ""

    def __str__(self) -> str:
        return f"localized at {pose_text(self.T_map_sensor)} (confidence {self.confidence:.2f})"

    def __repr__(self) -> str:
        x, y, z = self.T_map_sensor[:3, 3]
        yaw = math.degrees(geometry.heading(self.T_map_sensor))
        rmse = "None" if self.rmse is None else f"{self.rmse:.3f}"
        return (
            f"Localized(x={x:.3f}, y={y:.3f}, z={z:.3f}, yaw_deg={yaw:.2f}, "
            f"confidence={self.confidence:.4f}, inliers={self.inliers}, "
            f"overlap={self.overlap:.3f}, rmse={rmse})"
        )


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class NotLocalized(_Answer):
    """No accepted pose; ``str`` gives the reason in one line.

    Attributes
    ----------
    reason : Reason
    message : str
        The reason as a sentence, with its figures.
    next_view : NextView or None
        A step after which the two most probable places can be distinguished; None if there is
        none.
    """

    reason: Reason
    message: str
    next_view: NextView | None = None
    localized: Literal[False] = False
    T_map_sensor: None = None
    covariance: None = None

    def __str__(self) -> str:
        step = "" if self.next_view is None else f"; {self.next_view} to distinguish the places"
        return f"not localized: {self.message}{step}"

    def __repr__(self) -> str:
        return (
            f"NotLocalized({self.message!r}, confidence={self.confidence:.4f}, "
            f"inliers={self.inliers}, overlap={self.overlap:.3f})"
        )


Localization: TypeAlias = Localized | NotLocalized
"""The answer to one query. ``if result.localized:`` narrows the type."""
