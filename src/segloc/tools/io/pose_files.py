"""Read files of poses: TUM, KITTI, tables with named columns, g2o, PCD and NPY."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal, NoReturn

import numpy as np
from scipy.spatial.transform import Rotation

from ...errors import DatasetError
from ...system.budget import check_points
from ...types import Float64
from .fields import brief, faults_of
from .npy import parse_array
from .pcd import parse_fields
from .scans import read_file
from .trajectory import Trajectory, first_fault, rigid_poses

_AXES, _QUATERNION, _EULER = ("x", "y", "z"), ("qx", "qy", "qz", "qw"), ("roll", "pitch", "yaw")
_TUM, _KITTI = 8, 12
_WIDTHS = (7, _TUM, _KITTI, 13, 16, 17)
"""Columns of tables without names: position and quaternion, or a matrix, perhaps after a time."""
_TIMED = (_TUM, 13, 17)
_MEANINGS = {
    4: "times and positions without rotations",
    6: "positions and Euler angles need a first line: x y z roll pitch yaw",
    7: "x y z qx qy qz qw have a quaternion of length 1, and times and Euler angles need a first "
    "line: time x y z roll pitch yaw",
}
"""What tables without names may be, by their number of columns."""
_UNIT_TOLERANCE = 0.05  # of a quaternion's length; some files have only two decimals
_MAX_RADIANS = 2 * np.pi + 0.1  # larger angles are in degrees
_ROW_TOLERANCE = 1e-6
_SYMBOL = 56  # bits of a number in a GTSAM key; a letter is above them
_G2O = re.compile(rb"\s*(?:#[^\n]*\n\s*)*(?:VERTEX|EDGE|FIX|PARAMS)[A-Z0-9_:]*[ \t]")
_PCD = re.compile(rb"\s*(?:#[^\n]*\n\s*)*VERSION[^\n]*\n(?:[^\n]*\n){1,20}?DATA ")

# --- names of columns -----------------------------------------------------------------------------

_MAX_COLUMNS = 200
_MAX_HEADER, _MAX_HEADER_BYTES = 100, 1 << 16
_UNIT = re.compile(r"(\S)\s+(?=[\[(])")  # a unit belongs to the name before it
_TIME_WORDS = frozenset(
    {"t", "time", "times", "timestamp", "timestamps", "stamp", "ts", "sec", "secs", "second"}
    | {"seconds", "utime", "unixtime", "rostime", "epoch"}
)
_TURN_WORDS = frozenset({"q", "quat", "quaternion", "orientation", "ori", "rot", "rotation"})
_EULER_WORDS = _TURN_WORDS | {
    "deg",
    "degree",
    "degrees",
    "rad",
    "radian",
    "radians",
    "euler",
    "rpy",
}
_PLACE_WORDS = frozenset(
    {"t", "p", "pos", "position", "trans", "translation", "pose", "field", "rs", "r", "m"}
)
_NANO_WORDS = frozenset({"nsec", "nsecs", "nanosec", "nanosecs", "nanoseconds"})
_UNIT_WORDS = frozenset({"s", "ms", "us", "ns"})
_NUMBER_WORDS = frozenset({"frame", "frame_id", "index", "idx", "id", "scan", "scan_id", "number"})
_TIME_UNITS = {
    r"nsec|nano|\bns\b|_ns": 1e-9,
    r"usec|micro|\bus\b|_us": 1e-6,
    r"msec|milli|\bms\b|_ms": 1e-3,
}


@dataclass(frozen=True)
class _Columns:
    """Columns of a table by name, in the order time, x, y, z, rotation, nanoseconds."""

    positions: list[int]
    timed: bool
    quaternion: bool  # False for roll, pitch, yaw
    unit_s: float = 1.0  # unit of times [s]
    degrees: bool | None = None  # unit of Euler angles; None if the names do not tell
    numbered: bool = False  # True if the times are numbers of frames


def delimiter(line: str) -> str | None:
    """Return comma or semicolon if present; None for white space."""
    return next((mark for mark in ",;" if mark in line), None)


def is_header(line: str) -> bool:
    """Return whether no word of a line is a number."""
    words = line.replace(",", " ").replace(";", " ").split()
    return all(word[:1].isalpha() and word.lower() not in ("nan", "inf") for word in words)


def _names(line: str) -> list[str]:
    """Return the names in a first line; a leading tab stands for a column without one."""
    content = line.strip().lstrip("#%").strip()
    mark = delimiter(content)
    names = content.split(mark) if mark else _UNIT.sub(r"\1", content).split()
    return ["", *names] if line.startswith("\t") and not mark else names


def _named_columns(names: Sequence[str]) -> _Columns | None:
    """Return the columns of positions and rotations, and of times if any; None if some lack."""
    roles = [_role(name) for name in names[:_MAX_COLUMNS]]
    turn = next((t for t in (_QUATERNION, _EULER) if all(role in roles for role in t)), None)
    if turn is None or any(axis not in roles for axis in _AXES):
        return None
    times = [k for k, role in enumerate(roles) if role == "time"]
    halves = [k for k in times if _words(names[k])[-1] in _NANO_WORDS]
    if len(times) == 2 and halves:  # seconds, and the nanoseconds of the same stamp
        roles[halves[0]] = "nanoseconds"
        times.remove(halves[0])
    if not times and "nanoseconds" in roles:  # of the whole stamp
        times.append(roles.index("nanoseconds"))
        roles[times[0]] = "time"
    times = ([k for k in times if "stamp" in names[k].lower()] or times)[:1]
    numbered = [] if times else [k for k, role in enumerate(roles) if role == "number"][:1]
    place = [roles.index(role) for role in (*_AXES, *turn)]
    nanos = [roles.index("nanoseconds")] if times and "nanoseconds" in roles else []
    text = names[times[0]].lower() if times and not nanos else ""
    unit = next((size for word, size in _TIME_UNITS.items() if re.search(word, text)), 1.0)
    angle = names[roles.index(turn[0])].lower()
    degrees = True if "deg" in angle or "°" in angle else False if "rad" in angle else None
    keys = times or numbered
    by_turn = turn == _QUATERNION, unit, degrees
    return _Columns([*keys, *place, *nanos], bool(keys), *by_turn, bool(numbered))


def _words(name: str) -> list[str]:
    """Return the words of a column's name, without its unit."""
    plain = name.lower().partition("[")[0].partition("(")[0].strip("\"' \t\r")
    return [part for part in re.split(r"[^a-z0-9]+", plain) if part]


