"""The data that flows through the pipeline: small frozen dataclasses over arrays."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from .errors import InvalidScan

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]
Int64 = NDArray[np.int64]
Pose = NDArray[np.float64]
"""A (4, 4) float64 homogeneous transform. ``T_a_b`` takes points from frame b to frame a."""


class Scan:
    """One point cloud as a sensor saw it.

    Parameters
    ----------
    points : (N, >=3) array of any float dtype, any stride
        x, y, z in metres in the sensor frame, z up. Further columns are ignored. Never modified.
    times : (N,) array, optional
        Time of each point in seconds.
    stamp : float, optional
        Time of the scan in seconds (or any monotonic index).
    T_odom_sensor : (4, 4) array, optional
        Pose of the sensor in an odometry frame whose z axis points up.

    Attributes
    ----------
    points : (M, 3) float32, C-contiguous
        The finite points; ``dropped`` others (NaN or infinite) were left out with their times.

    Raises
    ------
    InvalidScan
        If a shape or dtype is wrong; the message names the fault.
    """

    __slots__ = ("T_odom_sensor", "dropped", "points", "stamp", "times")

    def __init__(
        self,
        points: ArrayLike,
        *,
        times: ArrayLike | None = None,
        stamp: float | None = None,
        T_odom_sensor: ArrayLike | None = None,
    ) -> None:
        xyz = _checked_points(points)
        stamps = _checked_times(times, len(xyz))
        finite = np.isfinite(xyz).all(axis=1)
        self.dropped = int(len(xyz) - finite.sum())
        if self.dropped:
            xyz = xyz[finite]
            stamps = None if stamps is None else stamps[finite]
        self.points: Float32 = xyz
        self.times: Float64 | None = stamps
        self.stamp = stamp
        self.T_odom_sensor: Pose | None = (
            None if T_odom_sensor is None else checked_pose(T_odom_sensor, "T_odom_sensor")
        )

    def __len__(self) -> int:
        return len(self.points)

    def __repr__(self) -> str:
        return f"Scan({len(self)} points, stamp={self.stamp})"


def _as_array(values: ArrayLike, name: str, dtype: DTypeLike | None = None) -> NDArray[Any]:
    try:
        return np.asarray(values, dtype=dtype)
    except (TypeError, ValueError) as error:
        raise InvalidScan(f"{name} must be an array of numbers") from error


def _checked_points(points: ArrayLike) -> Float32:
    array = _as_array(points, "points")
    if array.ndim != 2 or array.shape[1] < 3:
        raise InvalidScan(f"points must have shape (N, 3) or wider, not {array.shape}")
    if not np.issubdtype(array.dtype, np.floating):
        raise InvalidScan(f"points must be floating point, not {array.dtype}")
    with np.errstate(over="ignore", invalid="ignore"):  # too large for float32 becomes inf: dropped
        return np.ascontiguousarray(array[:, :3], dtype=np.float32)


def _checked_times(times: ArrayLike | None, count: int) -> Float64 | None:
    if times is None:
        return None
    array: Float64 = _as_array(times, "times", np.float64)
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
    T: Pose = _as_array(pose, name, np.float64).copy()
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


class Recording(Protocol):
    """Scans in the order in which they were taken: all that mapping and localizing need.

    Attributes
    ----------
    name : str
    indices : (N,) int64
        The numbers of the scans: what poses are keyed by and what a selection names.
    poses : (N, 4, 4) float64 or None
        T_odom_sensor of each scan, where known.
    """

    @property
    def name(self) -> str: ...
    @property
    def indices(self) -> Int64: ...
    @property
    def poses(self) -> Float64 | None: ...

    def __len__(self) -> int: ...

    def scan(self, i: int) -> Scan:
        """The scan at position i (0 to N - 1), stamped with its index, with its pose if known."""
        ...


@dataclass(frozen=True)
class LocalCloud:
    """Points around one pose of the sensor, gathered from one scan or from several.

    The local frame has its origin at the reference sensor and its z axis up; its x axis is the
    heading of the sensor.

    Attributes
    ----------
    points : (N, 3) float32
        Local frame, metres.
    T_local_sensor : (4, 4) float64
        The reference sensor's pose in the local frame: roll and pitch, no translation.
    num_scans : int
        How many scans the points come from.
    stamp : float or None
        Stamp of the reference scan.
    """

    points: Float32
    T_local_sensor: Pose
    num_scans: int = 1
    stamp: float | None = None


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
        Height of each centroid above the ground below it, metres.
    """

    points: Float32
    offsets: Int64
    centroids: Float64
    heights: Float32

    def __len__(self) -> int:
        return len(self.centroids)

    @property
    def sizes(self) -> Int64:
        """Number of points of each segment, (P,) int64."""
        return np.diff(self.offsets)

    def segment(self, index: int) -> Float32:
        """The (n, 3) points of one segment."""
        return self.points[self.offsets[index] : self.offsets[index + 1]]


