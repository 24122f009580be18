"""Validation of arrays; every fault is an :class:`InvalidScan` that names it in one line."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from ..errors import InvalidScan

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]
Pose = NDArray[np.float64]
"""A (4, 4) float64 homogeneous transform. ``T_a_b`` takes points from frame b to frame a."""

MAX_METRES = 1e8
"""Maximum coordinate in any frame [m]. UTM and ECEF coordinates are below 1e7 m, ranges in
millimetres by mistake are too, and float64 resolves 1e-8 m. Poses beyond it are rejected; points of
a scan are dropped and counted."""

MAX_LOCAL_METRES = 1e5
"""Maximum coordinate of a local cloud [m]; farther points are in another frame or unit."""

ROTATION_TOLERANCE = 1e-3
"""Maximum deviation of the entries of R R^T from the identity."""

_MAX_ROW = 64  # (3, N) instead of (N, 3)


_READERS = {
    "points": "segloc.tools.io.read_scan(path).points",
    "cloud": "segloc.tools.io.clouds.read_cloud(path)",
    "poses": "segloc.tools.io.read_trajectory(path).poses",
    "trajectory": "segloc.tools.io.read_trajectory(path).poses",
}
"""What reads a file, by the name of the argument."""
_ATTRIBUTES = ("xyz", "points", "vertices", "poses")
"""Of objects of other libraries that hold the array (laspy, Open3D, PyVista, trimesh)."""

_UNIT = re.compile(r"\s*[\[(][^\[(]{0,20}[\])]$")
_MAX_NAMES, _MAX_TEXT = 12, 200  # of the fields listed in a message


def as_array(values: ArrayLike, name: str, dtype: DTypeLike | None = None) -> NDArray[Any]:
    """Return numbers as an array; anything else is refused with the line that makes one of it."""
    fault: Exception | None = None
    if isinstance(values, np.ma.MaskedArray) and values.dtype.kind == "f":
        values = values.filled(np.nan)
    if not (values is None or isinstance(values, (str, bytes, os.PathLike, Iterator))):
        try:
            array = np.asarray(values, dtype=dtype)
            if array.ndim or array.dtype.kind != "O":
                return array
        except Exception as error:  # of other libraries, any kind
            fault = error
    line = _line_for(values, name)
    raise InvalidScan(
        f"{name} must be an array of numbers, not {type(values).__name__}{line and f': {line}'}"
    ) from fault


def _line_for(values: Any, name: str) -> str:
    """Return what makes an array of a value; "" if unknown."""
    module = type(values).__module__
    if isinstance(values, (str, os.PathLike)):
        return f"pass {_READERS[name]}" if name in _READERS else ""
    if isinstance(values, bytes):
        return "pass np.frombuffer(data, np.float32).reshape(-1, 3), or the width of a row"
    if isinstance(values, Iterator):
        return "make a list of it"
    if module.startswith("torch"):
        return f"pass {name}.detach().cpu().numpy()"
    if module.startswith("open3d") and hasattr(values, "point"):
        return f"pass {name}.point.positions.numpy()"
    if hasattr(values, "point_step"):
        return f"pass sensor_msgs_py.point_cloud2.read_points({name})"
    held = next((each for each in _ATTRIBUTES if hasattr(values, each)), None)
    return f"pass np.asarray({name}.{held})" if held else ""


def axis_fields(names: Sequence[str]) -> list[int]:
    """Return the positions of the fields x, y and z, in upper case if not in lower.

    A unit after a name, as in "x [m]", is ignored.

    Raise InvalidScan if one is missing or occurs twice.
    """
    chosen, plain = [], [_UNIT.sub("", name) for name in names]
    for axis in "xyz":
        name = axis if axis in plain else axis.upper()
        if (found := plain.count(name)) != 1:
            fault = f"{found} fields named {axis}" if found else f"no field {axis}"
            raise InvalidScan(f"{fault}; fields: {', '.join(names[:_MAX_NAMES])[:_MAX_TEXT]}")
        chosen.append(plain.index(name))
    return chosen


def _number(value: float, name: str, unit: str) -> float:
    try:
        return float(value)
    except (TypeError, ValueError) as error:
        raise InvalidScan(f"{name} must be a number of {unit}, not {value!r:.60}") from error


def point_rows(points: ArrayLike, name: str = "points") -> NDArray[np.floating[Any]]:
    """Return points as rows (N, >=3) of their own floating point type, not copied if possible.

    What may be points is decided here: an array (N, >=3), an organised one (H, W, >=3), or a
    structured one of any shape with fields x, y and z, whose other fields are left out.
    """
    array = as_array(points, name)
    if (names := array.dtype.names) is not None:
        try:
            array = np.stack([array[names[k]] for k in axis_fields(names)], axis=-1)
        except InvalidScan as error:
            raise InvalidScan(f"{name} must have the fields x, y and z: {error}") from error
    shape = array.shape
    if len(shape) not in (2, 3) or shape[-1] < 3:
        raise InvalidScan(f"{name} must have shape (N, 3) or wider, or (H, W, 3), not {shape}")
    if shape[0] == 3 and shape[-1] > _MAX_ROW:
        how = "transpose it" if len(shape) == 2 else f"np.moveaxis({name}, 0, -1)"
        raise InvalidScan(f"{name} must have shape (N, 3), not {shape}: {how}")
    if array.dtype.kind != "f":
        raise InvalidScan(
            f"{name} must be floating point and in metres, not {array.dtype}: convert it"
        )
    return array.reshape(-1, shape[-1])


def checked_points(points: ArrayLike) -> Float32:
    """Return x, y, z of :func:`point_rows` as (N, 3) float32, C-contiguous; may be NaN."""
    rows = point_rows(points)
    with np.errstate(over="ignore", invalid="ignore"):  # beyond float32: inf
        return np.ascontiguousarray(rows[:, :3], dtype=np.float32)


def checked_local_points(points: ArrayLike) -> Float32:
    """Check a local cloud like :func:`checked_points`; finite and within ``MAX_LOCAL_METRES``."""
    array = checked_points(points)
    check_finite(array, "points", MAX_LOCAL_METRES)
    return array


def checked_count(count: int, name: str) -> int:
    """Return a positive integer."""
    if not isinstance(count, int) or count < 1:
        raise InvalidScan(f"{name} must be a positive whole number, not {count!r}")
    return count


def edge_if_given(edge: float | None, name: str) -> float | None:
    """Return the edge of a voxel as a positive finite number of metres, or None."""
    if edge is None:
        return None
    value = _number(edge, name, "metres")
    if not 0 < value < np.inf:
        raise InvalidScan(f"{name} must be positive, not {value}")
    return value


def checked_rows(values: ArrayLike, name: str, shape: tuple[int, ...], dtype: DTypeLike) -> Any:
    """Return finite ``values`` in a dtype and shape (-1: any), C-contiguous.

    They are copied only if necessary.
    """
    array = as_array(values, name)
    fits = array.ndim == len(shape) and all(
        wanted in (-1, found) for wanted, found in zip(shape, array.shape, strict=True)
    )
    if not fits:
        raise InvalidScan(f"{name} must have shape {_format_shape(shape)}, not {array.shape}")
    if array.dtype.kind not in ("fiu" if np.issubdtype(dtype, np.floating) else "iu"):
        raise InvalidScan(f"{name} cannot have dtype {array.dtype}")
    with np.errstate(over="ignore", invalid="ignore"):
        rows = np.ascontiguousarray(array, dtype=dtype)
    check_finite(rows, name)
    return rows


def check_finite(rows: NDArray[Any], name: str, most: float = np.inf) -> None:
    """Reject values that are not finite, or beyond ``most``; names the first row with one."""
    if rows.dtype.kind != "f" or not rows.size:
        return
    flat = rows.reshape(len(rows), -1)
    with np.errstate(invalid="ignore"):
        good = np.abs(flat) <= most if np.isfinite(most) else np.isfinite(flat)
    if not good.all():
        row = int(np.flatnonzero(~good.all(axis=1))[0])
        fault = "is not finite" if not np.isfinite(flat[row]).all() else f"is beyond {most:g} m"
        raise InvalidScan(f"{name}: row {row} {fault}")


def checked_times(times: ArrayLike | None, count: int) -> Float64 | None:
    if times is None:
        return None
    array: Float64 = as_array(times, "times", np.float64)
    if array.ndim == 2 and array.size == count:  # of organised points
        array = array.reshape(-1)
    if array.shape != (count,):
        raise InvalidScan(f"times must have shape ({count},), not {array.shape}")
    return array


def checked_direction(direction: ArrayLike) -> Float64:
    """Return a direction of gravity as a unit vector, (3,) float64."""
    try:
        vector: Float64 = np.array(direction, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InvalidScan(f"gravity must be three numbers, not {direction!r:.60}") from error
    if vector.shape != (3,) or not np.isfinite(vector).all():
        raise InvalidScan(f"gravity must be three finite numbers, not {direction!r:.60}")
    largest = np.abs(vector).max()
    if largest == 0.0:
        raise InvalidScan("gravity has length zero: omit it if unknown")
    vector /= largest  # squares neither overflow nor vanish
    vector /= np.linalg.norm(vector)
    return vector


def checked_angle(degrees: float, name: str) -> float:
    """Return an angle from 0 to 180 degrees."""
    value = _number(degrees, name, "degrees")
    if not 0 <= value <= 180:
        raise InvalidScan(f"{name} must be from 0 to 180, not {value}")
    return value


def checked_stamp(stamp: float | None) -> float | None:
    """Return a stamp as a finite float, or None."""
    if stamp is None:
        return None
    value = _number(stamp, "stamp", "seconds")
    if not np.isfinite(value):
        raise InvalidScan(f"stamp must be finite, not {value}")
    return value


def checked_height(height_m: float, sigma_m: float) -> tuple[float, float]:
    """Return a height and its standard deviation, both finite and within ``MAX_METRES``."""
    height, sigma = (_number(v, n, "metres") for v, n in ((height_m, "height"), (sigma_m, "sigma")))
    if not abs(height) <= MAX_METRES:
        raise InvalidScan(f"height must be finite and at most {MAX_METRES:g} m, not {height}")
    if not 0.0 <= sigma <= MAX_METRES:
        raise InvalidScan(f"standard deviation of a height must be 0 m or more, not {sigma}")
    return height, sigma


def checked_pose(pose: ArrayLike, name: str) -> Pose:
    """Return a copy of ``pose`` as a (4, 4) float64 rigid transform within ``MAX_METRES``."""
    T: Pose = as_array(pose, name, np.float64).copy()
    if T.shape != (4, 4):
        line = _FROM_QUATERNION if T.shape in ((7,), (8,)) else ""
        raise InvalidScan(f"{name} must have shape (4, 4), not {T.shape}{line}")
    R = T[:3, :3]
    if not np.isfinite(T).all():
        raise InvalidScan(f"{name} has values that are not finite")
    if np.abs(T[:3, 3]).max() > MAX_METRES:
        raise InvalidScan(f"{name} lies {np.abs(T[:3, 3]).max():.3g} m from the origin: metres?")
    if not are_rotations(R):
        raise InvalidScan(f"{name} is not a rigid transform: {_rotation_fault(R)}")
    if np.abs(T[3] - [0, 0, 0, 1]).max() > 1e-9:
        last = " ".join(f"{value:g}" for value in T[3])
        raise InvalidScan(f"{name} must end with the row 0 0 0 1, not {last}: transpose it?")
    return T


_FROM_QUATERNION = (
    ": T = np.eye(4), T[:3, 3] = xyz, "
    "T[:3, :3] = scipy.spatial.transform.Rotation.from_quat(xyzw).as_matrix()"
)


def _rotation_fault(R: Float64) -> str:
    """Return why a (3, 3) matrix is not a rotation."""
    with np.errstate(all="ignore"):
        error, sign = float(np.abs(R @ R.T - np.eye(3)).max()), float(np.linalg.det(R))
    if error <= ROTATION_TOLERANCE:
        return f"its axes are left-handed (determinant {sign:.0f})"
    return f"R R^T differs from the identity by {error:.2g}, more than {ROTATION_TOLERANCE:g}"


def checked_poses(poses: ArrayLike, count: int, name: str) -> Float64:
    """Return a copy of ``poses`` as (count, 4, 4) float64 rigid transforms."""
    array: Float64 = as_array(poses, name, np.float64)
    if array.ndim != 3 or array.shape[1:] != (4, 4):
        raise InvalidScan(
            f"{name} must have shape ({count}, 4, 4), not {array.shape}{_poses_line(array)}"
        )
    if len(array) != count:
        raise InvalidScan(f"{name}: {len(array)} for {count} scans: pass one (4, 4) pose per scan")
    return np.array([checked_pose(T, f"{name}[{i}]") for i, T in enumerate(array)])


def _poses_line(array: Float64) -> str:
    """Return what makes poses (K, 4, 4) of an array of another shape; "" if unknown."""
    lines = {
        (4, 4): ": one pose is poses[None]",
        (3, 4): ": append the row 0 0 0 1 to each",
        (16,): ": poses.reshape(-1, 4, 4)",
    }
    rows = ": rows of a file are read by segloc.tools.io.read_trajectory(path).poses"
    lines |= dict.fromkeys(((7,), (8,), (12,), (13,)), rows)
    return lines.get(array.shape if array.shape == (4, 4) else array.shape[1:], "")


def pose_if_given(pose: ArrayLike | None, name: str) -> Pose | None:
    """Check like :func:`checked_pose`, or return None."""
    return None if pose is None else checked_pose(pose, name)


def are_rotations(R: Float64) -> NDArray[np.bool_]:
    """Return which of (..., 3, 3) matrices are rotations, within ``ROTATION_TOLERANCE``."""
    with np.errstate(all="ignore"):  # overflow is no rotation
        error = np.abs(R @ np.swapaxes(R, -1, -2) - np.eye(3)).max(axis=(-2, -1), initial=0)
        return np.asarray((error <= ROTATION_TOLERANCE) & (np.linalg.det(R) > 0))


def _format_shape(shape: tuple[int, ...]) -> str:
    return str(tuple("N" if n < 0 else n for n in shape)).replace("'", "")
