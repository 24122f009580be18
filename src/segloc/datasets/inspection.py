"""What is in a recording, and what is wrong with it."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Protocol

import numpy as np

from .. import geometry
from ..errors import DatasetError
from ..motion import times_fit
from ..system.checks import MOST_METRES
from ..types import Float64, Int64, Scan
from .signature import Signature, signature
from .tracks import LONGEST_GAP_S, Track

UNUSABLE = f"not finite or beyond {MOST_METRES:.0e} m"
_FASTEST_M_S = 60.0
_ODD_SIZE = 3.0  # times more or fewer points than the median
_SUBSTANTIAL = 0.05
_FEWEST_POINTS = 1000  # that tell a sensor from another
_MOST_CHANGES = 3  # of the sensor that are listed
_OTHER_SENSOR = "another sensor from here on"


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
    """Facts about a recording."""

    sensor: str  # a guess from the points: "16 beams, -15.0 to 15.0 deg", ...
    sampled: int  # how many scans were read
    points: int  # median of their sizes
    dropped: float  # share of points that are not finite or beyond ``MOST_METRES``, in [0, 1]
    missing_returns: float  # share of points that stand for firings without a return, in [0, 1]
    rate_hz: float | None  # median, where scans have stamps
    duration_s: float | None
    length_m: float | None  # of the way, where there are poses
    poses: str  # where they come from, or "none"
    timed: bool  # whether points have times
    problems: tuple[str, ...]  # one line each
    sensor_changes: tuple[str, ...]  # likewise, where scans begin to be of another sensor


def inspect(recording: Inspectable, sample: int = 20) -> Inspection:
    """Look at stamps, poses, and ``sample`` scans spread over the recording.

    Scans that cannot be read are among the problems, not raised.
    """
    problems = list(recording.notes)
    scans: list[tuple[int, Scan]] = []
    for i in geometry.spread(len(recording), sample):
        try:
            scans.append((i, recording.raw(i)))
        except DatasetError as error:
            problems.append(str(error))
    problems += _scan_problems(recording, scans)
    problems += _time_problems(recording) + _pose_problems(recording)
    sizes = [len(scan) for _, scan in scans]
    dropped = sum(scan.dropped for _, scan in scans)
    missing = sum(scan.missing_returns for _, scan in scans)
    given = max(1, sum(sizes) + dropped + missing)
    stamps, poses = recording.stamps, recording.poses
    steps = np.diff(stamps) if stamps is not None else np.empty(0)
    return Inspection(
        sensor=_sensor(scans),
        sampled=len(scans),
        points=int(np.median(sizes)) if sizes else 0,
        dropped=dropped / given,
        missing_returns=missing / given,
        rate_hz=float(1 / np.median(steps)) if len(steps) else None,
        duration_s=float(stamps[-1] - stamps[0]) if stamps is not None and len(stamps) else None,
        length_m=None if poses is None else float(geometry.travelled(poses)[-1]),
        poses=_source(recording),
        timed=any(scan.times is not None for _, scan in scans),
        problems=tuple(problems),
        sensor_changes=tuple(_sensor_changes(recording, scans)),
    )


def _source(recording: Inspectable) -> str:
    track = recording.track
    if track is None:
        return "none"
    return track if isinstance(track, str) else f"{track.source} ({len(track.keys)})"


def _scan_problems(recording: Inspectable, scans: list[tuple[int, Scan]]) -> list[str]:
    problems = []
    median = float(np.median([len(scan) for _, scan in scans])) if scans else 0.0
    if scans and not any(len(scan) for _, scan in scans):
        return [f"no point in any of the {len(scans)} scans that were read"]
    for i, scan in scans:
        where = recording.where(i)
        if _broken(scan):
            whole = len(scan) + scan.dropped
            problems.append(f"{where}: {scan.dropped} of {whole} points are {UNUSABLE}")
        elif not _within(len(scan), median):
            problems.append(f"{where}: {len(scan)} points, where others have {median:.0f}")
        if scan.times is not None and len(scan) and not times_fit(scan):
            problems.append(f"{where}: times are not seconds after the stamp: not de-skewed")
    return problems


def _sensor(scans: list[tuple[int, Scan]]) -> str:
    """What the largest scan was measured by."""
    largest = max((scan for _, scan in scans), key=len, default=None)
    found = None if largest is None else signature(largest.points)
    return "unknown" if found is None else str(found)


def _sensor_changes(recording: Inspectable, scans: list[tuple[int, Scan]]) -> list[str]:
    """Where scans begin to be of another sensor: between those of the sample it is searched for."""
    whole = [(i, scan) for i, scan in scans if not _broken(scan) and len(scan) >= _FEWEST_POINTS]
    signed = [(i, signature(scan.points)) for i, scan in whole]
    known = [(i, found) for i, found in signed if found is not None]
    changes = []
    for (low, old), (high, new) in pairwise(known):
        if new.is_like(old):
            continue
        place = _first_unlike(recording, old, low, high)
        changes.append(f"{recording.where(place)}: {_OTHER_SENSOR}: {new}, before it {old}")
    more = len(changes) - _MOST_CHANGES
    rest = [f"{_OTHER_SENSOR}: {more} more times"] if more > 0 else []
    return [*changes[:_MOST_CHANGES], *rest]


def _first_unlike(recording: Inspectable, old: Signature, low: int, high: int) -> int:
    """The position of the change; ``low`` is like ``old``, ``high`` is not."""
    while high - low > 1:
        middle = (low + high) // 2
        try:
            found = signature(recording.raw(middle).points)
        except DatasetError:
            found = None
        if found is None or found.is_like(old):
            low = middle
        else:
            high = middle
    return high


def _broken(scan: Scan) -> bool:
    return scan.dropped > _SUBSTANTIAL * (len(scan) + scan.dropped)


def _within(size: int, median: float) -> bool:
    return median / _ODD_SIZE <= size <= median * _ODD_SIZE


def _time_problems(recording: Inspectable) -> list[str]:
    stamps = recording.stamps
    if stamps is None:
        return []
    steps = np.diff(stamps)
    if not len(steps):
        return []
    problems = []
    if (steps <= 0).any():
        problems.append(f"times do not rise behind scan {_number(recording, steps <= 0)}")
    long = steps > 3 * np.median(steps)
    if recording.poses is not None:  # who is slow for a moment misses nothing
        ways = np.linalg.norm(np.diff(recording.poses[:, :3, 3], axis=0), axis=1)
        long &= (ways > 3 * np.median(ways)) | (steps > LONGEST_GAP_S)
    if long.any():
        problems.append(
            f"{int(long.sum())} gaps in time, the longest {steps[long].max():.2f} s "
            f"behind scan {int(recording.indices[np.where(long, steps, 0.0).argmax()])}"
        )
    return problems


def _number(recording: Inspectable, where: np.ndarray) -> int:
    return int(recording.indices[int(where.argmax())])


def _pose_problems(recording: Inspectable) -> list[str]:
    poses, stamps, track = recording.poses, recording.stamps, recording.track
    if poses is None:
        return []
    problems = []
    if isinstance(track, Track) and len(track.gaps):
        usual = float(np.median(np.diff(track.keys)))  # of key frames it may be seconds
        gaps = track.gaps[track.gaps > 3 * usual]
        if len(gaps):
            problems.append(
                f"{len(gaps)} gaps in the poses, the longest {gaps.max():.1f} s: scans in them are "
                "left out"
            )
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
