"""What the core says: each is published by the node as it stands."""

from __future__ import annotations

from dataclasses import dataclass

from segloc.types import Float64, Pose

from .frames import Transform


@dataclass(frozen=True)
class PoseReply:
    """geometry_msgs/PoseWithCovarianceStamped.

    Attributes
    ----------
    stamp : float
        Seconds.
    frame : str
    T_map_base : (4, 4) float64
    covariance : (6, 6) float64
        In ROS's order and axes: x, y, z (m), rotations about the fixed X, Y, Z of ``frame`` (rad).
    """

    stamp: float
    frame: str
    T_map_base: Pose
    covariance: Float64


@dataclass(frozen=True)
class InitialPose:
    """A pose for a tracker such as AMCL."""

    pose: PoseReply


@dataclass(frozen=True)
class MapToOdom:
    """What is broadcast on tf; its stamp is post-dated."""

    transform: Transform


@dataclass(frozen=True)
class MatchesReply:
    """What a query was matched with.

    Attributes
    ----------
    stamp : float
    frame : str
    position : (3,) float64
        Of the sensor, where the query believes it.
    centroids : (K, 3) float64
        Of the segments of the map that agree.
    believed : bool
    """

    stamp: float
    frame: str
    position: Float64
    centroids: Float64
    believed: bool


Reply = PoseReply | InitialPose | MapToOdom | MatchesReply
