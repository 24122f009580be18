"""Data types of the pipeline: small frozen dataclasses over arrays."""

from __future__ import annotations

import copy
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, Generic, Literal, Protocol, TypeAlias, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .errors import DatasetError, InvalidScan, SeglocError
from .system import checks
from .system.checks import Float32 as Float32
from .system.checks import Float64 as Float64
from .system.checks import Pose as Pose
from .system.returns import measured_points

Int64 = NDArray[np.int64]
Bools = NDArray[np.bool_]
AttitudeSource = Literal["given", "estimated", "assumed"]
"""Source of roll and pitch: a pose or gravity, the scan itself, or none."""


class Scan:
    """One point cloud of a sensor.

    Parameters
    ----------
    points : (N, >=3) or (H, W, >=3) array of any float dtype, any stride
        x, y, z in metres in the sensor frame; or a structured array with fields x, y and z.
        Further columns and fields are ignored. Never modified.
    times : (N,) or (H, W) array, optional
        Time of each point in seconds.
    stamp : float, optional
        Time of the scan in seconds.
    T_odom_sensor : (4, 4) array, optional
        Pose of the sensor in an odometry frame whose z axis points up.
    gravity : (3,) array, optional
        Direction down in the sensor frame, of any length. (An accelerometer at rest measures up.)
    gravity_error_deg : float
        Error of that direction [degrees], within which an estimate from the scan is preferred.
    T_base_sensor : (4, 4) array, optional
        Mount of the sensor on a base that is mostly level: roll and pitch are estimated around it
        if neither pose nor gravity is known.

    Attributes
    ----------
    points : (M, 3) float32, C-contiguous
        Usable points. The others are dropped with their times.
    dropped : int
        Number of points with a coordinate that is NaN, infinite, or beyond ``MAX_METRES``.
    blank : int
        Number of those that are NaN, as organised clouds write missing returns.
    missing_returns : int
        Number of points of firings without a return: many at one position, or many at one range.
    kept : (N,) bool or None
        Mask of the given points that are kept; None for all.

    Raises
    ------
    InvalidScan
        If a shape or dtype is wrong; the message names the fault.
    """

    __slots__ = (
        "T_base_sensor",
        "T_odom_sensor",
        "blank",
        "dropped",
        "gravity",
        "gravity_error_deg",
        "kept",
        "missing_returns",
        "points",
        "stamp",
        "times",
    )

    def __init__(
        self,
        points: ArrayLike,
        *,
        times: ArrayLike | None = None,
        stamp: float | None = None,
        T_odom_sensor: ArrayLike | None = None,
        gravity: ArrayLike | None = None,
        gravity_error_deg: float = 0.0,
        T_base_sensor: ArrayLike | None = None,
    ) -> None:
        xyz = checks.checked_points(points)
        stamps = checks.checked_times(times, len(xyz))
        self.kept, self.dropped, self.blank, self.missing_returns = measured_points(xyz)
        if self.kept is not None:
            xyz = xyz[self.kept]
            stamps = None if stamps is None else stamps[self.kept]
        self.points: Float32 = xyz
        self.times: Float64 | None = stamps
        self.stamp = checks.checked_stamp(stamp)
        self.T_odom_sensor = checks.pose_if_given(T_odom_sensor, "T_odom_sensor")
        self.gravity: Float64 | None = (
            None if gravity is None else checks.checked_direction(gravity)
        )
        self.gravity_error_deg = checks.checked_angle(gravity_error_deg, "gravity_error_deg")
        self.T_base_sensor = checks.pose_if_given(T_base_sensor, "T_base_sensor")

    def __len__(self) -> int:
        return len(self.points)

    def __repr__(self) -> str:
        return f"Scan({len(self)} points, stamp={self.stamp})"


