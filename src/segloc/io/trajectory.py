"""Trajectories, and their file formats TUM and KITTI."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, NoReturn

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation, Slerp

from ..errors import DatasetError
from ..system.budget import check_points
from ..system.checks import MAX_METRES, are_rotations
from ..system.files import write_text
from ..types import Float64, Pose
from .fields import faults_of, one_line
from .scans import read_file

TUM = ("time", "x", "y", "z", "qx", "qy", "qz", "qw")
"""Columns of a TUM file, in order."""
_MAX_COLUMNS = 200
_UNIT = re.compile(r"(\S)\s+(?=[\[(])")  # a unit belongs to the name before it
_TIME_WORDS = frozenset({"t", "time", "timestamp", "timestamps", "stamp", "ts", "sec", "secs"})
_TURN_WORDS = frozenset({"q", "quat", "quaternion", "orientation", "ori", "rot", "rotation"})
_PLACE_WORDS = frozenset(
    {"t", "p", "pos", "position", "trans", "translation", "pose", "field", "rs", "r", "m"}
)
_NANO_WORDS = frozenset({"nsec", "nsecs", "nanosec", "nanosecs", "nanoseconds"})
_TIME_UNITS = {
    r"nsec|nano|\bns\b|_ns": 1e-9,
    r"usec|micro|\bus\b|_us": 1e-6,
    r"msec|milli|\bms\b|_ms": 1e-3,
}


def delimiter(line: str) -> str | None:
    """Return comma or semicolon if present; None for white space."""
    return next((mark for mark in ",;" if mark in line), None)


def is_header(line: str) -> bool:
    """Return whether no word of a line is a number."""
    words = line.replace(",", " ").replace(";", " ").split()
    return all(word[:1].isalpha() and word.lower() not in ("nan", "inf") for word in words)


def named_columns(line: str) -> tuple[list[int] | None, float]:
    """Return the positions of a TUM file's columns by name, and the unit of its stamps [s].

    A ninth column holds nanoseconds beside whole seconds. Return None if columns are missing.
    """
    content = line.strip().lstrip("#%").strip()
    mark = delimiter(content)
    names = content.split(mark) if mark else _UNIT.sub(r"\1", content).split()
    roles = [_role(name) for name in names[:_MAX_COLUMNS]]
    if any(role not in roles for role in TUM):
        return None, 1.0
    stamped = [k for k, name in enumerate(names) if roles[k] == "time" and "stamp" in name.lower()]
    first = (stamped or [roles.index("time")])[0]
    columns = [first, *(roles.index(role) for role in TUM[1:])]
    if "nanoseconds" in roles:
        return [*columns, roles.index("nanoseconds")], 1.0
    time = names[first].lower()
    return columns, next((size for word, size in _TIME_UNITS.items() if re.search(word, time)), 1.0)


def _role(name: str) -> str:
    """Return the role of a column by name: time, x, y, z, qx, qy, qz, qw, or ""."""
    plain = name.lower().partition("[")[0].partition("(")[0].strip("\"' \t\r")
    parts = [part for part in re.split(r"[^a-z0-9]+", plain) if part]
    if not parts:
        return ""
    axis, words = parts[-1][-1], {*parts[:-1], parts[-1][:-1]} - {""}
    if axis in "xyzw" and words & _TURN_WORDS:
        return f"q{axis}"
    if axis in "xyz" and words <= _PLACE_WORDS:
        return axis
    if parts[-1] in _NANO_WORDS and parts[0] not in _TIME_WORDS:
        return "nanoseconds"
    return "time" if parts[0] in _TIME_WORDS or parts[-1] in _TIME_WORDS else ""


_UNIT_TOLERANCE = 0.05  # of a quaternion's length; some files have only two decimals
LONGEST_STEP_M = 1e5
"""Maximum distance between consecutive poses, across cuts of a recording [m]."""
_KINDS: dict[int, Literal["tum", "kitti"]] = {8: "tum", 12: "kitti"}


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
        fault = _first_fault(stamps, poses)
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

    def interpolate(self, stamp: float) -> Pose:
        """Interpolate the (4, 4) pose at a stamp: linear in position, slerp in rotation.

        Raise DatasetError if the stamp lies before the first or after the last.
        """
        exact = self.at(stamp)
        if exact is not None:
            return exact
        after = int(np.searchsorted(self.stamps, stamp))
        if not 0 < after < len(self):  # NaN sorts last
            raise DatasetError(f"no poses around stamp {stamp}")
        pair = slice(after - 1, after + 1)
        start, end = self.stamps[pair]
        share = (stamp - start) / (end - start)
        T = np.eye(4)
        ends = Rotation.from_matrix(np.array(self.poses[pair, :3, :3]))  # older SciPy writes to it
        T[:3, :3] = Slerp([0.0, 1.0], ends)(share).as_matrix()
        T[:3, 3] = (1 - share) * self.poses[after - 1, :3, 3] + share * self.poses[after, :3, 3]
        return T


def _first_fault(stamps: Float64, poses: Float64) -> tuple[int, str] | None:
    """Return the position of the first invalid pose, and its fault."""
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


def read_trajectory(path: str | Path) -> Trajectory:
    """Read a TUM file (8 columns) or a KITTI file (12 columns); lines with # are comments.

    TUM: ``stamp tx ty tz qx qy qz qw``, stamps rising, quaternions normalised. KITTI: the upper
    three rows of each pose, with stamps 0, 1, 2, ... A file of comments only has no poses.
    Columns are separated by white space, commas or semicolons. A first line that names a time, a
    position and a quaternion, as EuRoC's does, selects columns by name and the unit of time.

    Raises
    ------
    DatasetError
        With file and line: a wrong number of columns, text, NaN, a quaternion not of unit length,
        a matrix that is not a rotation, stamps that do not rise, implausible positions.
    """
    return read_trajectory_and_kind(path)[0]


def read_trajectory_and_kind(path: str | Path) -> tuple[Trajectory, Literal["tum", "kitti"]]:
    """Read like :func:`read_trajectory`; also return the file's format."""
    path = Path(path)
    with faults_of(path):
        numbers, lines = _parse_rows(read_file(path))
        kind = _KINDS[numbers.shape[1]]
        stamps, poses = _from_tum(numbers, lines) if kind == "tum" else _from_kitti(numbers)
        fault = _first_fault(stamps, poses)
        if fault is not None:
            raise DatasetError(f"line {lines[fault[0]]}: {fault[1]}")
    return Trajectory(stamps, poses), kind


