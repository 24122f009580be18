"""Poses of recordings, by stamp or by scan number."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from ...errors import DatasetError
from ...motion import interpolated
from ...system.budget import check_points
from ...types import Float64, Int64, Pose
from ..io.fields import brief
from ..io.pose_files import read_pose_file
from ..io.scans import read_file
from ..io.trajectory import implausible, rigid_poses
from .clocks import epoch_unit, period_of, unit_beside, unit_by_spacing

LONGEST_GAP_S = 1.0
"""Poses farther apart in time are not interpolated."""
_UNUSABLE = "not finite, no unit quaternion, or stamp not rising"
_MIN_NUMBERS = 0.5  # share of whole stamps that are numbers of scans, if they are no times
_ROUNDING_S = 1e-6  # of seconds since 1970 in float64 or in decimals
_KEY_FRAME_S = 1.1e-3  # of times of key frames, in files with three decimals


@dataclass(frozen=True)
class Track:
    """Poses of a sensor.

    Raise DatasetError if a position is implausible; names the source and the pose, counted from 1.
    """

    source: str  # file or topic
    keys: Float64  # (K,) strictly rising: seconds on the scans' clock, or scan numbers
    poses: Float64  # (K, 4, 4) T_world_sensor, z up
    clock: Literal["seconds", "numbers"] = "seconds"  # kind of the keys
    note: str = ""  # what was dropped, or how columns were read

    def __post_init__(self) -> None:
        for fault, where in implausible(self.poses).items():
            if where.any():
                first = int(where.argmax()) + 1
                raise DatasetError(f"{self.source}: pose {first}: {fault}")

    def at(self, indices: Int64, stamps: Float64 | None) -> Float64:
        """Return T_world_sensor (N, 4, 4) at these scan numbers and stamps; NaN where unknown.

        Raise DatasetError if no scan has a pose.
        """
        if self.clock == "seconds":
            if stamps is None:
                raise DatasetError(f"{self.source}: stamped poses, but the scans have no stamps")
            found = interpolated(self.keys, self.poses, self._rounded(stamps), LONGEST_GAP_S)
        else:
            stamps = indices.astype(np.float64)
            found = interpolated(self.keys, self.poses, stamps, 0.0)
        if len(stamps) and np.isnan(found).all():
            raise DatasetError(
                f"{self.source}: no pose for any scan: poses are from {_span(self.keys)}, scans "
                f"from {_span(stamps)} ({self.clock})"
            )
        return found

    def _rounded(self, stamps: Float64) -> Float64:
        """Return stamps (N,) at the poses that they differ from by rounding alone.

        Key frames are not interpolated, and files round to milliseconds.
        """
        keys = np.concatenate([[-np.inf], self.keys, [np.inf]])  # gaps before and after
        after = np.searchsorted(keys, stamps).clip(1, len(keys) - 1)
        low, high = keys[after - 1], keys[after]
        nearest = np.where(np.abs(low - stamps) < np.abs(high - stamps), low, high)
        most_s = np.where(high - low > LONGEST_GAP_S, _KEY_FRAME_S, _ROUNDING_S)
        return np.where(np.abs(nearest - stamps) < most_s, nearest, stamps)

    def of_sensor(self, T_body_sensor: Pose) -> Track:
        """Return the track of a sensor mounted on the body of this track."""
        return replace(self, poses=self.poses @ T_body_sensor)

    @property
    def gaps(self) -> Float64:
        """Lengths of the gaps that are not interpolated (G,) [s]."""
        steps = np.diff(self.keys)
        return steps[steps > LONGEST_GAP_S] if self.clock == "seconds" else steps[:0]


def _span(values: Float64) -> str:
    return f"{values.min():.3f} to {values.max():.3f}"


def clean_track(source: str, stamps: Float64, poses: Float64) -> Track:
    """Build a track of stamped poses, except those that are not finite or out of order.

    Raise DatasetError if none remains, or as :class:`Track` does.
    """
    finite = np.isfinite(stamps) & np.isfinite(poses).all(axis=(1, 2))
    good = finite.copy()
    good[finite] = rising(stamps[finite])
    if not good.any():
        raise DatasetError(f"{source}: none of its {len(good)} poses is usable: {_UNUSABLE}")
    lost = len(good) - int(good.sum())
    note = f"{source}: {lost} of {len(good)} poses dropped: {_UNUSABLE}" if lost else ""
    return Track(source, stamps[good], poses[good], note=note)


def rising(stamps: Float64) -> NDArray[np.bool_]:
    """Return the most stamps (N,) of which each is later than the one before, as a mask.

    The longest rising subsequence, by the least last stamp of each length: a wrong stamp costs only
    itself. If a clock was set back, parts of both runs may remain.
    """
    if (np.diff(stamps) > 0).all():
        return np.ones(len(stamps), dtype=bool)
    least, rows = list[float](), list[int]()
    before = np.full(len(stamps), -1)
    for row, stamp in enumerate(stamps.tolist()):
        length = bisect_left(least, stamp)
        if length < len(least) and least[length] == stamp:
            continue  # of equal ones the first
        before[row] = rows[length - 1] if length else -1
        least[length : length + 1], rows[length : length + 1] = [stamp], [row]
    kept, row = np.zeros(len(stamps), dtype=bool), rows[-1]
    while row >= 0:
        kept[row], row = True, int(before[row])
    return kept


def read_track(path: Path, indices: Int64, stamps: Float64 | None) -> Track:
    """Read a file of poses as a track for scans with these numbers and stamps.

    Whole stamps are scan numbers; others are times in seconds, milli-, micro- or nanoseconds,
    recognised by the epoch, the scans' stamps, or their spacing. Stamped poses of as many unstamped
    scans are paired in order. Row i of a file without stamps is the pose of scan number i if it has
    that many rows, else of the scan at position i.

    Raise DatasetError if the file cannot be read, has no poses, or has times and the scans have
    none.
    """
    found = read_pose_file(path)
    keys, poses = np.array(found.trajectory.stamps), np.array(found.trajectory.poses)
    note = f"{path}: {found.note}" if found.note else ""
    if not len(keys):
        raise DatasetError(f"{path}: no poses")
    if found.kind == "numbered":
        if np.isin(keys, indices).all() or np.isin(indices, keys).all():
            return Track(str(path), keys, poses, "numbers", note)
        other = f"numbers {keys[0]:.0f} to {keys[-1]:.0f} are not those of the scans: in order"
        note = _noted(path, note, other)
        keys = np.arange(len(keys)).astype(np.float64)
    if found.kind != "stamped":
        return _by_rows(path, keys, poses, indices, note)
    unit = _time_unit(keys, poses, indices, stamps)
    if unit is None:
        return Track(str(path), keys, poses, "numbers", note)
    if stamps is None and len(keys) != len(indices):
        raise DatasetError(
            f"{path}: its {len(keys)} poses are stamped, from {_span(keys * unit)} s, but the "
            f"{len(indices)} scans have no stamps: give poses by scan number, or name the files of "
            "scans by their times"
        )
    return Track(str(path), keys * unit, poses, note=note)


def _noted(path: Path, note: str, more: str) -> str:
    """Return a note on a file with more to it."""
    return f"{note}; {more}" if note else f"{path}: {more}"


def _time_unit(
    keys: Float64, poses: Float64, indices: Int64, stamps: Float64 | None
) -> float | None:
    """Return the unit of a TUM file's stamps [s]; None if they are scan numbers."""
    if (unit := epoch_unit(keys)) is not None:
        by_number = stamps is None and bool(np.isin(keys, indices).any())
        return None if by_number else unit
    whole = not (keys % 1).any()
    counted = whole and (np.isin(keys, indices).mean() > _MIN_NUMBERS or period_of(keys) == 1.0)
    if stamps is None:
        spaced = unit_by_spacing(keys, poses) if len(keys) == len(indices) else None
        if not whole:
            return spaced or 1.0
        return None if counted else spaced
    if counted and np.isin(keys, indices).any():
        return None
    return unit_beside(keys, stamps) or (None if whole else 1.0)