class Recording(Protocol):
    """Scans in the order of their time: the protocol of recordings.

    Attributes
    ----------
    name : str
    indices : (N,) int64
        Numbers of the scans, used by pose files and selections.
    stamps : (N,) float64 or None
        Times of the scans [s], if known.
    poses : (N, 4, 4) float64 or None
        T_odom_sensor of each scan, if known.
    """

    @property
    def name(self) -> str: ...
    @property
    def indices(self) -> Int64: ...
    @property
    def stamps(self) -> Float64 | None: ...
    @property
    def poses(self) -> Float64 | None: ...

    def __len__(self) -> int: ...

    def scan(self, i: int) -> Scan:
        """Return the scan at position i (0 to N - 1), with its stamp and pose if known."""
        ...


def stamp_at(recording: Recording, i: int) -> float | None:
    """Return the time of the scan at position i [s]; None if the recording has no times."""
    stamps = recording.stamps
    return None if stamps is None else float(stamps[i])


class MemoryRecording:
    """Recording of scans in memory.

    Parameters
    ----------
    scans : list of Scan or of (N, >=3) arrays
        Scans in the order of their time.
    poses : (K, 4, 4) array, optional
        T_odom_sensor of each scan; by default the scans' own, if all have one.
    stamps : (K,) array, optional
        Times of the scans [s]; by default the scans' own, if all have one.
    name : str

    Raises
    ------
    InvalidScan
        If a scan or a pose is invalid; names the first.
    DatasetError
        If there is no scan, the lengths differ, or some scans have a pose and others have none.
    """

    def __init__(
        self,
        scans: Iterable[Scan | ArrayLike],
        poses: ArrayLike | None = None,
        stamps: ArrayLike | None = None,
        name: str = "memory",
    ) -> None:
        self.name = name
        self._scans = [_scan_at(i, each) for i, each in enumerate(_as_list(scans, name))]
        count = len(self._scans)
        self.indices: Int64 = np.arange(count)
        given = None if poses is None else checks.checked_poses(poses, count, "poses")
        self.poses = self._own_poses() if given is None else given
        self.stamps = self._own_stamps()
        if stamps is not None:
            self.stamps = checks.checked_rows(stamps, "stamps", (count,), np.float64)

    def __len__(self) -> int:
        return len(self._scans)

    def __repr__(self) -> str:
        posed = "without poses" if self.poses is None else "with poses"
        return f"MemoryRecording({self.name!r}, {len(self)} scans {posed})"

    def scan(self, i: int) -> Scan:
        """Return the scan at position i (0 to K - 1), with its stamp and pose if known."""
        scan = copy.copy(self._scans[i])
        scan.T_odom_sensor = None if self.poses is None else self.poses[i].copy()
        scan.stamp = None if self.stamps is None else float(self.stamps[i])
        return scan

    def _own_poses(self) -> Float64 | None:
        found = [scan.T_odom_sensor for scan in self._scans]
        missing = [i for i, T in enumerate(found) if T is None]
        if missing and len(missing) < len(found):
            raise DatasetError(
                f"{self.name}: scan {missing[0]} has no T_odom_sensor ({len(missing)} of "
                f"{len(found)} have none): give all of them one, or poses=(K, 4, 4)"
            )
        return None if missing else np.stack([T for T in found if T is not None])

    def _own_stamps(self) -> Float64 | None:
        found = [scan.stamp for scan in self._scans if scan.stamp is not None]
        return np.array(found) if len(found) == len(self._scans) else None


def _as_list(scans: Iterable[Any], name: str) -> list[Any]:
    if isinstance(scans, (str, bytes, Scan)) or not isinstance(scans, Iterable):
        raise InvalidScan(
            f"scans must be a recording, or a list of Scan or of (N, 3) arrays, not "
            f"{type(scans).__name__}: see segloc.MemoryRecording, or segloc.open_sequence of a path"
        )
    if isinstance(scans, np.ndarray) and (scans.ndim == 2 or scans.dtype.names):
        raise InvalidScan(
            f"scans must be a list of clouds, not one of shape {scans.shape}: [points]"
        )
    listed = list(scans)
    if not listed:
        raise DatasetError(f"{name}: no scan in it")
    return listed


