"""Tilt of a recording's frame of poses, estimated from walls; and its correction."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.spatial.transform import Rotation

from .. import geometry
from ..errors import DatasetError
from ..types import Float32, Float64, Pose, Recording, Reposed, Scan
from .gravity import AttitudeEstimator, angle_deg
from .local_cloud import Accumulator, LocalCloudConfig, window

MIN_TILT_DEG = 1.5
"""Smallest tilt that matters to later stages."""
_VIEWS = 12
_VIEW_M = 16.0
_VIEW_POINTS = 40_000  # of a view: one scan of many beams, or several sweeps
_SCANS_IN_MEMORY = 64
_TOLERANCES_DEG = (15.0, 10.0, 6.0, 4.0, 3.0, 3.0)
_MIN_WALLS = 100  # normals
_MIN_FLOORS = 4  # views with floors
_MIN_CROSSING = 0.05  # share of walls normal to the others
_MAX_SPREAD = 1 / 3  # difference between two halves of the views, as a share of the tilt
_Z = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True)
class Tilt:
    """Tilt of the frame of a recording's poses.

    Attributes
    ----------
    up : (3,) float64
        Unit vector against gravity, in that frame.
    spread_deg : float
        Difference between the estimates of two halves of the views [deg].
    """

    up: Float64
    spread_deg: float

    @property
    def tilt_deg(self) -> float:
        """Angle between the frame's z axis and the vertical [deg]."""
        return angle_deg(self.up, _Z)

    @property
    def is_significant(self) -> bool:
        """Whether the frame is not level, beyond the uncertainty."""
        return self.tilt_deg > MIN_TILT_DEG and self.spread_deg < _MAX_SPREAD * self.tilt_deg


def frame_tilt(
    recording: Recording, config: LocalCloudConfig, *, by_floors: bool = False
) -> Tilt | None:
    """Estimate the tilt of the frame of poses from walls in views along the trajectory.

    Only walls are used, since ground may rise over long stretches. With too few walls, or if all
    face one way, it is None, or with ``by_floors`` the median of the floors of the views. None
    without poses.

    Raises
    ------
    DatasetError
        If a scan cannot be read.
    """
    poses = recording.poses
    if poses is None or not len(poses):
        return None
    accumulator, estimator = Accumulator(config), AttitudeEstimator(config.attitude)
    read = lru_cache(_SCANS_IN_MEMORY)(lambda i: config.without_body(recording.scan(i)))
    normals, ups = [], []
    for position in _positions(poses):
        scans = window(poses, position, _VIEW_M, centred=True, max_gap_m=config.max_gap_m)
        points = _view(read, poses, position, scans)
        R = poses[position, :3, :3]
        found = estimator.estimate(points, accumulator.level(read(position), R[2].copy()))
        if found is not None:
            ups.append(R @ found.up)
            normals.append(estimator.normals(points) @ R.T)
    if not ups:
        return None
    about = np.median(ups, axis=0)
    up = _across_walls(np.concatenate(normals), about)
    halves = [_across_walls(np.concatenate(part), about) for part in _halves(normals)]
    if up is None or halves[0] is None or halves[1] is None:
        return _of_floors(ups) if by_floors else None
    return Tilt(up, angle_deg(halves[0], halves[1]))


def _of_floors(ups: list[Float64]) -> Tilt | None:
    if len(ups) < _MIN_FLOORS:
        return None
    first, second, up = (np.median(part, axis=0) for part in (ups[::2], ups[1::2], ups))
    return Tilt(up / np.linalg.norm(up), angle_deg(first, second))


def _positions(poses: Float64) -> list[int]:
    """Return scans spread over the trajectory, or over the recording of a sensor at rest."""
    travelled = geometry.distance_travelled(poses)
    if travelled[-1] < 1.0:
        return geometry.spread(len(poses), 4)
    return [int(i) for i in geometry.stations(travelled, float(travelled[-1]) / _VIEWS)]


def _view(read: Callable[[int], Scan], poses: Float64, position: int, scans: range) -> Float32:
    """Return the points of a scan and of its neighbours until there are enough, in its frame."""
    T_sensor_odom = geometry.inverse(poses[position])
    clouds, count = [], 0
    for i in sorted(scans, key=lambda i: abs(i - position)):
        points = read(i).points
        clouds.append(points if i == position else _transform(T_sensor_odom @ poses[i], points))
        count += len(points)
        if count >= _VIEW_POINTS:
            break
    return np.concatenate(clouds)


def _transform(T: Pose, points: Float32) -> Float32:
    return geometry.transform(T, points).astype(np.float32)


def _halves(parts: list[Float64]) -> tuple[list[Float64], list[Float64]]:
    """Split parts alternately into two halves; a single part by its rows."""
    if len(parts) == 1:
        return [parts[0][::2]], [parts[0][1::2]]
    return parts[::2], parts[1::2]


def _across_walls(normals: Float64, up: Float64) -> Float64 | None:
    """Fit the direction normal to the normals of walls, starting from ``up``."""
    for tolerance in _TOLERANCES_DEG:
        walls = normals[np.abs(normals @ up) < math.sin(math.radians(tolerance))]
        if len(walls) < _MIN_WALLS:
            return None
        values, axes = np.linalg.eigh(walls.T @ walls)
        if values[1] < _MIN_CROSSING * len(walls):
            return None
        up = axes[:, 0] * (1.0 if axes[:, 0] @ up > 0 else -1.0)
    return up


def level_transform(tilt: Tilt, T_odom_first: Pose) -> Pose:
    """Return T_level_odom, (4, 4): the smallest rotation about the first position that aligns z."""
    axis = np.cross(tilt.up, _Z)
    length = float(np.linalg.norm(axis))
    R = np.eye(3)
    if length > 0.0:
        R = Rotation.from_rotvec(math.radians(tilt.tilt_deg) / length * axis).as_matrix()
    origin = T_odom_first[:3, 3]
    return geometry.rigid(R, origin - R @ origin)


def level_recording(recording: Recording, tilt: Tilt | None) -> tuple[Reposed, Pose]:
    """Return the recording with level poses, rotated about the first one, and T_level_odom.

    Raises
    ------
    DatasetError
        If it has no poses, or their tilt is unknown.
    """
    poses = recording.poses
    if poses is None or not len(poses):
        raise DatasetError(f"{recording.name}: no poses to level; give poses by --poses")
    if tilt is None:
        raise DatasetError(
            f"{recording.name}: cannot be levelled: too few walls in the scans; "
            "leave out --level (mapping.level)"
        )
    T = level_transform(tilt, poses[0])
    return Reposed(recording, T @ poses), T