def _role(name: str) -> str:
    """Return the role of a column: time, nanoseconds, an axis, part of a rotation, or ""."""
    parts = _words(name)
    if not parts:
        return ""
    angle = next((part for part in parts if part in _EULER), "")
    if angle and {*parts} - {angle} <= _EULER_WORDS:
        return angle
    axis, words = parts[-1][-1], {*parts[:-1], parts[-1][:-1]} - {""}
    if axis in "xyzw" and words & _TURN_WORDS:
        return f"q{axis}"
    if axis in "xyz" and words <= _PLACE_WORDS:
        return axis
    if parts[-1] in _NANO_WORDS and parts[0] not in _TIME_WORDS:
        return "nanoseconds"
    named = parts[:-1] if len(parts) > 1 and parts[-1] in _UNIT_WORDS else parts
    if parts[0] in _TIME_WORDS or named[-1] in _TIME_WORDS:
        return "time"
    return "number" if "_".join(parts) in _NUMBER_WORDS else ""


# --- files ----------------------------------------------------------------------------------------


@dataclass(frozen=True)
class PoseFile:
    """Poses of a file."""

    trajectory: Trajectory
    # "stamped": times or scan numbers; "numbered": perhaps of the scans; "kitti": rows of a
    # matrix; "rows": other rows in order
    kind: Literal["stamped", "numbered", "kitti", "rows"]
    note: str = ""  # how columns were read that could mean something else


@dataclass(frozen=True)
class _Table:
    """Numbers of a file."""

    numbers: Float64  # (N, C); the columns of ``columns`` in their order, if there are names
    lines: Sequence[int]
    columns: _Columns | None = None
    what: str = "line"
    note: str = ""

    def where(self, k: int) -> str:
        return f"{self.what} {self.lines[k]}"


def read_trajectory(path: str | Path) -> Trajectory:
    """Read a file of poses.

    ================== =========================================================================
    columns            meaning
    ================== =========================================================================
    8                  TUM: time x y z qx qy qz qw
    12, 16             KITTI: the upper three rows of each matrix, or all four
    7                  x y z qx qy qz qw, if all quaternions have length 1
    13, 17             a time or scan number, then a matrix
    named              a line above names x, y, z, and qx, qy, qz, qw or roll, pitch, yaw (R = Rz
                       Ry Rx; degrees if the name says so or an angle exceeds 2 pi), and perhaps a
                       time; other columns are ignored
    ================== =========================================================================

    Also g2o (``VERTEX_SE3:QUAT``, ``VERTEX_SE2``), PCD with these fields (LIO-SAM's
    ``transformations.pcd``), and NPY of shape (N, 4, 4), (N, 3, 4) or as above. Columns are
    separated by white space, commas or semicolons; lines with # are comments. Stamps rise; poses
    without one are numbered 0, 1, 2, ... A file of comments only has no poses.

    Raises
    ------
    DatasetError
        With file and line: columns that tell too little, text, NaN, a quaternion not of unit
        length, a matrix that is not a rotation, stamps that do not rise, implausible positions.
    """
    return read_pose_file(path).trajectory