def _scan_at(i: int, given: Scan | ArrayLike) -> Scan:
    try:
        return given if isinstance(given, Scan) else Scan(given)
    except InvalidScan as error:
        raise InvalidScan(f"scans[{i}]: {error}") from error


Scanned: TypeAlias = "Recording | Iterable[Scan | ArrayLike]"
"""A recording, or scans or clouds in memory."""


def as_recording(given: Scanned, poses: ArrayLike | None = None) -> Recording:
    """Return the argument as a recording: itself, or a :class:`MemoryRecording`.

    Parameters
    ----------
    given : Recording, or list of Scan or of (N, >=3) arrays
    poses : (K, 4, 4) array, optional
        T_odom_sensor of each scan, in place of its own.

    Raises
    ------
    SeglocError
        If it is neither, or the poses do not fit it.
    """
    if not all(hasattr(given, name) for name in ("scan", "poses", "indices", "stamps")):
        return MemoryRecording(given, poses)  # type: ignore[arg-type]
    recording: Recording = given  # type: ignore[assignment]
    own = recording.poses if poses is None else poses
    if own is None:
        return recording
    try:
        checked = checks.checked_poses(own, len(recording), "poses")
    except InvalidScan as error:
        raise SeglocError(f"{recording.name}: {error}") from error
    return recording if poses is None else Reposed(recording, checked)


@dataclass(frozen=True)
class LocalCloud:
    """Points around one pose of the sensor, from one or several scans.

    The local frame has its origin at the reference sensor and its z axis up; its x axis is the
    heading of the sensor.

    Attributes
    ----------
    points : (N, 3) float32
        Points in the local frame [m].
    T_local_sensor : (4, 4) float64
        Pose of the reference sensor in the local frame: roll and pitch, no translation.
    num_scans : int
        Number of scans.
    stamp : float or None
        Stamp of the reference scan.
    attitude : "given", "estimated" or "assumed"
        Source of the roll and pitch in ``T_local_sensor``.
    voxel_size : float or None
        Edge of the voxel grid with one point per voxel, in order [m]; None if unknown.
    fault : str
        Why hardly any point of the scans is within reach; "" if enough are.

    Raises
    ------
    InvalidScan
        If a shape or dtype is wrong, or a value is not finite or too large. Other float types and
        layouts are converted.
    """

    points: Float32
    T_local_sensor: Pose
    num_scans: int = 1
    stamp: float | None = None
    attitude: AttitudeSource = "given"
    voxel_size: float | None = None
    fault: str = ""

    def __post_init__(self) -> None:
        checked = {
            "points": checks.checked_local_points(self.points),
            "T_local_sensor": checks.checked_pose(self.T_local_sensor, "T_local_sensor"),
            "num_scans": checks.checked_count(self.num_scans, "num_scans"),
            "stamp": checks.checked_stamp(self.stamp),
            "voxel_size": checks.edge_if_given(self.voxel_size, "voxel_size"),
        }
        for name, value in checked.items():
            object.__setattr__(self, name, value)


