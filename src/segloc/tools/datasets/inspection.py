"""Summarise a recording and list its problems."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from ... import geometry
from ...errors import DatasetError
from ...motion import times_fit
from ...system.checks import MAX_METRES
from ...types import Scan
from .recorded import RecordedSequence
from .signature import Signature, signature
from .tracks import LONGEST_GAP_S

UNUSABLE = f"infinite or beyond {MAX_METRES:.0e} m"
_MAX_SPEED_M_S = 60.0
_SIZE_RATIO = 3.0  # scans larger or smaller than the median by this are reported
_USUAL_SPREADS = 7.5  # and by this many median deviations of the logarithm
_MAX_DROPPED = 0.05  # share of unusable points above which a scan is reported
_MIN_POINTS = 1000  # needed to recognise a sensor
_MAX_CHANGES = 3  # sensor changes listed
_OTHER_SENSOR = "another sensor from here on"


@dataclass(frozen=True)
class Inspection:
    """Facts about a recording."""

    sensor: str  # guessed from the points: "16 beams, -15.0 to 15.0 deg", ...
    sampled: int  # number of scans read
    points: int  # median per scan
    unusable: float  # share of points infinite or beyond ``MAX_METRES``, in [0, 1]
    blank: float  # share of points that are NaN: missing returns of organised clouds, in [0, 1]
    missing_returns: float  # share of points that stand for firings without a return, in [0, 1]
    rate_hz: float | None  # median; None without stamps
    duration_s: float | None
    length_m: float | None  # trajectory length; None without poses
    poses: str  # source of the poses, or "none"
    timed: bool  # True if points have times
    problems: tuple[str, ...]  # one line each
    sensor_changes: tuple[str, ...]  # one line each: scans at which the sensor changes


def inspect(recording: RecordedSequence, sample: int = 20) -> Inspection:
    """Inspect stamps, poses, and ``sample`` scans spread over the recording.

    Unreadable scans are listed as problems, not raised.
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
    blank = sum(scan.blank for _, scan in scans)
    unusable = sum(_unusable(scan) for _, scan in scans)
    missing = sum(scan.missing_returns for _, scan in scans)
    given = max(1, sum(sizes) + blank + unusable + missing)
    stamps, poses, track = recording.stamps, recording.poses, recording.track
    steps = np.diff(stamps) if stamps is not None else np.empty(0)
    return Inspection(
        sensor=_sensor(scans),
        sampled=len(scans),
        points=int(np.median(sizes)) if sizes else 0,
        unusable=unusable / given,
        blank=blank / given,
        missing_returns=missing / given,
        rate_hz=float(1 / np.median(steps)) if len(steps) else None,
        duration_s=float(stamps[-1] - stamps[0]) if stamps is not None and len(stamps) else None,
        length_m=None if poses is None else float(geometry.distance_travelled(poses)[-1]),
        poses="none" if track is None else f"{track.source} ({len(track.keys)})",
        timed=any(scan.times is not None for _, scan in scans),
        problems=tuple(problems),
        sensor_changes=tuple(_sensor_changes(recording, scans)),
    )


def _scan_problems(recording: RecordedSequence, scans: list[tuple[int, Scan]]) -> list[str]:
    problems = []
    if not any(len(scan) for _, scan in scans):
        return []  # a finding of its own
    median, ratio = _usual_size(scans)
    for i, scan in scans:
        where = recording.where(i)
        if _broken(scan):
            whole = len(scan) + scan.dropped
            problems.append(f"{where}: {_unusable(scan)} of {whole} points are {UNUSABLE}")
        elif not median / ratio <= len(scan) <= median * ratio:
            problems.append(f"{where}: {len(scan)} points, the median is {median:.0f}")
        if scan.times is not None and len(scan) and not times_fit(scan):
            problems.append(f"{where}: times are not seconds after the stamp: not de-skewed")
    return problems


