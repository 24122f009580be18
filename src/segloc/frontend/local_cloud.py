"""Scans -> local cloud: the points around one pose, accumulated along a short path."""

from __future__ import annotations

import copy
from collections import deque
from collections.abc import Sequence
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from .. import _native, geometry
from ..errors import InvalidScan
from ..system.section import Section
from ..types import AttitudeSource, Float32, LocalCloud, Pose, Scan
from .gravity import AttitudeConfig, AttitudeEstimator, angle_deg
from .mounting import MountConfig
from .reach import reach_fault

_Z = np.array([0.0, 0.0, 1.0])
_Metres = Annotated[float, Field(ge=-100, le=100)]
Corner = tuple[_Metres, _Metres, _Metres]


class LocalCloudConfig(Section):
    """Accumulation of scans."""

    radius_m: float = Field(50.0, ge=1, le=1000, description="horizontal range of the points used")
    window_m: float = Field(
        40.0, ge=0, le=10_000, description="distance travelled within a query's cloud"
    )
    max_gap_m: float = Field(
        10.0, gt=0, le=10_000, description="longest step between scans of one window"
    )
    attitude: AttitudeConfig = AttitudeConfig()
    mount: MountConfig = MountConfig()
    body: tuple[Corner, Corner] | None = Field(
        None,
        description="box around the robot in the sensor's frame, whose points are dropped: "
        "[[x_min, y_min, z_min], [x_max, y_max, z_max]], metres",
    )

    @model_validator(mode="after")
    def _check(self) -> LocalCloudConfig:
        if self.body is not None and not all(a < b for a, b in zip(*self.body, strict=True)):
            raise ValueError(
                "body must be [[x_min, y_min, z_min], [x_max, y_max, z_max]] with each minimum "
                f"below its maximum, not {[list(corner) for corner in self.body]}"
            )
        return self

    def without_body(self, scan: Scan) -> Scan:
        """Return a scan without the points on the robot itself; the scan if it has none."""
        if self.body is None:
            return scan
        low, high = np.array(self.body, dtype=np.float32)
        outside = ((scan.points < low) | (scan.points > high)).any(axis=1)
        if outside.all():
            return scan
        rest = copy.copy(scan)
        rest.points = scan.points[outside]
        rest.times = None if scan.times is None else scan.times[outside]
        if scan.kept is None:
            rest.kept = outside
        else:
            rest.kept = scan.kept.copy()
            rest.kept[scan.kept] = outside
        return rest


def window(
    poses: NDArray[np.float64], index: int, length_m: float, *, centred: bool, max_gap_m: float
) -> range:
    """Return the scans around ``index`` that form its local cloud.

    Parameters
    ----------
    poses : (N, 4, 4) float64
        Poses of consecutive scans.
    length_m : float
        Travelled distance that the window spans.
    centred : bool
        True for half of the path before and half after the scan (maps); False for all of it
        before the scan (a robot).
    max_gap_m : float
        A longer step between two scans ends the window.
    """
    behind, ahead = (length_m / 2, length_m / 2) if centred else (length_m, 0.0)
    positions = poses[:, :3, 3]
    first = _walk(positions, index, -1, behind, max_gap_m)
    last = _walk(positions, index, +1, ahead, max_gap_m)
    return range(first, last + 1)


def _walk(positions: NDArray[Any], index: int, step: int, length: float, max_gap: float) -> int:
    travelled = 0.0
    while 0 <= index + step < len(positions):
        stride = float(np.linalg.norm(positions[index + step] - positions[index]))
        if stride > max_gap or travelled + stride > length:
            break
        travelled += stride
        index += step
    return index


Scans = Scan | Sequence[Scan] | NDArray[Any]
"""The scans of a local cloud: one scan, an (N, 3) array of points, or several scans."""


