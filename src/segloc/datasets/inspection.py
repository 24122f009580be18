"""What is in a recording, and what is wrong with it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from .. import geometry
from ..errors import DatasetError
from ..types import Float32, Float64, Int64, Scan
from .base import Recording
from .recorded import times_fit
from .tracks import Track

_FASTEST_M_S = 60.0
_ODD_SIZE = 3.0  # times more or fewer points than the median
_FLAT_M = 0.005
_BIN_DEG = 0.02
_MOST_COUNTED = 48  # beams; more of them are too close to be told apart reliably
_SUBSTANTIAL = 0.05
PUSH_BROOM = "a sweep of one plane"


class Inspectable(Protocol):
    """What sequences offer to be inspected by."""

    format: str
    frame: str
    fields: str
    notes: tuple[str, ...]

    @property
    def name(self) -> str: ...
    @property
    def indices(self) -> Int64: ...
    @property
    def stamps(self) -> Float64 | None: ...
    @property
    def poses(self) -> Float64 | None: ...
    @property
    def track(self) -> Track | str | None: ...
    def __len__(self) -> int: ...
    def raw(self, i: int) -> Scan: ...
    def where(self, i: int) -> str: ...


@dataclass(frozen=True)
class Inspection:
    """Facts about a recording.

    Attributes
    ----------
    sensor : str
        A guess from the points: "16 beams, -15.0 to 15.0 deg", "one plane", ...
    sampled : int
        How many scans were read.
    points : int
        Median of their sizes.
    dropped : float
        Share of points that are not finite, in [0, 1].
    rate_hz : float or None
        Median, where scans have stamps.
    duration_s : float or None
    length_m : float or None
        Of the way, where there are poses.
    poses : str
        Where they come from, or "none".
    timed : bool
        Whether points have times.
    problems : tuple of str
        One line each.
    """

    sensor: str
    sampled: int
    points: int
    dropped: float
    rate_hz: float | None
    duration_s: float | None
    length_m: float | None
    poses: str
    timed: bool
    problems: tuple[str, ...]


def inspect(recording: Inspectable, sample: int = 20) -> Inspection:
    """Look at stamps, poses, and ``sample`` scans spread over the recording.

    Scans that cannot be read are among the problems, not raised.
    """
    problems = list(recording.notes)
    chosen = np.unique(np.linspace(0, len(recording) - 1, max(1, sample)).round().astype(int))
    scans: list[tuple[int, Scan]] = []
    for i in map(int, chosen):
        try:
            scans.append((i, recording.raw(i)))
        except DatasetError as error:
            problems.append(str(error))
    problems += _scan_problems(recording, scans)
    problems += _time_problems(recording) + _pose_problems(recording)
    sizes = [len(scan) for _, scan in scans]
    dropped = sum(scan.dropped for _, scan in scans)
    stamps, poses = recording.stamps, recording.poses
    steps = np.diff(stamps) if stamps is not None else np.empty(0)
    return Inspection(
        sensor=_sensor([scan.points for _, scan in scans]),
        sampled=len(scans),
        points=int(np.median(sizes)) if sizes else 0,
        dropped=dropped / max(1, dropped + sum(sizes)),
        rate_hz=float(1 / np.median(steps)) if len(steps) else None,
        duration_s=float(stamps[-1] - stamps[0]) if stamps is not None and len(stamps) else None,
        length_m=None if poses is None else float(geometry.travelled(poses)[-1]),
        poses=_source(recording),
        timed=any(scan.times is not None for _, scan in scans),
        problems=tuple(problems),
    )


def _source(recording: Inspectable) -> str:
    track = recording.track
    if track is None:
        return "none"
    return track if isinstance(track, str) else f"{track.source} ({len(track.keys)})"


def _scan_problems(recording: Inspectable, scans: list[tuple[int, Scan]]) -> list[str]:
    problems = []
    median = float(np.median([len(scan) for _, scan in scans])) if scans else 0.0
    for i, scan in scans:
        where, whole = recording.where(i), len(scan) + scan.dropped
        if not _within(len(scan), median):
            problems.append(f"{where}: {len(scan)} points, where others have {median:.0f}")
        elif scan.dropped > _SUBSTANTIAL * whole:
            problems.append(f"{where}: {scan.dropped} of {whole} points are not finite")
        if scan.times is not None and len(scan) and not times_fit(scan):
            problems.append(f"{where}: times are not seconds after the stamp: not de-skewed")
    return problems


def _within(size: int, median: float) -> bool:
    return median / _ODD_SIZE <= size <= median * _ODD_SIZE


def _time_problems(recording: Inspectable) -> list[str]:
    stamps = recording.stamps
    if stamps is None:
        return ["scans have no times"]
    steps = np.diff(stamps)
    if not len(steps):
        return []
    problems = []
    if (steps <= 0).any():
        problems.append(f"times do not rise behind scan {_number(recording, steps <= 0)}")
    long = steps > 3 * np.median(steps)
    if long.any():
        problems.append(
            f"{int(long.sum())} gaps in time, the longest {steps.max():.2f} s "
            f"behind scan {int(recording.indices[steps.argmax()])}"
        )
    return problems


def _number(recording: Inspectable, where: np.ndarray) -> int:
    return int(recording.indices[int(where.argmax())])


def _pose_problems(recording: Inspectable) -> list[str]:
    poses, stamps, track = recording.poses, recording.stamps, recording.track
    if poses is None:
        return ["no poses: a map needs some (--poses FILE, or --odometry)"]
    problems = []
    if isinstance(track, Track) and len(track.gaps):
        gaps = track.gaps
        problems.append(f"{len(gaps)} gaps in the poses, the longest {gaps.max():.1f} s")
    if float(np.median(poses[:, 2, 2])) < 0.7:
        problems.append("the z axis of the sensor does not point up in the poses")
    ways = np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1)
    if stamps is None or not len(ways):
        return problems
    with np.errstate(divide="ignore", invalid="ignore"):
        jumps = (ways > _FASTEST_M_S * np.diff(stamps)) & (ways > 1.0)
    if jumps.any():
        first = int(jumps.argmax())
        problems.append(
            f"poses jump {int(jumps.sum())} times, by {ways[first]:.1f} m "
            f"behind scan {int(recording.indices[first])}"
        )
    return problems


def _sensor(clouds: list[Float32]) -> str:
    """What the points were measured by, from the angles at which they lie."""
    cloud = max(clouds, key=len, default=np.empty((0, 3), np.float32)).astype(np.float64)
    if len(cloud) < 3:
        return "unknown"
    if in_one_plane(cloud):
        return "2D, one plane"
    count, low, high = beams(cloud)
    span = f"{low:.1f} to {high:.1f} deg"
    if count > _MOST_COUNTED:
        return f"3D, 64 or more beams, {span}"
    return f"3D, {count} beams, {span}" if count >= 4 else f"3D, no separate beams, {span}"


def in_one_plane(cloud: NDArray[np.floating]) -> bool:
    """Whether the points (N, 3) lie in one plane, as those of a sensor that sweeps a line do."""
    few = cloud[:: max(1, len(cloud) // 2000)].astype(np.float64)
    spread = np.linalg.svd(few - few.mean(axis=0), compute_uv=False)
    return bool(spread[-1] < _FLAT_M * np.sqrt(len(few)))


def is_push_broom(recording: Recording) -> bool:
    """Whether scans are sweeps of one plane, by the largest of a few.

    Raises
    ------
    DatasetError
        If one of them cannot be read.
    """
    return sensor_of(recording) == PUSH_BROOM


def sensor_of(recording: Recording, sample: int = 5) -> str:
    """Roughly what took the scans, by the largest of ``sample`` of them, and "" if all are empty.

    Coarser than what :func:`inspect` says, so that sessions of one sensor are told alike: one of
    "a sweep of one plane", "few beams" (less than 48), "many beams".

    Raises
    ------
    DatasetError
        If one of them cannot be read.
    """
    chosen = np.unique(np.linspace(0, len(recording) - 1, sample).round().astype(int))
    clouds = [recording.scan(int(i)).points for i in chosen if len(recording)]
    cloud = max(clouds, key=len, default=np.empty((0, 3), np.float32)).astype(np.float64)
    if len(cloud) < 4:
        return ""
    if in_one_plane(cloud):
        return PUSH_BROOM
    return "many beams" if beams(cloud)[0] > _MOST_COUNTED else "few beams"


def beams(cloud: Float64) -> tuple[int, float, float]:
    """How many separate elevation angles points lie at, the lowest and the highest, degrees."""
    reach = np.linalg.norm(cloud, axis=1)
    far = cloud[reach > np.median(reach) / 4]  # near points suffer from where beams start
    angles = np.degrees(np.arctan2(far[:, 2], np.hypot(far[:, 0], far[:, 1])))
    counts, _ = np.histogram(angles, bins=np.arange(-90.0, 90.0 + _BIN_DEG, _BIN_DEG))
    weights = np.exp(-0.5 * (np.arange(-4, 5) / 1.5) ** 2)
    smooth = np.convolve(counts, weights / weights.sum(), "same")
    level = 0.15 * np.percentile(smooth[smooth > 0], 90)
    middle = smooth[1:-1]
    peaks = (middle > smooth[:-2]) & (middle >= smooth[2:]) & (middle > level)
    return int(peaks.sum()), float(angles.min()), float(angles.max())