def read_pose_file(path: str | Path) -> PoseFile:
    """Read like :func:`read_trajectory`; also return how the poses are keyed."""
    path = Path(path)
    with faults_of(path):
        table = _table(read_file(path))
        stamps, poses, note = _poses(table)
        fault = first_fault(stamps, poses)
        if fault is not None:
            raise DatasetError(f"{table.where(fault[0])}: {fault[1]}")
        width = table.numbers.shape[1]
        if table.columns and table.columns.numbered:
            return PoseFile(Trajectory(stamps, poses), "numbered", note)
        if table.columns.timed if table.columns else width in _TIMED:
            return PoseFile(Trajectory(stamps, poses), "stamped", note)
        kitti = table.columns is None and width in (_KITTI, 16)
        return PoseFile(Trajectory(stamps, poses), "kitti" if kitti else "rows", note)


def _table(data: bytes) -> _Table:
    if data.startswith(b"\x93NUMPY"):
        return _from_npy(data)
    if _PCD.match(data):
        return _from_pcd(data)
    if _G2O.match(data):
        return _from_g2o(data)
    if data.lstrip().startswith(b"{"):
        raise DatasetError(f"JSON, not {_expectation()}")
    return _from_text(data)


def _expectation() -> str:
    return (
        "a table of poses: rows of time x y z qx qy qz qw (TUM), of 12 or 16 numbers of a matrix "
        "(KITTI), or a first line that names the columns"
    )


def _from_npy(data: bytes) -> _Table:
    array = parse_array(data)
    rows = array.reshape(len(array), -1) if array.ndim == 3 and len(array) else array
    if rows.ndim != 2 or rows.shape[1] not in _WIDTHS:
        raise DatasetError(f"an array of shape {array.shape}, not poses of shape (N, 4, 4)")
    check_points(len(rows), "poses")
    with np.errstate(all="ignore"):
        return _Table(rows.astype(np.float64), range(len(rows)), what="row")


def _from_pcd(data: bytes) -> _Table:
    names, numbers = parse_fields(data)
    columns = _named_columns(names)
    if columns is None:
        raise DatasetError(
            f"a cloud with the fields {' '.join(names)[:100]}: poses need x y z and roll pitch "
            "yaw or qx qy qz qw, such as LIO-SAM's transformations.pcd has"
        )
    return _Table(numbers[:, columns.positions], range(len(numbers)), columns, "point")


def _from_g2o(data: bytes) -> _Table:
    """Return the vertices, by number; in order if the numbers have no gaps."""
    rows: dict[int, tuple[list[float], int]] = {}
    for k, line in enumerate(data.decode("utf-8", "replace").split("\n"), 1):
        words = line.split()
        if not words or words[0] not in ("VERTEX_SE3:QUAT", "VERTEX_SE2"):
            continue
        try:
            number = int(words[1]) & ((1 << _SYMBOL) - 1)
            values = [float(word) for word in words[2:]]
            if words[0] == "VERTEX_SE2":
                x, y, turn = values
                values = [x, y, 0.0, 0.0, 0.0, float(np.sin(turn / 2)), float(np.cos(turn / 2))]
            x, y, z, qx, qy, qz, qw = values
        except (ValueError, IndexError) as error:
            raise DatasetError(f"line {k}: not a vertex: {brief(line)}") from error
        if number in rows:
            raise DatasetError(f"line {k}: two vertices have the number {number}")
        rows[number] = [number, x, y, z, qx, qy, qz, qw], k
        check_points(len(rows), "poses")
    if not rows:
        raise DatasetError("a g2o file without VERTEX_SE3:QUAT or VERTEX_SE2")
    numbers = sorted(rows)
    table = np.array([rows[number][0] for number in numbers], dtype=np.float64)
    lines = [rows[number][1] for number in numbers]
    gaps = numbers[-1] - numbers[0] >= len(numbers)
    columns = _Columns(list(range(_TUM)), timed=True, quaternion=True, numbered=not gaps)
    return _Table(table, lines, columns)