class Accumulator:
    """Gathers scans into a local cloud."""

    def __init__(self, config: LocalCloudConfig | None = None) -> None:
        self.config = config or LocalCloudConfig()
        self._attitudes = AttitudeEstimator(self.config.attitude)

    def gather(self, scans: Scans | LocalCloud, reference: int = -1) -> LocalCloud:
        """Return the local cloud of one scan or of several posed ones.

        Parameters
        ----------
        scans : Scan, (N, 3) array, or list of Scan
            With more than one scan, each needs its ``T_odom_sensor``. The roll and pitch of a
            single scan are those of its pose, or else of its gravity, or else estimated from the
            scan. If the estimate fails, the base is taken as level; the mount is the configured
            one, or else the scan's ``T_base_sensor``.
        reference : int
            Index of the scan whose pose is estimated; the last one by default.

        Raises
        ------
        InvalidScan
            If there is no scan, one of several has no pose, or the type is wrong.
        """
        if isinstance(scans, LocalCloud):
            return scans
        scans = [self.config.without_body(scan) for scan in as_scans(scans)]
        anchor = scans[reference]
        if len(scans) == 1 and anchor.T_odom_sensor is None:
            return self._alone(anchor)
        T_local_odom = geometry.inverse(geometry.levelled(odometry_pose(anchor)))
        clouds = [self._crop(T_local_odom @ odometry_pose(scan), scan.points) for scan in scans]
        T_local_sensor = T_local_odom @ odometry_pose(anchor)
        points = np.concatenate(clouds)
        fault = reach_fault(scans, len(points), self.config.radius_m)
        return LocalCloud(points, T_local_sensor, len(scans), anchor.stamp, fault=fault)

    def _alone(self, scan: Scan) -> LocalCloud:
        """Return the local cloud of a scan without a pose."""
        up, attitude = self._up(scan)
        T_local_sensor = geometry.upright(up)
        points = self._crop(T_local_sensor, scan.points)
        fault = reach_fault([scan], len(points), self.config.radius_m)
        return LocalCloud(points, T_local_sensor, 1, scan.stamp, attitude, fault=fault)

    def _up(self, scan: Scan) -> tuple[NDArray[np.float64], AttitudeSource]:
        has_gravity = scan.gravity is not None
        expected = self.level(scan) if scan.gravity is None else -scan.gravity
        if not self.config.attitude.estimate or (has_gravity and not scan.gravity_error_deg):
            return expected, "given"
        max_error_deg = scan.gravity_error_deg if has_gravity else 180.0
        found = self._attitudes.estimate(scan.points, expected)
        if found is None or angle_deg(found.up, expected) > max_error_deg:
            return expected, "given" if has_gravity else "assumed"
        return found.up, "estimated"

    def level(self, scan: Scan, unknown: NDArray[np.float64] = _Z) -> NDArray[np.float64]:
        """Return the vertical in the sensor's frame if its base is level, (3,) float64.

        It is ``unknown`` if the mount is not known.
        """
        configured = self.config.mount.T_base_sensor
        T_base_sensor = scan.T_base_sensor if configured is None else configured
        return unknown if T_base_sensor is None else T_base_sensor[2, :3].copy()

    def _crop(self, T_local_sensor: Pose, points: Float32) -> Float32:
        """Return the points of a scan within the radius, in the frame of the local cloud."""
        return _native.moved_crop(points, T_local_sensor, self.config.radius_m)


def as_scans(scans: Scans) -> Sequence[Scan]:
    """Return the scans of a query as a sequence.

    Raises
    ------
    InvalidScan
        If there is none, or the type is wrong.
    """
    if isinstance(scans, Scan):
        return [scans]
    if not isinstance(scans, (list, tuple, deque)):
        return [Scan(scans)]  # type: ignore[arg-type]  # whatever may be points
    if not scans:
        raise InvalidScan("no scan given")
    for i, scan in enumerate(scans):
        if not isinstance(scan, Scan):
            raise InvalidScan(f"scans[{i}] must be a Scan, not {type(scan).__name__}")
    return scans


def odometry_pose(scan: Scan) -> Pose:
    """Return the odometry pose of a scan.

    Raises
    ------
    InvalidScan
        If the scan has none.
    """
    if scan.T_odom_sensor is None:
        raise InvalidScan(
            "scans can only be accumulated with their poses: give each Scan its T_odom_sensor"
        )
    return scan.T_odom_sensor
