"""The node's parameters: one field each, with its default, its limits and what it means."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any, Literal

import numpy as np
from pydantic import Field, field_validator, model_validator

from segloc.config import validated
from segloc.frontend.mounting import rotation
from segloc.geometry import rigid
from segloc.live import LiveConfig, PoseKeeper, ScanMerger, SmoothTransform
from segloc.system.section import Section
from segloc.tracker import TrackerConfig
from segloc.types import Pose

from .frames import frame_name


class Settings(Section):
    """All parameters of the node. Seconds are those of stamps."""

    map: str = Field(
        "",
        description=".segmap, cloud, folder or URL of tiles; read again when it changes or is set",
    )
    mode: Literal["initialpose", "tf", "both"] = Field(
        "initialpose", description="what is told: a pose for a tracker such as AMCL, map -> odom"
    )
    trigger: Literal["until_localized", "periodic", "service"] = Field(
        "until_localized", description="when it is looked for; tf is best with periodic"
    )
    autostart: bool = Field(
        True, description="configure and activate at once; false: somebody else does"
    )

    points_topic: str = Field("points", description="sensor_msgs/PointCloud2")
    more_points_topics: tuple[str, ...] = Field(
        (), description="clouds of further LiDARs of the base, merged into those of points_topic"
    )
    points_tolerance_s: float = Field(
        0.06, gt=0, le=1, description="largest difference of stamps of clouds that are merged"
    )
    points_reliable: bool = Field(False, description="QoS; best effort takes any publisher")
    points_depth: int = Field(2, ge=1, le=100, description="QoS: clouds that wait")
    odometry: Literal["topic", "tf", "kiss-icp", "none"] = Field(
        "topic",
        description="source; kiss-icp: computed from the clouds; none: the robot must stand still",
    )
    odom_topic: str = Field("odom", description="nav_msgs/Odometry, in; with kiss-icp, out")
    odom_tf: bool = Field(True, description="with kiss-icp, also broadcast odom -> base_link")
    imu_topic: str = Field(
        "", description="sensor_msgs/Imu: levels an odometry whose z axis is not up; '': none"
    )
    fix_topic: str = Field(
        "", description="sensor_msgs/NavSatFix: where to search first in a georeferenced map"
    )
    click_topic: str = Field(
        "initialpose", description="a rough pose, as RViz sends it, to refine; '': none"
    )
    initialpose_topic: str = Field("initialpose", description="where poses for a tracker go")
    set_initial_pose_service: str = Field(
        "", description="AMCL's service, such as set_initial_pose, called as well; '': none"
    )

    grid_service: str = Field(
        "map_server/load_map",
        description="of Nav2, called with the grid beside another map that is loaded; '': none",
    )

    map_frame: str = "map"
    odom_frame: str = Field("odom", description="of odometry by tf; a topic names its own")
    base_frame: str = "base_link"
    base_to_lidar: tuple[float, ...] = Field(
        (), description="x, y, z (m), roll, pitch, yaw (rad) on base_frame; empty: by tf"
    )

    least_m: float = Field(0.05, ge=0, description="least deviation of a pose, metres")
    least_deg: float = Field(0.3, ge=0, description="and of its angles")
    initialpose_least_m: float = Field(
        0.25, ge=0, description="the same on initialpose: a particle filter needs room"
    )
    initialpose_least_deg: float = Field(5.0, ge=0, description="and for angles")
    click_radius_m: float = Field(10.0, gt=0, description="it is looked for so near a click")
    click_s: float = Field(5.0, gt=0, description="and for so long, then anywhere")
    pose_file: str = Field(
        "", description="file that keeps the pose over a power cycle, checked after boot; '': none"
    )
    pose_file_every_s: float = Field(5.0, gt=0, description="time between its writes")
    pose_file_max_age_s: float = Field(
        604_800.0, gt=0, description="an older pose is not used: the robot is found anew"
    )

    tf_rate_hz: float = Field(20.0, gt=0, le=1000, description="of map -> odom at most")
    tf_when_lost: Literal["drop", "keep"] = Field(
        "drop", description="map -> odom of a lost robot: stop it, or keep the last one"
    )
    tf_ahead_s: float = Field(0.2, ge=0, le=10, description="map -> odom is post-dated by this")
    smooth_tf: bool = Field(
        False, description="correct map -> odom at a bounded rate, without jumps; ~/pose as well"
    )
    smooth_tf_mps: float = Field(0.2, gt=0, description="that rate at the base, metres a second")
    smooth_tf_dps: float = Field(2.0, gt=0, description="and degrees a second")
    smooth_tf_jump_m: float = Field(3.0, gt=0, description="a larger correction is made at once")
    tf_keep_s: float = Field(10.0, gt=0, description="tf is kept for so long")

    query_every_m: float = Field(10.0, ge=0, description="travel between queries")
    query_every_s: float = Field(5.0, gt=0, description="and time")
    query_every_lost_s: float = Field(1.0, gt=0, description="time between queries while lost")
    deadline_ms: float = Field(1000.0, gt=0, description="a query ends soon after this")
    threads: int = Field(1, ge=0, le=1024, description="of a query; 0: all cores")
    service_timeout_s: float = Field(20.0, gt=0, description="~/relocalize answers within this")
    silent_s: float = Field(2.0, gt=0, description="without clouds for longer it is degraded")

    map_cloud_points: int = Field(200_000, ge=0, description="on ~/map_cloud; 0: it is not sent")
    matches: bool = Field(True, description="whether ~/matches shows what was matched")

    @field_validator("map_frame", "odom_frame", "base_frame")
    @classmethod
    def _named(cls, frame: str) -> str:
        if not (name := frame_name(frame)):
            raise ValueError("a frame has a name")
        return name

    @field_validator("base_to_lidar")
    @classmethod
    def _six(cls, numbers: tuple[float, ...]) -> tuple[float, ...]:
        if len(numbers) not in (0, 6):
            raise ValueError(f"six numbers or none, not {len(numbers)}")
        return numbers

    @model_validator(mode="after")
    def _check(self) -> Settings:
        if self.odometry == "none" and (self.tells_tf or self.trigger == "periodic"):
            raise ValueError("odometry none: mode tf and trigger periodic need one")
        return self

    @classmethod
    def of(cls, parameters: Mapping[str, Any]) -> Settings:
        """From the values of parameters.

        Raises
        ------
        segloc.ConfigError
            If a name is unknown or a value out of range; names it.
        """
        return validated(cls, parameters, "parameters")

    @classmethod
    def declared(cls) -> Iterator[tuple[str, Any, str]]:
        """Name, default and description of each parameter, as ROS has them."""
        for name, info in cls.model_fields.items():
            default = info.default
            yield (
                name,
                list(default) if isinstance(default, tuple) else default,
                str(info.description or ""),
            )

    @property
    def tells_tf(self) -> bool:
        """Whether map -> odom is broadcast."""
        return self.mode in ("tf", "both")

    @property
    def tells_initialpose(self) -> bool:
        """Whether poses go to a tracker."""
        return self.mode in ("initialpose", "both")

    @property
    def mount(self) -> Pose | None:
        """T_base_lidar, (4, 4) float64, where a parameter says it."""
        if not self.base_to_lidar:
            return None
        x, y, z, *angles = self.base_to_lidar
        roll, pitch, yaw = (math.degrees(angle) for angle in angles)
        return rigid(rotation(roll, pitch, yaw), np.array([x, y, z]))

    @property
    def merger(self) -> ScanMerger | None:
        """What merges the clouds of several LiDARs."""
        if not self.more_points_topics:
            return None
        return ScanMerger(self.points_topic, self.more_points_topics, self.points_tolerance_s)

    @property
    def smooth(self) -> SmoothTransform | None:
        """What corrects map -> odom without jumps."""
        if not self.smooth_tf:
            return None
        return SmoothTransform(self.smooth_tf_mps, self.smooth_tf_dps, self.smooth_tf_jump_m)

    @property
    def keeper(self) -> PoseKeeper | None:
        """What keeps the pose over a power cycle."""
        if not self.pose_file:
            return None
        return PoseKeeper(
            self.pose_file,
            every_s=self.pose_file_every_s,
            max_age_s=self.pose_file_max_age_s,
            radius_m=self.click_radius_m,
            check_s=self.click_s,
        )

    @property
    def live(self) -> LiveConfig:
        """How the robot is followed."""
        return LiveConfig(
            tracker=TrackerConfig(accumulate=True, every_m=self.query_every_m),
            every_s=self.query_every_s,
            every_lost_s=self.query_every_lost_s,
            deadline_ms=self.deadline_ms,
            least_m=self.least_m,
            least_deg=self.least_deg,
            silent_s=self.silent_s,
        )
