"""Rigid transforms. ``T_a_b`` takes points from frame b to frame a."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from scipy.spatial.transform import Rotation

from .system.section import Section
from .types import Float64, Pose

__all__ = [
    "Separation",
    "displace",
    "displacement",
    "inverse",
    "orthonormal",
    "rigid",
    "ros_covariance",
    "rotation_angle",
    "transform",
    "upright",
    "yaw_transform",
]

FLAT_M = 0.005
"""Largest standard deviation of points from their plane [m]."""

PATH_BREAK_M = 35.0
"""Poses of a path farther apart are not connected [m]."""


def rigid(R: NDArray[np.floating[Any]], t: NDArray[np.floating[Any]]) -> Pose:
    """Return the (4, 4) transform of a (3, 3) rotation and a (3,) translation."""
    T = np.zeros((4, 4))
    T[:3, :3] = R
    T[:3, 3] = t
    T[3, 3] = 1.0
    return T


def yaw_transform(yaw: float, t: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Pose:
    """Return a rotation by ``yaw`` [rad] about z, then a translation by ``t`` [m]."""
    c, s = math.cos(yaw), math.sin(yaw)
    return np.array([[c, -s, 0, t[0]], [s, c, 0, t[1]], [0, 0, 1, t[2]], [0, 0, 0, 1.0]])


def inverse(T: Pose) -> Pose:
    """Return the inverse of a rigid (4, 4) transform."""
    R = T[:3, :3]
    return rigid(R.T, -R.T @ T[:3, 3])


def transform(T: Pose, points: NDArray[Any]) -> NDArray[np.float64]:
    """Transform (N, 3) points by T, in float64."""
    # Column by column: several times faster on three columns than a matrix product, whose threads
    # would cost more than they save.
    x, y, z = (np.asarray(points[:, k], dtype=np.float64) for k in range(3))
    moved = np.empty((len(points), 3))
    for k in range(3):
        moved[:, k] = T[k, 0] * x + T[k, 1] * y + T[k, 2] * z + T[k, 3]
    return moved


def displacement(T_from: Pose, T_to: Pose) -> Float64:
    """Return rotation vector [rad] and translation [m] from a pose to another, (6,)."""
    T = inverse(T_from) @ T_to
    return np.concatenate([Rotation.from_matrix(T[:3, :3]).as_rotvec(), T[:3, 3]])


def displace(T: Pose, step: Float64) -> Pose:
    """Return a pose that a :func:`displacement` leads to."""
    return T @ rigid(Rotation.from_rotvec(step[:3]).as_matrix(), step[3:])


_MOST_SQUARED = 22.5
"""Squared length of a displacement, by its covariance, that one in a thousand exceeds: the quantile
of a chi-squared distribution with six degrees of freedom."""


def allows(covariance: Float64, step: Float64) -> bool:
    """Return whether a :func:`displacement` (6,) is likely by its covariance (6, 6)."""
    return bool(step @ np.linalg.solve(covariance, step) <= _MOST_SQUARED)


def rotation_angle(T: Pose) -> float:
    """Return the angle of T's rotation [rad], in [0, pi]; exact for small angles too."""
    R = T[:3, :3]
    skew = np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    return math.atan2(float(np.linalg.norm(skew)) / 2.0, (float(np.trace(R)) - 1.0) / 2.0)


def heading(T: Pose) -> float:
    """Return the yaw of T's x axis in the horizontal plane [rad]."""
    return math.atan2(T[1, 0], T[0, 0])


def levelled(T_world_sensor: Pose) -> Pose:
    """Return the frame at the same position and heading with a vertical z axis."""
    x, y, z = (float(v) for v in T_world_sensor[:3, 3])
    return yaw_transform(heading(T_world_sensor), (x, y, z))


