"""Whether the z axis of a recording's poses is up, by the walls in its scans; and turning it up."""

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

NOTICED_DEG = 1.5
"""A frame that leans by less is level for all that follows."""
_VIEWS = 12
_VIEW_M = 16.0
_ENOUGH_POINTS = 40_000  # of a view: one scan of many beams, or several sweeps
_SCANS_IN_MEMORY = 64
_TOLERANCES_DEG = (15.0, 10.0, 6.0, 4.0, 3.0, 3.0)
_FEWEST_WALLS = 100
_SIDEWAYS = 0.05  # share of walls that must stand across the others
_AGREEING = 1 / 3  # two halves of the views differ by less than this share of the lean
_Z = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True)
class Lean:
    """How the frame of a recording's poses stands.

    Attributes
    ----------
    up : (3,) float64
        Unit vector against gravity, in that frame.
    spread_deg : float
        Between what two halves of the views say.
    """

    up: Float64
    spread_deg: float

    @property
    def tilt_deg(self) -> float:
        """The angle between the frame's z axis and the vertical."""
        return angle_deg(self.up, _Z)

    @property
    def noticed(self) -> bool:
        """Whether the frame is certainly not level."""
        return self.tilt_deg > NOTICED_DEG and self.spread_deg < _AGREEING * self.tilt_deg


def frame_lean(recording: Recording, config: LocalCloudConfig) -> Lean | None:
    """How the frame of the poses leans, by walls in views all along the path.

    Of walls only: ground may rise, and does so for long stretches. None where there are no poses,
    or too few walls, or all of them face one way.

    Raises
    ------
    DatasetError
        If a scan cannot be read.
    """
    poses = recording.poses
    if poses is None or not len(poses):
        return None
    accumulator, estimator = Accumulator(config), AttitudeEstimator(config.attitude)
    read = lru_cache(_SCANS_IN_MEMORY)(recording.scan)
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
        return None
    return Lean(up, angle_deg(halves[0], halves[1]))


def _positions(poses: Float64) -> list[int]:
    """Scans spread over the path; over the recording where it does not move."""
    travelled = geometry.travelled(poses)
    if travelled[-1] < 1.0:
        return geometry.spread(len(poses), 4)
    return [int(i) for i in geometry.stations(travelled, float(travelled[-1]) / _VIEWS)]


def _view(read: Callable[[int], Scan], poses: Float64, position: int, scans: range) -> Float32:
    """The points of a scan, and of those around it until there are enough, in its frame."""
    T_sensor_odom = geometry.inverse(poses[position])
    clouds, count = [], 0
    for i in sorted(scans, key=lambda i: abs(i - position)):
        points = read(i).points
        clouds.append(points if i == position else _moved(T_sensor_odom @ poses[i], points))
        count += len(points)
        if count >= _ENOUGH_POINTS:
            break
    return np.concatenate(clouds)


def _moved(T: Pose, points: Float32) -> Float32:
    return geometry.transform(T, points).astype(np.float32)


def _halves(parts: list[Float64]) -> tuple[list[Float64], list[Float64]]:
    """Every other one; of one alone its own halves."""
    if len(parts) == 1:
        return [parts[0][::2]], [parts[0][1::2]]
    return parts[::2], parts[1::2]


def _across_walls(normals: Float64, up: Float64) -> Float64 | None:
    """The direction that is most nearly across the normals of walls, from about where it is."""
    for tolerance in _TOLERANCES_DEG:
        walls = normals[np.abs(normals @ up) < math.sin(math.radians(tolerance))]
        if len(walls) < _FEWEST_WALLS:
            return None
        values, axes = np.linalg.eigh(walls.T @ walls)
        if values[1] < _SIDEWAYS * len(walls):
            return None
        up = axes[:, 0] * (1.0 if axes[:, 0] @ up > 0 else -1.0)
    return up


def level_transform(lean: Lean, T_odom_first: Pose) -> Pose:
    """T_level_odom, (4, 4): the least turn about a first pose's position that takes up to z."""
    axis = np.cross(lean.up, _Z)
    length = float(np.linalg.norm(axis))
    R = np.eye(3)
    if length > 0.0:
        R = Rotation.from_rotvec(math.radians(lean.tilt_deg) / length * axis).as_matrix()
    origin = T_odom_first[:3, 3]
    return geometry.rigid(R, origin - R @ origin)


def levelled(recording: Recording, lean: Lean | None) -> tuple[Reposed, Pose]:
    """The recording with poses whose z axis is up, turned about the first, and T_level_odom.

    Raises
    ------
    DatasetError
        If it has no poses, or how they lean is not known.
    """
    poses = recording.poses
    if poses is None or not len(poses):
        raise DatasetError(f"{recording.name}: there are no poses to be levelled")
    if lean is None:
        raise DatasetError(
            f"{recording.name}: cannot be levelled: the scans show too few walls to tell what is up"
        )
    T = level_transform(lean, poses[0])
    return Reposed(recording, T @ poses), T
