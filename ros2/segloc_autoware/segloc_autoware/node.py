"""The node of segloc_ros with Autoware's alignment service beside its own."""

from __future__ import annotations

import importlib
from typing import Any

from segloc_ros.messages import click_in, pose_out
from segloc_ros.node import SeglocNode

from segloc import ConfigError, SeglocError

from .core import aligned, prior_of

_PACKAGES = ("autoware_internal_localization_msgs", "tier4_localization_msgs")


def service_type() -> Any:
    """Return PoseWithCovarianceStamped of the Autoware that is installed; ConfigError if none."""
    for package in _PACKAGES:
        try:
            return importlib.import_module(f"{package}.srv").PoseWithCovarianceStamped
        except ImportError:
            continue
    raise ConfigError(f"the service's type is not installed: {' or '.join(_PACKAGES)}")


class AlignNode(SeglocNode):
    """Answers ``ndt_align_srv``: is the vehicle near this pose, and where exactly?"""

    def __init__(self, name: str = "segloc", **options: Any) -> None:
        super().__init__(name, **options)
        kind = service_type()
        self.create_service(kind, "ndt_align_srv", self._on_align, callback_group=self.calls)

    async def _on_align(self, request: Any, response: Any) -> Any:
        response.pose_with_covariance = request.pose_with_covariance
        response.success = False
        self._set_reliable(response, False)
        robot = self.robot
        try:
            asked = click_in(request.pose_with_covariance)
        except SeglocError as error:
            self.get_logger().warning(f"ndt_align_srv: {error}")
            return response
        prior = None if robot is None else prior_of(asked, robot.settings)
        if robot is None or prior is None:
            frame = request.pose_with_covariance.header.frame_id
            self.get_logger().warning(f"ndt_align_srv: inactive, or a pose in {frame!r}")
            return response
        found = await self.find(prior, anywhere=False)
        if self.pump is None:
            return response
        pose, reliable = self.pump.read(lambda robot: aligned(robot, found))
        response.success = pose is not None
        self._set_reliable(response, reliable)
        if pose is not None:
            response.pose_with_covariance = pose_out(pose)
        else:
            self.get_logger().warning(f"ndt_align_srv: {self.why()}")
        return response

    @staticmethod
    def _set_reliable(response: Any, reliable: bool) -> None:
        if hasattr(response, "reliable"):  # older types have none
            response.reliable = reliable
