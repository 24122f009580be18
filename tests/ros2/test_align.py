"""Autoware's alignment service: near the pose of the request, or not at all."""

from __future__ import annotations

import numpy as np
import pytest
from samples.plaza import Plaza
from samples.ros_drive import Listener
from samples.streams import off_m
from segloc_autoware.core import aligned, prior_of
from segloc_ros.core.clicks import Click
from segloc_ros.core.diagnosis import diagnose
from segloc_ros.core.settings import Settings

from segloc import Localizer, geometry


@pytest.mark.parametrize(("x", "expected"), [(-9.0, True), (300.0, False)])
def test_it_answers_near_the_request_or_fails(
    localizer: Localizer, plaza: Plaza, x: float, expected: bool
) -> None:
    listener = Listener.mounted(localizer, mode="initialpose", trigger="service", click_s=2.0)
    listener.walk(plaza, 1)
    robot = listener.robot
    request = Click("/map", geometry.yaw_transform(0.0, (x, 3.0, 0.0)), np.eye(6))
    fixes = robot.relocalize(prior_of(request, robot.settings), anywhere=False)
    truth = listener.walk(plaza, 5, start_s=101.0, begin=(-12.0, 1.1), step=0.5)
    pose, reliable = aligned(robot, robot.fixes > fixes)
    assert (pose is not None, reliable) == (expected, expected)
    assert robot.trigger.resting  # found or given up
    if pose is not None:
        assert off_m(pose.T_map_base, truth) < 0.3
    else:
        assert "at rest" in diagnose(robot).message


def test_a_request_in_another_frame_is_refused() -> None:
    request = Click("viewer", np.eye(4), np.eye(6))
    assert prior_of(request, Settings()) is None