def _usual_size(scans: list[tuple[int, Scan]]) -> tuple[float, float]:
    """Return the median number of points of a scan, and by which ratio a scan may differ."""
    sizes = np.array([len(scan) for _, scan in scans if len(scan)] or [1])
    median = float(np.median(sizes))
    spread = float(np.median(np.abs(np.log(sizes / median))))
    return median, max(_SIZE_RATIO, float(np.exp(_USUAL_SPREADS * spread)))


def _sensor(scans: list[tuple[int, Scan]]) -> str:
    """Describe the sensor of the largest scan."""
    largest = max((scan for _, scan in scans), key=len, default=None)
    found = None if largest is None else signature(largest.points)
    return "unknown" if found is None else str(found)


def _sensor_changes(recording: RecordedSequence, scans: list[tuple[int, Scan]]) -> list[str]:
    """List the scans at which the sensor changes, searched between those of the sample."""
    whole = [(i, scan) for i, scan in scans if not _broken(scan) and len(scan) >= _MIN_POINTS]
    signed = [(i, signature(scan.points)) for i, scan in whole]
    known = [(i, found) for i, found in signed if found is not None]
    changes = []
    for (low, old), (high, new) in pairwise(known):
        if new.is_like(old):
            continue
        place = _first_unlike(recording, old, low, high)
        changes.append(f"{recording.where(place)}: {_OTHER_SENSOR}: {new}; before: {old}")
    more = len(changes) - _MAX_CHANGES
    rest = [f"{_OTHER_SENSOR}: {more} more times"] if more > 0 else []
    return [*changes[:_MAX_CHANGES], *rest]


def _first_unlike(recording: RecordedSequence, old: Signature, low: int, high: int) -> int:
    """Return the position of the change, given ``low`` like ``old`` and ``high`` unlike it."""
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


def _unusable(scan: Scan) -> int:
    """Count the dropped points that no driver writes for a missing return."""
    return scan.dropped - scan.blank


def _broken(scan: Scan) -> bool:
    return _unusable(scan) > _MAX_DROPPED * (len(scan) + scan.dropped)


def _time_problems(recording: RecordedSequence) -> list[str]:
    stamps = recording.stamps
    if stamps is None or len(stamps) < 2:
        return []
    steps = np.diff(stamps)
    problems = []
    if (steps <= 0).any():
        problems.append(f"stamps do not rise after scan {recording.indices[(steps <= 0).argmax()]}")
    long = steps > 3 * np.median(steps)
    if recording.poses is not None:  # a robot at rest misses nothing
        lengths = np.linalg.norm(np.diff(recording.poses[:, :3, 3], axis=0), axis=1)
        long &= (lengths > 3 * np.median(lengths)) | (steps > LONGEST_GAP_S)
    if long.any():
        problems.append(
            f"{int(long.sum())} gaps in time, the longest {steps[long].max():.2f} s "
            f"after scan {int(recording.indices[np.where(long, steps, 0.0).argmax()])}"
        )
    return problems


def _pose_problems(recording: RecordedSequence) -> list[str]:
    poses, stamps, track = recording.poses, recording.stamps, recording.track
    if poses is None:
        return []
    problems = []
    if track is not None and len(track.gaps):
        usual = float(np.median(np.diff(track.keys)))  # key frames may be seconds apart
        gaps = track.gaps[track.gaps > 3 * usual]
        if len(gaps):
            problems.append(
                f"{len(gaps)} gaps in the poses, the longest {gaps.max():.1f} s: scans in them are "
                "left out"
            )
    lengths = np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1)
    if stamps is None or not len(lengths):
        return problems
    with np.errstate(divide="ignore", invalid="ignore"):
        jumps = (lengths > _MAX_SPEED_M_S * np.diff(stamps)) & (lengths > 1.0)
    if jumps.any():
        first = int(jumps.argmax())
        problems.append(
            f"poses jump {int(jumps.sum())} times, by {lengths[first]:.1f} m "
            f"after scan {int(recording.indices[first])}"
        )
    return problems
