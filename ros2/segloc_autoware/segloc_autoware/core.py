"""Autoware's alignment service in segloc's terms, without ROS: a prior in, a pose out.

pose_initializer takes a response that is no ``success`` for a failure, and asks its user where one
is no ``reliable``. What it then gives to the EKF has a covariance of its own.
"""

from __future__ import annotations

from segloc_ros.core.clicks import Click
from segloc_ros.core.frames import frame_name
from segloc_ros.core.replies import PoseReply
from segloc_ros.core.robot import Robot
from segloc_ros.core.settings import Settings

from segloc import Prior
from segloc.live import Status


def prior_of(request: Click, settings: Settings) -> Prior | None:
    """Return where alone to search; None for a request in another frame than the map's."""
    if frame_name(request.frame) != settings.map_frame:
        return None
    return request.prior(settings.click_radius_m)


def aligned(robot: Robot, found: bool) -> tuple[PoseReply | None, bool]:
    """Return the pose, None if it was not found near the prior, and whether it is reliable."""
    pose = robot.initial_pose() if found else None
    if pose is None or robot.pose_state is None:
        return None, False
    return pose.pose, robot.pose_state.status is Status.LOCALIZED
