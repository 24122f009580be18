"""Trajectories, written as TUM and KITTI files."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from ...errors import DatasetError
from ...system.checks import MAX_METRES, are_rotations
from ...system.files import write_text
from ...types import Float64, Pose

LONGEST_STEP_M = 1e5
"""Maximum distance between consecutive poses, across cuts of a recording [m]."""


@dataclass(frozen=True)
class Trajectory:
    """Poses of a sensor by time.

    Raise DatasetError if a shape is wrong, a value is not finite, a pose is not rigid, lies beyond
    ``MAX_METRES`` or farther than ``LONGEST_STEP_M`` from the one before, or stamps do not rise.
    """

    stamps: Float64  # (N,) seconds, or any index; strictly rising
    poses: Float64  # (N, 4, 4) T_world_sensor

    def __post_init__(self) -> None:
        stamps = np.array(self.stamps, dtype=np.float64)
        poses = np.array(self.poses, dtype=np.float64)
        if stamps.ndim != 1 or poses.shape != (len(stamps), 4, 4):
            raise DatasetError(f"stamps {stamps.shape} and poses {poses.shape} do not match")
        fault = first_fault(stamps, poses)
        if fault is not None:
            raise DatasetError(f"pose {fault[0]}: {fault[1]}")
        for name, array in (("stamps", stamps), ("poses", poses)):
            array.setflags(write=False)
            object.__setattr__(self, name, array)

    def __len__(self) -> int:
        return len(self.stamps)

    def at(self, stamp: float) -> Pose | None:
        """Return the (4, 4) pose at exactly this stamp, or None."""
        position = int(np.searchsorted(self.stamps, stamp))
        if position == len(self) or self.stamps[position] != stamp:
            return None
        return np.array(self.poses[position])


def first_fault(stamps: Float64, poses: Float64) -> tuple[int, str] | None:
    """Return the position of the first invalid pose, and its fault; None if there is none."""
    with np.errstate(all="ignore"):
        rising = np.diff(stamps, prepend=-np.inf) > 0
    rigid = are_rotations(poses[:, :3, :3]) & (poses[:, 3] == [0, 0, 0, 1]).all(axis=1)
    faults = {
        "a stamp that is not finite": ~np.isfinite(stamps),
        "a value that is not finite": ~np.isfinite(poses).all(axis=(1, 2)),
        "not a rigid transform": ~rigid,
        "stamps that do not rise": ~rising,
        **implausible(poses),
    }
    bad = np.logical_or.reduce(list(faults.values()))
    if not bad.any():
        return None
    first = int(bad.argmax())
    return first, next(what for what, where in faults.items() if where[first])


def implausible(poses: Float64) -> dict[str, NDArray[np.bool_]]:
    """Return faults of positions, and which poses (N, 4, 4) have them."""
    xyz = poses[:, :3, 3]
    with np.errstate(all="ignore"):
        far = (np.abs(xyz) > MAX_METRES).any(axis=1)
        torn = np.linalg.norm(np.diff(xyz, axis=0, prepend=xyz[:1]), axis=1) > LONGEST_STEP_M
    return {
        f"a position beyond {MAX_METRES:.0e} m": far,
        f"a position more than {LONGEST_STEP_M / 1000:.0f} km from the one before": torn,
    }


def rigid_poses(xyz: Float64, rotations: Rotation) -> Float64:
    """Return poses (N, 4, 4) from positions (N, 3) and N rotations."""
    poses = np.tile(np.eye(4), (len(xyz), 1, 1))
    poses[:, :3, :3] = rotations.as_matrix()
    poses[:, :3, 3] = xyz
    return poses


def pose_rows(poses: Float64) -> Float64:
    """Return rows x y z qx qy qz qw (N, 7) of poses (N, 4, 4), with qw >= 0."""
    if not len(poses):  # older SciPy rejects empty input
        return np.empty((0, 7))
    quaternions = Rotation.from_matrix(np.array(poses[:, :3, :3])).as_quat()
    quaternions *= np.where(quaternions[:, 3:] < 0, -1.0, 1.0)  # q and -q are the same rotation
    return np.concatenate([poses[:, :3, 3], quaternions], axis=1)


def write_tum(path: str | Path, trajectory: Trajectory, remark: str = "") -> None:
    """Write ``stamp tx ty tz qx qy qz qw`` with 9 decimals and qw >= 0, atomically.

    A remark is written as a second comment line.

    Raises
    ------
    DatasetError
        If two stamps are equal to 9 decimals.
    SeglocError
        If the file cannot be written.
    """
    write_text(path, tum_text(path, trajectory, remark))


def tum_text(name: str | Path, trajectory: Trajectory, remark: str = "") -> str:
    """Return what :func:`write_tum` writes; errors call it ``name``."""
    if (np.diff(np.round(trajectory.stamps, 9)) <= 0).any():
        raise DatasetError(f"{name}: two stamps are equal to 9 decimals")
    rows = np.column_stack([trajectory.stamps, pose_rows(trajectory.poses)])
    header = "# stamp tx ty tz qx qy qz qw\n" + (f"# {remark}\n" if remark else "")
    return _format_rows(rows, "%.9f", header)


def write_kitti(path: str | Path, trajectory: Trajectory) -> None:
    """Write the upper three rows of each pose, 12 numbers per line, without stamps.

    Raises
    ------
    SeglocError
        If the file cannot be written.
    """
    write_text(path, _format_rows(trajectory.poses[:, :3].reshape(-1, 12), "%.12e", ""))


def _format_rows(rows: Float64, number: str, header: str) -> str:
    row = " ".join([number] * rows.shape[1]) + "\n"
    return header + "".join(row % tuple(values) for values in rows)
