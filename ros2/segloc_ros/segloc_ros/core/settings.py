"""The node's parameters: one field each, with default, limits and description."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import asdict
from typing import Any, Literal

import numpy as np
from pydantic import Field, field_validator, model_validator
from scipy.spatial.transform import Rotation

from segloc import Config, ConfigError
from segloc.geometry import rigid
from segloc.live import LiveConfig, PoseKeeper, TrackerConfig
from segloc.robot import Pose, Section

from .frames import frame_name
from .merge import ScanMerger
from .smooth import SmoothTransform


def _as_in(
    section: type[Section], key: str, default: Any = None, description: str | None = None
) -> Any:
    """Return a field with the limits of a key of segloc's configuration, by default as it is."""
    info = section.model_fields[key]
    limits = {name: limit for each in info.metadata for name, limit in asdict(each).items()}
    value = info.default if default is None else default
    return Field(value, description=description or info.description, **limits)


class Settings(Section):
    """All parameters of the node. Seconds are those of stamps."""

    map: str = Field(
        "",
        description=".segmap, cloud, folder or URL of tiles; read again when it changes or is set",
    )
    mode: Literal["initialpose", "tf", "both"] = Field(
        "initialpose",
        description="output: poses for a tracker such as AMCL, map -> odom on tf, or both",
    )
    trigger: Literal["until_localized", "periodic", "service"] = Field(
        "until_localized", description="when to query; periodic for mode tf"
    )
    autostart: bool = Field(
        True, description="configure and activate at once; false: leave that to a lifecycle manager"
    )

    points_topic: str = Field("points", description="sensor_msgs/PointCloud2, or Livox's CustomMsg")
    more_points_topics: tuple[str, ...] = Field(
        (),
        description="further LiDARs on the base, whose clouds are merged with points_topic",
    )
    points_tolerance_s: float = Field(
        0.06, gt=0, le=1, description="maximum difference of the stamps of merged clouds"
    )
    points_reliable: bool = Field(
        False, description="QoS reliable; best effort receives from any publisher"
    )
    points_depth: int = Field(
        2, ge=1, le=100, description="QoS depth, and number of clouds that wait"
    )
    odometry: Literal["topic", "tf", "kiss-icp", "none"] = Field(
        "topic",
        description="source; kiss-icp: computed from the clouds; none: the robot stands still",
    )
    odom_topic: str = Field("odom", description="nav_msgs/Odometry, in; with kiss-icp, out")
    odom_tf: bool = Field(True, description="broadcast odom -> base_link with kiss-icp")
    imu_topic: str = Field(
        "", description="sensor_msgs/Imu, to level an odometry whose z axis is not up; '': none"
    )
    fix_topic: str = Field(
        "",
        description="sensor_msgs/NavSatFix, where to search first in a georeferenced map; '': none",
    )
    height_topic: str = Field(
        "",
        description="PoseWithCovarianceStamped, whose z is the base's height in the map; '': none",
    )
    height_sigma_m: float = Field(
        0.5, gt=0, description="its standard deviation if the covariance is 0, metres"
    )
    click_topic: str = Field(
        "initialpose", description="a rough pose, as RViz sends it, to refine; '': none"
    )
    initialpose_topic: str = Field("initialpose", description="topic of the poses for a tracker")
    set_initial_pose_service: str = Field(
        "", description="AMCL's service, such as set_initial_pose, called as well; '': none"
    )

    grid_service: str = Field(
        "map_server/load_map",
        description="of Nav2, called with the grid beside another map that is loaded; '': none",
    )

    map_frame: str = "map"
    odom_frame: str = Field("odom", description="frame of odometry by tf; a topic names its own")
    base_frame: str = "base_link"
    base_to_lidar: tuple[float, ...] = Field(
        (), description="mount x, y, z (m), roll, pitch, yaw (rad) on base_frame; empty: by tf"
    )

    least_m: float = _as_in(LiveConfig, "least_m")
    least_deg: float = _as_in(LiveConfig, "least_deg")
    initialpose_least_m: float = Field(
        0.25, ge=0, description="the same for a tracker: a particle filter needs room, metres"
    )
    initialpose_least_deg: float = Field(5.0, ge=0, description="the same for angles, degrees")
    click_radius_m: float = Field(
        10.0, gt=0, description="minimum search radius around a rough pose, metres"
    )
    click_s: float = Field(
        5.0, gt=0, description="time to search there before the whole map, seconds"
    )
    pose_file: str = Field(
        "",
        description="file that stores the pose over a power cycle, checked after boot; '': none",
    )
    pose_file_every_s: float = Field(5.0, gt=0, description="time between its writes, seconds")
    pose_file_max_age_s: float = Field(
        604_800.0, gt=0, description="maximum age of a stored pose, seconds"
    )

    tf_rate_hz: float = Field(20.0, gt=0, le=1000, description="maximum rate of map -> odom")
    tf_when_lost: Literal["drop", "keep"] = Field(
        "drop", description="map -> odom of a lost robot: stop it, or keep the last one"
    )
    tf_ahead_s: float = Field(
        0.2, ge=0, le=10, description="time that map -> odom is post-dated by, seconds"
    )
    smooth_tf: bool = Field(False, description="correct map -> odom, and ~/pose, at a bounded rate")
    smooth_tf_mps: float = Field(0.2, gt=0, description="that rate at the base, metres per second")
    smooth_tf_dps: float = Field(2.0, gt=0, description="and degrees per second")
    smooth_tf_jump_m: float = Field(
        3.0, gt=0, description="larger corrections are applied at once, metres"
    )
    tf_keep_s: float = Field(10.0, gt=0, description="history of tf, seconds")

    query_every_m: float = _as_in(
        TrackerConfig, "every_m", LiveConfig().tracker.every_m, "distance between queries, metres"
    )
    query_every_s: float = _as_in(LiveConfig, "every_s")
    query_every_lost_s: float = _as_in(LiveConfig, "every_lost_s")
    deadline_ms: float = _as_in(
        LiveConfig, "deadline_ms", 1000.0, "time after which a query tries no more candidates, ms"
    )
    threads: int = _as_in(Config, "threads", 1, "threads of a query; 0: all cores")
    service_timeout_s: float = Field(
        20.0, gt=0, description="time after which ~/relocalize answers, seconds"
    )
    silent_s: float = _as_in(LiveConfig, "silent_s")

    map_cloud_points: int = Field(
        200_000, ge=0, description="maximum number of points on ~/map_cloud; 0: not published"
    )
    matches: bool = Field(True, description="publish the matches of each query on ~/matches")

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
        if self.odometry == "none" and (self.broadcasts_tf or self.trigger == "periodic"):
            raise ValueError("odometry none: mode tf and trigger periodic need one")
        return self

    @classmethod
    def of(cls, parameters: Mapping[str, Any]) -> Settings:
        """From the values of parameters; ConfigError names an unknown or a wrong one."""
        try:
            return cls.model_validate(parameters)
        except ConfigError as error:
            raise ConfigError(f"parameters: {error}") from error

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
    def broadcasts_tf(self) -> bool:
        """Whether map -> odom is broadcast."""
        return self.mode in ("tf", "both")

    @property
    def sends_initialpose(self) -> bool:
        """Whether poses go to a tracker."""
        return self.mode in ("initialpose", "both")

    @property
    def mount(self) -> Pose | None:
        """T_base_lidar, (4, 4) float64; None without a parameter."""
        if not self.base_to_lidar:
            return None
        xyz, angles = self.base_to_lidar[:3], self.base_to_lidar[3:]
        return rigid(Rotation.from_euler("xyz", angles).as_matrix(), np.array(xyz))

    @property
    def merger(self) -> ScanMerger | None:
        """Merges the clouds of several LiDARs; None for one."""
        if not self.more_points_topics:
            return None
        return ScanMerger(self.points_topic, self.more_points_topics, self.points_tolerance_s)

    @property
    def smooth(self) -> SmoothTransform | None:
        """Corrects map -> odom at a bounded rate; None if off."""
        if not self.smooth_tf:
            return None
        return SmoothTransform(self.smooth_tf_mps, self.smooth_tf_dps, self.smooth_tf_jump_m)

    @property
    def keeper(self) -> PoseKeeper | None:
        """Stores the pose over a power cycle; None without a file."""
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
        """Settings of the live localizer."""
        return LiveConfig(
            tracker=TrackerConfig(accumulate=True, every_m=self.query_every_m),
            every_s=self.query_every_s,
            every_lost_s=self.query_every_lost_s,
            deadline_ms=self.deadline_ms,
            least_m=self.least_m,
            least_deg=self.least_deg,
            silent_s=self.silent_s,
        )