@dataclass(frozen=True)
class Segments:
    """P segments, packed.

    Attributes
    ----------
    points : (M, 3) float32
        Points of all segments, one segment after another, in the local frame.
    offsets : (P + 1,) int64
        Segment i is ``points[offsets[i]:offsets[i + 1]]``.
    centroids : (P, 3) float64
        Mean of each segment's points, local frame.
    heights : (P,) float32
        Height of each centroid above the ground below it [m].

    Raises
    ------
    InvalidScan
        If shapes do not fit, or a value is not finite or beyond ``MAX_LOCAL_METRES``; names the
        field and the row.
    """

    points: Float32
    offsets: Int64
    centroids: Float64
    heights: Float32

    def __post_init__(self) -> None:
        points = checks.checked_rows(self.points, "points", (-1, 3), np.float32)
        offsets = checks.checked_rows(self.offsets, "offsets", (-1,), np.int64)
        count = len(offsets) - 1
        wrong = count < 0 or offsets[0] != 0 or offsets[-1] != len(points)
        if wrong or (np.diff(offsets) < 0).any():
            raise InvalidScan(f"offsets must rise from 0 to the number of points, {len(points)}")
        centroids = checks.checked_rows(self.centroids, "centroids", (count, 3), np.float64)
        heights = checks.checked_rows(self.heights, "heights", (count,), np.float32)
        checked = {"points": points, "offsets": offsets, "centroids": centroids, "heights": heights}
        for name, rows in checked.items():
            checks.check_finite(rows, name, checks.MAX_LOCAL_METRES)  # whole numbers pass
            object.__setattr__(self, name, rows)

    def __len__(self) -> int:
        return len(self.centroids)

    @property
    def sizes(self) -> Int64:
        """Number of points of each segment, (P,) int64."""
        return np.diff(self.offsets)

    def segment(self, index: int) -> Float32:
        """Return the (n, 3) points of one segment."""
        return self.points[self.offsets[index] : self.offsets[index + 1]]


@dataclass(frozen=True)
class Descriptors:
    """Descriptors of P segments.

    Attributes
    ----------
    vectors : (P, dim) float32
        Vectors, compared by Euclidean distance.
    quality : (P,) float32 or None
        Probability that a match of the descriptor is correct, in [0, 1].
    """

    vectors: Float32
    quality: Float32 | None = None

    def __len__(self) -> int:
        return len(self.vectors)


@dataclass(frozen=True)
class Matches:
    """Candidate pairs (query segment, map segment), best first (the order of PROSAC).

    Attributes
    ----------
    query, map : (M,) int64
        Indices of the segments.
    distance : (M,) float32
        Euclidean distance of the descriptors.
    score : (M,) float32
        Scores, descending; higher is more probable.
    """

    query: Int64
    map: Int64
    distance: Float32
    score: Float32

    @classmethod
    def none(cls) -> Matches:
        """Return no matches."""
        rows, numbers = np.empty(0, np.int64), np.empty(0, np.float32)
        return cls(rows, rows, numbers, numbers)

    def __len__(self) -> int:
        return len(self.query)


@dataclass(frozen=True)
class Candidate:
    """A pose from matches or from similar clouds, before verification.

    Attributes
    ----------
    T_map_local : (4, 4) float64
    inliers : int
        Number of distinct query segments that agree with the pose (one map segment each).
    fit : float or None
        Share of the query's occupied cells that are occupied in the map, less a cost of map cells
        where the query sees ground; in [0, 1]. None for poses from matches.
    proposer : str
        Name of the proposer of the pose.
    """

    T_map_local: Pose
    inliers: int
    fit: float | None = None
    proposer: str = "segments"


SourceT = TypeVar("SourceT", bound=Recording)


@dataclass(frozen=True)
class Derived(Generic[SourceT]):
    """A recording of another's scans; the subclass defines its poses."""

    source: SourceT

    @property
    def name(self) -> str:
        return self.source.name

    @property
    def indices(self) -> Int64:
        return self.source.indices

    @property
    def stamps(self) -> Float64 | None:
        return self.source.stamps

    def __len__(self) -> int:
        return len(self.source)

    def scan(self, i: int) -> Scan:
        """Return the scan at position i."""
        return self.source.scan(i)


@dataclass(frozen=True)
class Reposed(Derived[Recording]):
    """The scans of a recording with other poses.

    Attributes
    ----------
    source : Recording
    poses : (N, 4, 4) float64

    Raises
    ------
    DatasetError
        If there are not as many poses as scans.
    """

    poses: Float64

    def __post_init__(self) -> None:
        if self.poses.shape != (len(self.source), 4, 4):
            raise DatasetError(
                f"{self.source.name}: poses of shape {self.poses.shape} for {len(self)} scans"
            )

    def scan(self, i: int) -> Scan:
        """Return the scan at position i, with its pose in this recording."""
        scan = super().scan(i)
        scan.T_odom_sensor = self.poses[i].copy()
        return scan