@dataclass(frozen=True)
class Descriptors:
    """What a descriptor says of P segments.

    Attributes
    ----------
    vectors : (P, dim) float32
        Compared by Euclidean distance.
    quality : (P,) float32 or None
        In [0, 1]: how likely a match of this descriptor is to be right.
    """

    vectors: Float32
    quality: Float32 | None = None

    def __len__(self) -> int:
        return len(self.vectors)


@dataclass(frozen=True)
class Matches:
    """Candidate pairs (query segment, map segment), best first (the order that PROSAC needs).

    Attributes
    ----------
    query, map : (M,) int64
        Indices of the segments.
    distance : (M,) float32
        Euclidean distance of the descriptors.
    score : (M,) float32
        Falling; higher is more likely to be right.
    """

    query: Int64
    map: Int64
    distance: Float32
    score: Float32

    def __len__(self) -> int:
        return len(self.query)


@dataclass(frozen=True)
class Hypothesis:
    """One candidate pose and what speaks for it.

    Attributes
    ----------
    T_map_local : (4, 4) float64
    inliers : int
        Distinct query segments that agree with the pose (one map segment each).
    overlap : float
        Share of the live cloud's points, up to the height that the map reaches there, that have a
        map point near them, in [0, 1].
    seen : float
        The other way round: share of the map's points in view that have a live point near them, in
        [0, 1]; the others were looked through. NaN where too few are in view.
    rmse : float
        Root mean square distance of the pairs that overlap counts, metres.
    margin : float
        How many times as many inliers as the best hypothesis at a different place; that is what
        chance achieves for this query. NaN where none was compared.
    rival_overlap, rival_seen : float
        The most that ``overlap`` and ``seen`` reach at any of the best different places. NaN where
        none was compared.
    """

    T_map_local: Pose
    inliers: int
    overlap: float = 0.0
    seen: float = float("nan")
    rmse: float = float("nan")
    margin: float = float("nan")
    rival_overlap: float = float("nan")
    rival_seen: float = float("nan")
    covariance: Float64 | None = None

    @property
    def seen_or_overlap(self) -> float:
        """What is seen, or where too little is in view, what it is expected to be: the overlap."""
        return self.overlap if math.isnan(self.seen) else self.seen


@dataclass(frozen=True)
class Localization:
    """The answer to one query: a pose in the map, or the reason why there is none.

    Attributes
    ----------
    localized : bool
    reason : str
        "" when localized; else for example "no segments", "too few inliers (4 < 6)", "ambiguous".
    T_map_sensor : (4, 4) float64 or None
    inliers : int
        Distinct segments that agree with the best hypothesis.
    overlap : float
        Share of the live cloud, up to the height that the map reaches there, that lies on the map
        at the best hypothesis, in [0, 1].
    seen : float
        Share of the map in view that the live cloud confirms there, in [0, 1]; the rest was looked
        through. NaN where too little of the map is in view to tell.
    margin : float
        How many times as many inliers as the best hypothesis at a different place.
    rmse : float
        Residual of the refined alignment, metres (NaN where nothing was aligned).
    confidence : float
        Calibrated probability, in [0, 1], that the pose is right.
    covariance : (6, 6) float64 or None
        Of rotation (rad) then translation (m), in the sensor frame. None where it is not known.
    runner_up : Hypothesis or None
        The best hypothesis at a different place.
    counts : dict
        How many items each stage produced.
    times_ms : dict
        Milliseconds each stage took.
    stamp : float or None
        Stamp of the query.
    """

    localized: bool
    reason: str
    T_map_sensor: Pose | None = None
    inliers: int = 0
    overlap: float = 0.0
    seen: float = float("nan")
    margin: float = float("nan")
    rmse: float = float("nan")
    confidence: float = 0.0
    covariance: Float64 | None = None
    runner_up: Hypothesis | None = None
    counts: dict[str, int] = field(default_factory=dict)
    times_ms: dict[str, float] = field(default_factory=dict)
    stamp: float | None = None