def _parse_rows(data: bytes) -> tuple[Float64, list[int]]:
    """Return the numbers, (N, 8 or 12), and the line number of each row."""
    text = data.decode("utf-8-sig", "replace").split("\n")
    lines = [k for k, line in enumerate(text) if line.partition("#")[0].strip()]
    check_points(len(lines), "poses")
    if not data.strip():
        raise DatasetError("empty file")
    first = next((k for k, line in enumerate(text) if line.strip()), 0)
    named, unit = named_columns(text[first])
    if lines and lines[0] == first and (named is not None or is_header(text[first])):
        del lines[0]
        if named is None:
            raise DatasetError(
                f"line {first + 1}: header without columns for time, x, y, z, qx, qy, qz and qw"
            )
    if not lines:
        return np.empty((0, 8)), []
    rows = [text[k].partition("#")[0].strip().rstrip(",;") for k in lines]
    lines = [k + 1 for k in lines]
    mark = delimiter(rows[0])
    if named is not None and max(named) >= len(rows[0].split(mark)):
        named, unit = None, 1.0  # a remark, not a header of these columns
    try:
        numbers: Float64 = np.loadtxt(
            rows, comments=None, delimiter=mark, usecols=named, ndmin=2, dtype=np.float64
        )
    except ValueError:
        numbers = np.empty((0, 0))
    if named is not None and numbers.shape[1] == len(named):
        numbers[:, 0] *= unit
        numbers[:, 0] += 1e-9 * numbers[:, 8:].sum(axis=1)
        numbers = numbers[:, : len(TUM)]
    if numbers.shape[1] not in _KINDS:
        _raise_first_fault(rows, lines, mark, named)
    return numbers, lines


def _raise_first_fault(
    rows: list[str], lines: list[int], mark: str | None, named: list[int] | None
) -> NoReturn:
    """Raise DatasetError at the first line that is not a pose."""
    width = 0
    for line, row in zip(lines, rows, strict=True):
        words = row.split(mark)
        wrong = max(named) >= len(words) if named else len(words) not in _KINDS
        if wrong or (width and len(words) != width):
            expected = width or "8 (TUM) or 12 (KITTI)"
            raise DatasetError(f"line {line}: {len(words)} columns, not {expected}")
        width = len(words)
        for word in [words[k] for k in named] if named else words:
            try:
                np.loadtxt([word], comments=None)
            except ValueError as error:
                raise DatasetError(
                    f"line {line}: could not convert string to float: {one_line(repr(word))}"
                ) from error
    raise DatasetError("cannot parse the poses")


def _from_tum(numbers: Float64, lines: list[int]) -> tuple[Float64, Float64]:
    with np.errstate(all="ignore"):
        norms = np.linalg.norm(numbers[:, 4:], axis=1)
        unit = np.abs(norms - 1) <= _UNIT_TOLERANCE  # False for NaN
    if not unit.all():
        first = int(unit.argmin())
        raise DatasetError(f"line {lines[first]}: a quaternion of length {norms[first]:g}, not 1")
    if not len(numbers):  # older SciPy rejects empty input
        return numbers[:, 0], np.empty((0, 4, 4))
    return numbers[:, 0], rigid_poses(numbers[:, 1:4], Rotation.from_quat(numbers[:, 4:]))


def _from_kitti(numbers: Float64) -> tuple[Float64, Float64]:
    poses = np.tile(np.eye(4), (len(numbers), 1, 1))
    poses[:, :3] = numbers.reshape(-1, 3, 4)
    return np.arange(len(numbers), dtype=np.float64), poses


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
    path = Path(path)
    if (np.diff(np.round(trajectory.stamps, 9)) <= 0).any():
        raise DatasetError(f"{path}: two stamps are equal to 9 decimals")
    rows = np.column_stack([trajectory.stamps, pose_rows(trajectory.poses)])
    header = "# stamp tx ty tz qx qy qz qw\n" + (f"# {remark}\n" if remark else "")
    write_text(path, _format_rows(rows, "%.9f", header))


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
