"""From the poses of submaps to those of all scans of a session."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from ..types import Float64
from .submaps import Session


def spread(session: Session, nodes: Float64) -> Float64:
    """T_world_sensor of every scan, (N, 4, 4).

    A scan between two submaps is carried along by both; what they say of it is blended by the
    distance travelled to each: linear in position, slerp in rotation.

    Parameters
    ----------
    session : Session
    nodes : (S, 4, 4) float64
        T_world_local of its submaps.
    """
    travelled, marks = session.travelled, session.node_travelled
    after = np.clip(np.searchsorted(marks, travelled), 1, max(len(marks) - 1, 1)) % len(marks)
    before = np.maximum(after - 1, 0)
    odometry = session.node_poses
    pair = [nodes[k] @ np.linalg.inv(odometry[k]) @ session.poses for k in (before, after)]
    length = np.where(marks[after] > marks[before], marks[after] - marks[before], 1.0)
    share = np.clip((travelled - marks[before]) / length, 0.0, 1.0)
    turn = pair[0][:, :3, :3].transpose(0, 2, 1) @ pair[1][:, :3, :3]
    part = Rotation.from_rotvec(share[:, None] * Rotation.from_matrix(turn).as_rotvec())
    result: Float64 = pair[0].copy()
    result[:, :3, :3] = pair[0][:, :3, :3] @ part.as_matrix()
    result[:, :3, 3] += share[:, None] * (pair[1][:, :3, 3] - pair[0][:, :3, 3])
    return result
