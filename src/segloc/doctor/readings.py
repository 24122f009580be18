"""The ways in which poses, or the points that they belong to, are commonly misread."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from .. import geometry
from ..types import Float64
from .finding import Fault

_FOOT_M = 0.3048
_T_CAMERA_SENSOR = np.array([[0.0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]])


def _inverse(poses: Float64) -> Float64:
    return np.array([geometry.inverse(T) for T in poses], dtype=np.float64)


def _scalar_first(poses: Float64) -> Float64:
    """As if the four numbers of each rotation were w, x, y, z."""
    first = Rotation.from_matrix(poses[:, :3, :3]).as_quat()
    read: Float64 = poses.copy()
    read[:, :3, :3] = Rotation.from_quat(first[:, [1, 2, 3, 0]]).as_matrix()
    return read


def _of_camera(poses: Float64) -> Float64:
    return np.asarray(poses @ _T_CAMERA_SENSOR)  # whatever the axes of the world


def _turned(R: Float64) -> Callable[[Float64], Float64]:
    """As the poses of scans whose points were turned by R: indoors a ceiling may be the floor."""
    T = np.eye(4)
    T[:3, :3] = R.T
    return lambda poses: np.asarray(poses @ T)


def _scaled(factor: float) -> Callable[[Float64], Float64]:
    """As poses of points whose unit is another by this factor."""

    def read(poses: Float64) -> Float64:
        scaled: Float64 = poses.copy()
        scaled[:, :3, 3] *= factor
        return scaled

    return read


def _mirrored(poses: Float64) -> Float64:
    """As the poses of scans whose y axis points the other way."""
    mirror = np.diag([1.0, -1.0, 1.0, 1.0])
    return np.asarray(mirror @ poses @ mirror)


def _nowhere(poses: Float64) -> Float64:
    return np.tile(np.eye(4), (len(poses), 1, 1))


@dataclass(frozen=True)
class Reading:
    """What poses may be meant as.

    Attributes
    ----------
    fault : Fault
    means : callable
        (N, 4, 4) poses -> T_odom_sensor, (N, 4, 4).
    what, remedy : str
        Of the finding.
    """

    fault: Fault
    means: Callable[[Float64], Float64]
    what: str
    remedy: str


READINGS = (
    Reading(
        Fault.POSES_INVERSE,
        _inverse,
        "the poses are inverse: they take points from the world to the sensor",
        "invert each, so that it is T_world_sensor",
    ),
    Reading(
        Fault.POSES_WXYZ,
        _scalar_first,
        "the rotations of the poses are in the order qw qx qy qz",
        "write them as qx qy qz qw, as TUM files have them",
    ),
    Reading(
        Fault.POSES_OF_CAMERA,
        _of_camera,
        "the poses are those of a camera (z forward)",
        "multiply each by T_camera_sensor from the right, and by its inverse from the left where "
        "the world has the camera's axes, too; segloc does so in KITTI's own layout",
    ),
    Reading(
        Fault.POSES_IN_MILLIMETRES,
        _scaled(1e-3),
        "the poses are in millimetres",
        "divide their positions by 1000",
    ),
    Reading(
        Fault.FEET,
        _scaled(1.0 / _FOOT_M),
        "the points are in feet",
        f"multiply them by {_FOOT_M}",
    ),
    Reading(
        Fault.FEET,
        _scaled(_FOOT_M),
        "the poses are in feet",
        f"multiply their positions by {_FOOT_M}",
    ),
    Reading(
        Fault.MIRRORED,
        _mirrored,
        "the y axis of the points is mirrored",
        "change the sign of y",
    ),
    Reading(
        Fault.WORLD_COORDINATES,
        _nowhere,
        "points are in world coordinates already, not in the sensor's frame",
        "take them back by T_world_sensor^-1, each scan by its own pose",
    ),
    Reading(
        Fault.Z_DOWN,
        _turned(np.diag([1.0, -1.0, -1.0])),
        "the z axis of the points points down",
        "change the signs of y and z",
    ),
    Reading(
        Fault.CAMERA_AXES,
        _turned(_T_CAMERA_SENSOR[:3, :3]),
        "the axes of the points are a camera's (x right, y down, z forward)",
        "write z, -x, -y in place of x, y, z",
    ),
    *(
        Reading(
            Fault.TILT,
            _turned(Rotation.from_euler(axis, degrees, degrees=True).as_matrix()),
            "the sensor lies on its side",
            "name how it is mounted, `local_cloud: {mount: ...}`",
        )
        for axis in "xy"
        for degrees in (-90.0, 90.0)
    ),
)
MILLIMETRES = next(
    k for k, reading in enumerate(READINGS) if reading.fault is Fault.POSES_IN_MILLIMETRES
)