def upright(up: NDArray[np.float64]) -> Pose:
    """Return T_local_sensor of a sensor in whose frame ``up`` is vertical.

    The local frame has a vertical z axis and the heading of the sensor's x axis or, if that is
    vertical, of its y axis.
    """
    z = up / np.linalg.norm(up)
    y = np.cross(z, (1.0, 0.0, 0.0))
    if np.linalg.norm(y) < 1e-3:
        y = np.array([0.0, 1.0, 0.0]) - z[1] * z
    y /= np.linalg.norm(y)
    return rigid(np.stack([np.cross(y, z), y, z]), np.zeros(3))


def orthonormal(T: Pose) -> Pose:
    """Return T with its rotation replaced by the nearest orthonormal one."""
    U, _, Vt = np.linalg.svd(T[:3, :3])
    R = U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt
    return rigid(R, T[:3, 3])


def in_one_plane(cloud: NDArray[np.floating]) -> bool:
    """Return whether points (N, 3) lie in one plane to ``FLAT_M``, as of a line scanner."""
    few = cloud[:: max(1, len(cloud) // 2000)].astype(np.float64)
    spread = np.linalg.svd(few - few.mean(axis=0), compute_uv=False)
    return bool(spread[-1] < FLAT_M * np.sqrt(len(few)))


def arc_length(line: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the length of a polyline of (N, D) points up to each of them, (N,)."""
    steps = np.linalg.norm(np.diff(line, axis=0), axis=1)
    return np.concatenate([[0.0], np.cumsum(steps)])[: len(line)]


def stations(way: NDArray[np.float64], every_m: float, first_m: float = 0.0) -> NDArray[np.int64]:
    """Return the points of a trajectory every ``every_m`` of travel, in order.

    Each is the first point at or after a mark. Nothing is allocated for marks, which may be many.

    Parameters
    ----------
    way : (N,) float64
        Distance travelled up to each point, from 0 [m].
    every_m : float
        Distance between marks, positive.
    first_m : float
        Distance of the first mark.

    Returns
    -------
    (S,) int64
        Positions in ``way``.
    """
    with np.errstate(over="ignore"):
        passed = np.floor((way + 1e-9 - first_m) / every_m) + 1.0  # marks up to each point
    before = np.concatenate([[0.0], np.maximum(passed, 0.0)])[: len(way)]
    return np.flatnonzero(passed > before)


def spread(length: int, count: int) -> list[int]:
    """Return at most ``count`` positions spread evenly over 0 to ``length`` - 1, both included."""
    if not length:
        return []
    return [int(k) for k in np.unique(np.linspace(0, length - 1, max(1, count)).round())]


def distance_travelled(poses: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the distance travelled up to each of (N, 4, 4) poses [m], (N,)."""
    return arc_length(poses[:, :3, 3])


def rotated_covariance(
    covariance: NDArray[np.float64] | None, T_a_b: Pose
) -> NDArray[np.float64] | None:
    """Rotate a (6, 6) covariance of (rotation, translation) from frame a to frame b.

    The two frames must share their origin.
    """
    if covariance is None:
        return None
    turn = np.kron(np.eye(2), T_a_b[:3, :3].T)
    rotated: NDArray[np.float64] = turn @ covariance @ turn.T
    return rotated


def adjoint(T_a_b: Pose) -> NDArray[np.float64]:
    """Return the (6, 6) map of small motions (rotation, translation) from frame b to frame a."""
    R, (x, y, z) = T_a_b[:3, :3], T_a_b[:3, 3]
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    moved = np.zeros((6, 6))
    moved[:3, :3] = moved[3:, 3:] = R
    moved[3:, :3] = cross @ R
    return moved


def carried_covariance(covariance: NDArray[np.float64], T_a_b: Pose) -> NDArray[np.float64]:
    """Convert a (6, 6) covariance of the pose of frame b to that of frame a, fixed to it.

    Covariances are of a small rotation, then a translation, each in its own frame.
    """
    moved = adjoint(T_a_b)
    carried: NDArray[np.float64] = moved @ covariance @ moved.T
    return carried


class Separation(Section):
    """Least separation of distinct places."""

    metres: float = Field(3.0, gt=0, le=1000, description="horizontal distance, metres")
    degrees: float = Field(15.0, gt=0, le=180, description="difference of the headings, degrees")
    height: float = Field(
        2.0, gt=0, le=1000, description="vertical distance, metres: another storey"
    )

    def apart(self, T_a: Pose, T_b: Pose) -> bool:
        """Return whether two (4, 4) poses in one frame are at different places."""
        # T_a in frame b, without an array: large maps compare many thousands of pairs.
        (xx, yx, zx, _), _, _, (x, y, z, _) = T_a.T.tolist()
        ax, ay, az, (bx, by, bz, _) = T_b.T.tolist()
        forward = ax[0] * xx + ax[1] * yx + ax[2] * zx
        left = ay[0] * xx + ay[1] * yx + ay[2] * zx
        dx, dy, dz = x - bx, y - by, z - bz
        along, across, up = (a[0] * dx + a[1] * dy + a[2] * dz for a in (ax, ay, az))
        turned = abs(math.atan2(left, forward)) > math.radians(self.degrees)
        return turned or math.hypot(along, across) > self.metres or abs(up) > self.height

    def apart_from(self, T_a: Float64, T_b: Float64) -> NDArray[np.bool_]:
        """Return which poses of two stacks, (N, 4, 4) and (M, 4, 4), are at different places,
        (N, M)."""
        x, y, z = (T_a[:, k, 3][:, None] - T_b[:, k, 3] for k in range(3))
        apart: NDArray[np.bool_] = x * x + y * y + z * z > self.metres**2 + self.height**2
        n, m = np.nonzero(~apart)  # few are near each other: only these are turned
        axes = T_b[m, :3, :3]
        ahead = np.einsum("kji,kj->ki", axes, T_a[n, :3, 0])
        off = np.einsum("kji,kj->ki", axes, T_a[n, :3, 3] - T_b[m, :3, 3])
        turned = np.abs(np.arctan2(ahead[:, 1], ahead[:, 0])) > math.radians(self.degrees)
        far = np.hypot(off[:, 0], off[:, 1]) > self.metres
        apart[n, m] = turned | far | (np.abs(off[:, 2]) > self.height)
        return apart


def ros_covariance(covariance: NDArray[np.float64], T_map_sensor: Pose) -> NDArray[np.float64]:
    """Convert a pose's covariance to that of ROS (``geometry_msgs/PoseWithCovariance``).

    Parameters
    ----------
    covariance : (6, 6) float64
        As in :class:`segloc.Localized`: rotation then translation, sensor frame.
    T_map_sensor : (4, 4) float64

    Returns
    -------
    (6, 6) float64
        Covariance of x, y, z [m] and rotations about the fixed X, Y, Z axes [rad], in the map's
        frame.
    """
    R = T_map_sensor[:3, :3]
    turn = np.zeros((6, 6))
    turn[:3, 3:] = R
    turn[3:, :3] = R
    turned: NDArray[np.float64] = turn @ covariance @ turn.T
    return turned


def first_of_cells(points: NDArray[np.floating[Any]], metres: float) -> NDArray[np.int64]:
    """Return the rows of (N, 3) points of which each is the first one in its cubic cell."""
    _, first = np.unique(np.floor(points / metres).astype(np.int64), axis=0, return_index=True)
    return np.sort(first)


def spaced(path: Float64, metres: float) -> Float64:
    """Return the positions of a path, (M, 3), of which each is the first one in its cell."""
    return np.ascontiguousarray(path[first_of_cells(path, metres)])


def cells_of(points: NDArray[np.floating[Any]], width: float) -> NDArray[np.int64]:
    """Return the square cell of each of (N, 2) points, (N, 2)."""
    cells: NDArray[np.int64] = np.floor(points / width).astype(np.int64)
    return cells


def keys_of(cells: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return one key per (N, 2) cell, by x, then y: NumPy takes ten times as long for rows."""
    keys: NDArray[np.int64] = cells[:, 0] * (1 << 32) + cells[:, 1]
    return keys


def distinct(cells: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the distinct cells of (N, 2), in the order of x and y."""
    return cells[np.unique(keys_of(cells), return_index=True)[1]]