def _from_text(data: bytes) -> _Table:
    text = data.decode("utf-8-sig", "replace").split("\n")
    lines = [k for k, line in enumerate(text) if line.partition("#")[0].strip()]
    check_points(len(lines), "poses")
    if not data.strip():
        raise DatasetError("empty file")
    first, names, columns = _header(text, lines[0] if lines else len(text) - 1)
    if lines and lines[0] == first and (columns is not None or is_header(text[first])):
        del lines[0]
        if columns is None:
            raise DatasetError(f"line {first + 1}: {_header_fault(names)}")
    if not lines:
        return _Table(np.empty((0, _TUM)), [])
    rows = _decimal_points([text[k].partition("#")[0].strip().rstrip(",;") for k in lines])
    mark = delimiter(rows[0])
    width = len(rows[0].split(mark))
    if columns is not None:
        whole = columns.timed or len(names) == width
        if max(columns.positions) >= width or not whole:
            columns = None  # a remark, not a header of these columns
    lines = [k + 1 for k in lines]
    chosen = columns.positions if columns else None
    try:
        numbers: Float64 = np.loadtxt(
            rows, comments=None, delimiter=mark, usecols=chosen, ndmin=2, dtype=np.float64
        )
    except ValueError:
        numbers = np.empty((0, 0))
    if numbers.shape[1] != (len(chosen) if chosen else width) or not (chosen or width in _WIDTHS):
        _raise_first_fault(rows, lines, mark, chosen)
    if columns and columns.numbered and not (np.diff(numbers[:, 0]) > 0).all():
        columns, numbers = _without_numbers(columns), numbers[:, 1:]  # such as of a robot
    return _Table(numbers, lines, columns)


def _without_numbers(columns: _Columns) -> _Columns:
    return replace(columns, positions=columns.positions[1:], timed=False, numbered=False)


def _header(text: list[str], last: int) -> tuple[int, list[str], _Columns | None]:
    """Return the line up to the first row that names columns, its names, and what they mean.

    The last one that names poses, or else the first.
    """
    lines = [k for k in range(last + 1) if text[k].strip()][:_MAX_HEADER]
    named = [(k, names, _named_columns(names)) for k in lines if (names := _names(text[k]))]
    known = [each for each in named if each[2] is not None]
    return (known or named[:1] or [(0, [], None)])[-1]


def header_of(path: Path) -> str:
    """Return the line that names the columns of a table of poses; "" if there is none."""
    text = read_file(path)[:_MAX_HEADER_BYTES].decode("utf-8-sig", "replace").split("\n")
    rows = [k for k, line in enumerate(text) if line.partition("#")[0].strip()]
    first, _, columns = _header(text, rows[0] if rows else len(text) - 1)
    return text[first] if columns else ""


def _header_fault(names: list[str]) -> str:
    shown = ", ".join(name.strip() or "(no name)" for name in names[:20])
    vector = {"rx", "ry", "rz"} <= {name.strip().lower() for name in names}
    more = " (rx, ry, rz: name Euler angles roll, pitch, yaw)" if vector else ""
    return (
        "header without columns for time, x, y, z, and qx, qy, qz, qw or roll, pitch, yaw: it "
        f"names {shown[:120]}{more}"
    )


_DECIMAL_COMMA = re.compile(r"[-+]?\d+,\d+(?:[eE][-+]?\d+)?")


def _decimal_points(rows: list[str]) -> list[str]:
    """Return the rows with points in numbers, if the first has decimal commas."""
    words = rows[0].replace(";", " ").split()
    if len(words) < min(_WIDTHS) or not all(_DECIMAL_COMMA.fullmatch(word) for word in words):
        return rows
    return [row.replace(",", ".") for row in rows]


def _raise_first_fault(
    rows: list[str], lines: list[int], mark: str | None, chosen: list[int] | None
) -> NoReturn:
    """Raise DatasetError at the first line that is not a pose."""
    width = 0
    for line, row in zip(lines, rows, strict=True):
        words = row.split(mark)
        count = len(words)
        wrong = max(chosen) >= count if chosen else count not in _WIDTHS
        if wrong or (width and count != width):
            expected = width or "8 (TUM) or 12 (KITTI)"
            meaning = f": {_MEANINGS[count]}" if not width and count in _MEANINGS else ""
            raise DatasetError(f"line {line}: {count} columns, not {expected}{meaning}")
        width = count
        for word in [words[k] for k in chosen] if chosen else words:
            try:
                np.loadtxt([word], comments=None)
            except ValueError as error:
                raise DatasetError(
                    f"line {line}: could not convert string to float: {brief(repr(word))}"
                ) from error
    raise DatasetError("cannot parse the poses")


