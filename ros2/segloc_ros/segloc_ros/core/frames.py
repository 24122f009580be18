"""Names of frames, and poses as ROS writes them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from segloc import InvalidScan
from segloc.geometry import rigid
from segloc.robot import Float64, Pose
from segloc.robot import frame_name as frame_name


@dataclass(frozen=True)
class Transform:
    """geometry_msgs/TransformStamped: seconds, and frames without a leading slash."""

    stamp: float
    parent: str
    child: str
    T_parent_child: Pose


def pose_of(xyz: Sequence[float], xyzw: Sequence[float]) -> Pose:
    """(4, 4) float64 of a position and a unit quaternion; raise InvalidScan if they are none."""
    position, q = np.array(xyz, dtype=np.float64), np.array(xyzw, dtype=np.float64)
    if not (np.isfinite(position).all() and abs(np.linalg.norm(q) - 1.0) < 0.05):
        raise InvalidScan("a pose needs finite numbers and a quaternion of length 1")
    return rigid(Rotation.from_quat(q).as_matrix(), position)


def position_and_quaternion(T: ArrayLike) -> tuple[list[float], list[float]]:
    """x, y, z and x, y, z, w of a (4, 4) pose; w is not negative."""
    matrix: Float64 = np.array(T, dtype=np.float64)
    q = Rotation.from_matrix(matrix[:3, :3]).as_quat()
    return matrix[:3, 3].tolist(), (q if q[3] >= 0 else -q).tolist()
