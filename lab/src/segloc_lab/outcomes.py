"""Errors of single poses, what became of a query, and lengths of mapped paths."""

from __future__ import annotations

import math

import numpy as np

from segloc.tools.batch import COVERAGE_RADIUS_M, Tolerance, distances_to_path, pose_errors
from segloc.types import Float64, Pose

TOLERANCE = Tolerance()


def pose_error(estimate: Pose | None, truth: Pose | None) -> tuple[float, float]:
    """Return the error of a pose [m, deg]; infinite without it, or without a true one."""
    if estimate is None or truth is None:
        return math.inf, math.inf
    (metres,), (degrees,) = pose_errors(estimate[None], truth[None])
    return float(metres), float(degrees)


def outcome(estimate: Pose | None, truth: Pose | None) -> str:
    """Classify an estimate as found, false, or refused; without a truth any is false."""
    if estimate is None:
        return "refused"
    metres, degrees = pose_error(estimate, truth)
    return "found" if metres <= TOLERANCE.metres and degrees <= TOLERANCE.degrees else "false"


def is_covered(truth: Pose, path: Float64) -> bool:
    """Return whether a pose is within coverage of a mapped path, (V, 4, 4)."""
    return bool(distances_to_path(truth[None], path)[0] <= COVERAGE_RADIUS_M)


def path_km(poses: Float64) -> float:
    """Return the length of a mapped path without its gaps [km]."""
    steps = np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1)
    return float(steps[steps < 10.0].sum()) / 1000