# --- poses ----------------------------------------------------------------------------------------


def _poses(table: _Table) -> tuple[Float64, Float64, str]:
    """Return stamps (N,), poses (N, 4, 4), and a note on how columns were read."""
    numbers, columns = table.numbers, table.columns
    if columns is None:
        timed = numbers.shape[1] in _TIMED
        stamps, rest = _stamps(numbers, timed), numbers[:, int(timed) :]
        if rest.shape[1] in (_KITTI, 16):
            return stamps, _from_matrices(rest), ""
        if timed:
            return stamps, _from_quaternions(table, rest), ""
        return (
            stamps,
            _from_quaternions(table, rest, named=False),
            ("7 columns read as x y z qx qy qz qw, one row per scan"),
        )
    stamps = _stamps(numbers, columns.timed) * (columns.unit_s if columns.timed else 1.0)
    first = int(columns.timed)
    last = first + len(_AXES) + len(_QUATERNION if columns.quaternion else _EULER)
    if numbers.shape[1] > last:
        stamps = stamps + 1e-9 * numbers[:, last]
    if columns.quaternion:
        return stamps, _from_quaternions(table, numbers[:, first:last]), table.note
    return stamps, *_from_euler(numbers[:, first:last], columns.degrees)


def _stamps(numbers: Float64, timed: bool) -> Float64:
    return numbers[:, 0] if timed else np.arange(len(numbers), dtype=np.float64)


def _from_quaternions(table: _Table, rows: Float64, *, named: bool = True) -> Float64:
    """Return the poses of rows x y z qx qy qz qw."""
    with np.errstate(all="ignore"):
        norms = np.linalg.norm(rows[:, 3:], axis=1)
        unit = np.abs(norms - 1) <= _UNIT_TOLERANCE  # False for NaN
    if not unit.all():
        first = int(unit.argmin())
        if not named:
            raise DatasetError(
                f"{table.where(first)}: 7 columns, not 8 (TUM) or 12 (KITTI): {_MEANINGS[7]}"
            )
        raise DatasetError(f"{table.where(first)}: a quaternion of length {norms[first]:g}, not 1")
    if not len(rows):  # older SciPy rejects empty input
        return np.empty((0, 4, 4))
    return rigid_poses(rows[:, :3], Rotation.from_quat(rows[:, 3:]))


def _from_euler(rows: Float64, degrees: bool | None) -> tuple[Float64, str]:
    """Return the poses of rows x y z roll pitch yaw, and a note if the unit was derived."""
    note = ""
    if degrees is None:
        with np.errstate(invalid="ignore"):
            degrees = bool((np.abs(rows[:, 3:]) > _MAX_RADIANS).any())
        unit = "degrees" if degrees else "radians"
        note = f"roll, pitch and yaw read as {unit}; names such as roll_deg or roll_rad tell"
    finite = np.isfinite(rows).all(axis=1)
    poses = np.full((len(rows), 4, 4), np.nan)
    if finite.any():
        turns = Rotation.from_euler("xyz", rows[finite, 3:], degrees=degrees)  # Rz Ry Rx
        poses[finite] = rigid_poses(rows[finite, :3], turns)
    return poses, note


def _from_matrices(rows: Float64) -> Float64:
    """Return the poses of rows of 12 or 16 numbers; 16 may be stored column by column."""
    poses = np.tile(np.eye(4), (len(rows), 1, 1))
    if rows.shape[1] == _KITTI:
        poses[:, :3] = rows.reshape(-1, 3, 4)
        return poses
    given = rows.reshape(-1, 4, 4)
    by_row, by_column = (_ends_in_0001(T) for T in (given, given.transpose(0, 2, 1)))
    given = given.transpose(0, 2, 1) if by_column and not by_row else given
    poses[:, :3] = given[:, :3]
    if not by_row and not by_column:
        poses[:, 3] = given[:, 3]  # reported as not rigid
    return poses


def _ends_in_0001(matrices: Float64) -> bool:
    with np.errstate(invalid="ignore"):
        return bool((np.abs(matrices[:, 3] - [0, 0, 0, 1]) <= _ROW_TOLERANCE).all())
