"""Outputs of the core; the node publishes each without change."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from segloc import geometry, ros_covariance
from segloc.robot import Float64, Pose

from .frames import Transform

_UNKNOWN = (1.0, 5.0)
"""Standard deviations of a pose whose covariance is unknown [m] and [degrees]."""


@dataclass(frozen=True)
class PoseReply:
    """geometry_msgs/PoseWithCovarianceStamped.

    Its covariance has ROS's order and axes: x, y, z [m], rotations about the fixed X, Y, Z of
    ``frame`` [rad].
    """

    stamp: float
    frame: str
    T_map_base: Pose
    covariance: Float64

    @classmethod
    def of(
        cls,
        stamp: float,
        frame: str,
        T_map_base: Pose,
        covariance: Float64 | None,
        least: tuple[float, float] = (0.0, 0.0),
    ) -> PoseReply:
        """Return a reply with a covariance in ROS's order.

        covariance: in segloc's order, or None if unknown
        least: minimum standard deviations [m] and [degrees]
        """
        known = _deviating(*_UNKNOWN) if covariance is None else covariance
        grown = ros_covariance(known + _deviating(*least), T_map_base)
        return cls(stamp, frame, T_map_base, grown)


def _deviating(metres: float, degrees: float) -> Float64:
    """A (6, 6) covariance of rotation and translation, the same in all directions."""
    return np.diag(np.repeat([np.radians(degrees), metres], 3) ** 2)


@dataclass(frozen=True)
class InitialPose:
    """A pose for a tracker such as AMCL."""

    pose: PoseReply


@dataclass(frozen=True)
class MapToOdom:
    """map -> odom on tf, post-dated."""

    transform: Transform


@dataclass(frozen=True)
class OdometryReply:
    """nav_msgs/Odometry, and odom -> base_link on tf; velocities in the base, [m/s] and [rad/s]."""

    transform: Transform
    linear: Float64
    angular: Float64

    @classmethod
    def of(cls, transform: Transform, before: tuple[float, Pose] | None) -> OdometryReply:
        """With the mean velocity since a pose before, which has a stamp."""
        seconds = 0.0 if before is None else transform.stamp - before[0]
        if before is None or seconds <= 0.0:
            return cls(transform, np.zeros(3), np.zeros(3))
        rates = geometry.displacement(before[1], transform.T_parent_child) / seconds
        return cls(transform, rates[3:], rates[:3])


@dataclass(frozen=True)
class MatchesReply:
    """The sensor at the best candidate, and centroids (K, 3) of the segments that agree with it."""

    stamp: float
    frame: str
    position: Float64
    centroids: Float64
    accepted: bool


@dataclass(frozen=True)
class CandidatesReply:
    """geometry_msgs/PoseArray: T_map_base and probability of what a query found, best first."""

    stamp: float
    frame: str
    places: tuple[tuple[Pose, float], ...]


Reply = PoseReply | InitialPose | MapToOdom | OdometryReply | CandidatesReply | MatchesReply
