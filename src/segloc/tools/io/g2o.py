"""Pose graphs in g2o format (R. Kümmerle et al., "g2o: A General Framework for Graph
Optimization", ICRA 2011; https://github.com/RainerKuemmerle/g2o/wiki/File-format-slam-3d)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from ...types import Float64, Int64
from .trajectory import pose_rows


@dataclass(frozen=True)
class PoseEdges:
    """Measured relative poses of E edges."""

    first: Int64  # (E,) pose numbers
    second: Int64  # (E,)
    T: Float64  # (E, 4, 4) T_first_second
    # (E, 6, 6) of rotation [rad], then translation [m], in the frame of ``second``
    covariance: Float64


_UPPER = np.triu_indices(6)


def g2o_information(covariance: Float64) -> Float64:
    """Return the information matrix of an EDGE_SE3:QUAT, (6, 6) float64.

    Its order is x, y, z, then the vector part of the unit quaternion, which is half of a small
    rotation vector. Both orders are of errors in the frame of the second pose.

    covariance: (6, 6) of rotation [rad], then translation [m]
    """
    order = np.array([3, 4, 5, 0, 1, 2])
    information = np.linalg.inv(covariance)[np.ix_(order, order)]
    scale = np.array([1.0, 1.0, 1.0, 2.0, 2.0, 2.0])  # d(rotation vector) / d(quaternion)
    scaled = scale[:, None] * information * scale
    return np.asarray((scaled + scaled.T) / 2.0, dtype=np.float64)


def format_g2o(poses: Float64, edges: Sequence[PoseEdges], fixed: Sequence[int] = ()) -> str:
    """Format VERTEX_SE3:QUAT, FIX and EDGE_SE3:QUAT lines.

    poses: (N, 4, 4) initial estimates, numbered from 0
    fixed: poses that the optimiser must keep
    """
    return "".join(_lines(poses, edges, fixed))


def _lines(poses: Float64, edges: Sequence[PoseEdges], fixed: Sequence[int]) -> Iterator[str]:
    for k, row in enumerate(pose_rows(poses)):
        yield f"VERTEX_SE3:QUAT {k} {_text(row)}\n"
    for k in fixed:
        yield f"FIX {k}\n"
    for part in edges:
        for k, row in enumerate(pose_rows(part.T)):
            information = g2o_information(part.covariance[k])[_UPPER]
            ends = f"{int(part.first[k])} {int(part.second[k])}"
            yield f"EDGE_SE3:QUAT {ends} {_text(row)} {_text(information)}\n"


def _text(values: Float64) -> str:
    return " ".join(f"{value:.12g}" for value in values)