def _by_rows(path: Path, keys: Float64, poses: Float64, indices: Int64, note: str) -> Track:
    """Return the track of poses without stamps."""
    if len(keys) > indices.max():
        if indices.min() > 0:
            more = f"scan {indices.min()} has row {indices.min() + 1}, since rows count from scan 0"
            note = _noted(path, note, more)
        return Track(str(path), keys, poses, "numbers", note)
    count = min(len(keys), len(indices))
    if count < len(indices):
        fewer = f"{count} rows, used as the poses of the first {count} scans"
        note = _noted(path, note, fewer)
    return Track(str(path), indices[:count].astype(np.float64), poses[:count], "numbers", note=note)


def read_table(
    path: Path, columns: Sequence[str | int], *, separator: str | None = ",", header: bool = False
) -> Float64:
    """Read columns of a file of numbers, (N, C) float64.

    columns: names, if the first line is a header, or positions
    separator: None for white space
    header: True to skip the first line

    Raise DatasetError if the file cannot be read or has no rows, a column is missing, or a value is
    not a number.
    """
    try:
        lines = read_file(path).decode("utf-8-sig", "replace").splitlines()
        names = [name.strip() for name in lines[0].split(separator)] if lines and header else []
        rows = [line for line in lines[header:] if line.strip() and not line.startswith("#")]
        if not rows:
            raise DatasetError("no rows")
        check_points(len(rows), "rows")
        for column in columns:
            if isinstance(column, str) and column not in names:
                raise DatasetError(f"no column {column!r} in its first line")
        chosen = [names.index(c) if isinstance(c, str) else c for c in columns]
        return np.loadtxt(rows, delimiter=separator, usecols=chosen, ndmin=2)
    except (DatasetError, ValueError, MemoryError) as error:
        raise DatasetError(f"{path}: {brief(error)}") from error


