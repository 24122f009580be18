"""Autoware's alignment service in segloc's terms: a prior in, a pose and how far to trust it out.

pose_initializer takes a response that is no ``success`` for a failure, and asks its user where one
is no ``reliable``. What it then gives to the EKF has a covariance of its own.
"""

from __future__ import annotations

from dataclasses import dataclass

from segloc_ros.core.clicks import Click
from segloc_ros.core.frames import frame_name
from segloc_ros.core.replies import PoseReply
from segloc_ros.core.robot import Robot
from segloc_ros.core.settings import Settings

from segloc import Prior
from segloc.live import Status


@dataclass(frozen=True)
class Aligned:
    """A response.

    Attributes
    ----------
    success : bool
        Whether the robot was found near the pose of the request.
    reliable : bool
        Whether the tracker is localized there.
    pose : PoseReply or None
        Where it is now; None where it was not found: the request's own is given back.
    """

    success: bool
    reliable: bool
    pose: PoseReply | None


def prior_of(request: Click, settings: Settings) -> Prior | None:
    """Where alone to look; None where the request is in another frame than the map's."""
    if frame_name(request.frame) != settings.map_frame:
        return None
    return request.prior(settings.click_radius_m)


def aligned(robot: Robot, found: bool) -> Aligned:
    """The response, once a query near the prior was answered or its time has run out."""
    pose = robot.initial_pose() if found else None
    if pose is None or robot.pose_state is None:
        return Aligned(False, False, None)
    return Aligned(True, robot.pose_state.status is Status.LOCALIZED, pose.pose)
