"""What arrays must be before anything is done with them; each fault is named in one line."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from .errors import InvalidScan

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]
Pose = NDArray[np.float64]


def as_array(values: ArrayLike, name: str, dtype: DTypeLike | None = None) -> NDArray[Any]:
    try:
        return np.asarray(values, dtype=dtype)
    except (TypeError, ValueError) as error:
        raise InvalidScan(f"{name} must be an array of numbers") from error


def checked_points(points: ArrayLike) -> Float32:
    array = as_array(points, "points")
    if array.ndim != 2 or array.shape[1] < 3:
        raise InvalidScan(f"points must have shape (N, 3) or wider, not {array.shape}")
    if not np.issubdtype(array.dtype, np.floating):
        raise InvalidScan(f"points must be floating point, not {array.dtype}")
    with np.errstate(over="ignore", invalid="ignore"):  # too large for float32 becomes inf: dropped
        return np.ascontiguousarray(array[:, :3], dtype=np.float32)


def checked_times(times: ArrayLike | None, count: int) -> Float64 | None:
    if times is None:
        return None
    array: Float64 = as_array(times, "times", np.float64)
    if array.shape != (count,):
        raise InvalidScan(f"times must have shape ({count},), not {array.shape}")
    return array


def checked_pose(pose: ArrayLike, name: str) -> Pose:
    """A copy of ``pose`` as a (4, 4) float64 rigid transform.

    Raises
    ------
    InvalidScan
        If the shape is wrong, a value is not finite, or the rotation is not one (to 1e-3).
    """
    T: Pose = as_array(pose, name, np.float64).copy()
    if T.shape != (4, 4):
        raise InvalidScan(f"{name} must have shape (4, 4), not {T.shape}")
    R = T[:3, :3]
    if not np.isfinite(T).all():
        raise InvalidScan(f"{name} has values that are not finite")
    if np.abs(R @ R.T - np.eye(3)).max() > 1e-3 or np.linalg.det(R) < 0:
        raise InvalidScan(f"{name} is not a rigid transform")
    if np.abs(T[3] - [0, 0, 0, 1]).max() > 1e-9:
        raise InvalidScan(f"{name} must end with the row 0 0 0 1")
    return T