def euler_poses(xyz: Float64, angles: Float64) -> Float64:
    """Return poses (N, 4, 4) from positions (N, 3) and roll, pitch, yaw (N, 3) [rad].

    R = Rz(yaw) Ry(pitch) Rx(roll).
    """
    if not len(xyz):  # older SciPy rejects empty input
        return np.empty((0, 4, 4))
    return rigid_poses(xyz, Rotation.from_euler("ZYX", angles[:, ::-1]))


def are_unit(xyzw: Float64) -> NDArray[np.bool_]:
    """Return which quaternions (N, 4) have about unit length."""
    with np.errstate(all="ignore"):
        return np.asarray(np.abs(np.linalg.norm(xyzw, axis=1) - 1) < 0.05)


def quaternion_poses(xyz: Float64, xyzw: Float64, where: str) -> Float64:
    """Return poses (N, 4, 4) from positions (N, 3) and quaternions (N, 4) as x, y, z, w.

    Raise DatasetError if a quaternion is not of about unit length; names ``where`` and the row.
    """
    if not len(xyz):
        return np.empty((0, 4, 4))
    good = are_unit(xyzw)
    if not good.all():
        raise DatasetError(
            f"{where}: row {int(good.argmin()) + 1} has a quaternion not of length 1"
        )
    return rigid_poses(xyz, Rotation.from_quat(xyzw))


def matrix_poses(rows: Float64, where: str) -> Float64:
    """Return poses (N, 4, 4) from their upper three rows, (N, 12), with exact rotations.

    Rotations beside UTM-sized positions come rounded.

    Raise DatasetError if one is far from a rotation; names ``where`` and the row.
    """
    matrices = rows.reshape(-1, 3, 4)
    if not len(matrices):
        return np.empty((0, 4, 4))
    with np.errstate(all="ignore"):
        good = np.abs(np.linalg.det(matrices[:, :, :3]) - 1) < 0.1
    if not good.all():
        raise DatasetError(f"{where}: row {int(good.argmin()) + 1} is not a rotation")
    return rigid_poses(matrices[:, :, 3], Rotation.from_matrix(matrices[:, :, :3]))


def mount(xyz: Sequence[float], angles: Sequence[float]) -> Pose:
    """Return T_body_sensor from x, y, z [m] and roll, pitch, yaw [rad]."""
    poses = euler_poses(np.array([xyz], np.float64), np.array([angles], np.float64))
    return np.asarray(poses[0], dtype=np.float64)


Z_UP = np.diag([1.0, -1.0, -1.0, 1.0])
"""Turn by 180 degrees about x, between a frame with z down and one with z up."""
