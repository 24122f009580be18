"""Recordings of datasets and loggers behind one interface."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ...errors import ConfigError, DatasetError, SeglocError
from ...motion import Motion, at_stamp
from ...types import Float64, Int64, Pose, Recording, Scan, stamp_at
from ..io.fields import faults_of
from ..io.point_times import time_field, unread_times
from ..io.scans import read_file, read_scan
from .clocks import TimeUnit, period_of, time_unit
from .gravity import GravitySource
from .tracks import Track, read_track

_RANGE = re.compile(r"(\d{0,18})(:?)(\d{0,18})", re.ASCII)


class Sequence(Recording, Protocol):
    """A recording of which parts can be selected."""

    def select(self, selection: Selection) -> Sequence:
        """Return the scans whose indices are selected, in the same order."""
        ...


@dataclass(frozen=True)
class Selection:
    """Ranges of indices, both ends included; None is an open end."""

    ranges: tuple[tuple[int, int | None], ...]

    def mask(self, indices: Int64) -> NDArray[np.bool_]:
        """Return which of the indices are selected, (N,) bool."""
        chosen = np.zeros(len(indices), dtype=bool)
        for first, last in self.ranges:
            chosen |= (indices >= first) & (True if last is None else indices <= last)
        return chosen

    def __str__(self) -> str:
        return ",".join(f"{a}:{'' if b is None else b}" for a, b in self.ranges)


def parse_select(text: str) -> Selection:
    """Parse a selection like ``100:947,1001:1100``: inclusive ranges, open ends, single numbers.

    Raises
    ------
    ConfigError
        If a part is not ``7``, ``100:947``, ``100:`` or ``:50``, or ends before it starts.
    """
    return Selection(tuple(_parse_range(part.strip(), text) for part in text.split(",")))


def _parse_range(part: str, text: str) -> tuple[int, int | None]:
    found = _RANGE.fullmatch(part)
    if found is None or not (found[1] or found[3]):
        raise ConfigError(
            f"selection {text[:80]!r}: {part[:40]!r} is neither a number nor a range A:B"
        )
    first = int(found[1] or 0)
    last = first if not found[2] else int(found[3]) if found[3] else None
    if last is not None and last < first:
        raise ConfigError(f"selection {text[:80]!r}: {part} ends before it starts")
    return first, last


def assemble(
    found: Found,
    poses: Path | None,
    selection: Selection | None,
    own_poses: bool,
    deskew: bool,
    T_base_sensor: Pose | None,
) -> RecordedSequence:
    """Build a sequence from the scans that a reader found, with the chosen poses.

    Scans outside the poses in time, or in a gap of them, are dropped and noted.

    poses: file of poses
    selection: indices of the scans to keep
    own_poses: True to use the recording's own poses if no file is given
    T_base_sensor: (4, 4) mount of the sensor on the body of the poses; None if they are the
      sensor's

    Raise DatasetError if there are no scans, none is selected, the poses cannot be read, or no scan
    has one.
    """
    if not len(found.indices):
        raise DatasetError(f"{found.name}: {found.format} without scans")
    track, at_scans, stamps, pose_notes = _track_and_poses(found, poses, own_poses, T_base_sensor)
    notes, motion = [*found.notes, *pose_notes], None
    if track is not None and deskew and track.clock == "seconds" and len(track.keys) > 1:
        motion = Motion(track.keys, track.poses)
    unit = _time_unit(found, stamps)
    notes += [unit.note] if unit is not None and unit.note else []
    sequence = RecordedSequence(
        found.name, found.format, found.frame, found.fields, found.source,
        np.arange(len(found.indices)), found.indices, stamps, at_scans, track, motion,
        tuple(notes), found.T_base_sensor if T_base_sensor is None else T_base_sensor,
        time_unit=unit,
    )  # fmt: skip
    if selection is not None:
        sequence = sequence.select(selection)
    if track is None or sequence.poses is None:
        notes += [found.gravity.note] if found.gravity and found.gravity.note else []
        return replace(sequence, gravity=found.gravity, notes=tuple(notes))
    known = np.isfinite(sequence.poses[:, 0, 0])
    if known.all():
        return sequence
    lost = f"{int((~known).sum())} of {len(known)} scans dropped: no pose in {track.source}"
    if not known.any():
        raise DatasetError(lost)
    used = f"using the other {int(known.sum())} (--select A:B,C:D selects fewer)"
    return replace(sequence.part(known), notes=(*notes, f"{lost}; {used}"))


def _track_and_poses(
    found: Found, poses: Path | None, own_poses: bool, T_base_sensor: Pose | None
) -> tuple[Track | None, Float64 | None, Float64 | None, list[str]]:
    """Return the sensor's track, its poses at the scans, the scans' stamps, and notes."""
    stamps = found.stamps
    if poses is not None:
        if (track := found.own_poses(poses)) is None:
            track = read_track(poses, found.indices, stamps)
            track = track if T_base_sensor is None else track.of_sensor(T_base_sensor)
        notes = [track.note] * bool(track.note)
        if stamps is None and track.clock == "seconds" and len(track.keys) == len(found.indices):
            stamps = track.keys
            notes.append(f"{track.source}: stamped poses paired with unstamped scans in order")
        at_scans = track.at(found.indices, stamps)
        return track, at_scans, stamps, notes
    if not own_poses:
        return None, None, stamps, []
    try:
        own = found.own_track()
        if own is None and found.base_track is not None and T_base_sensor is not None:
            own = found.base_track.of_sensor(T_base_sensor)
        if own is None:
            return None, None, stamps, []
        return own, own.at(found.indices, stamps), stamps, [own.note] * bool(own.note)
    except DatasetError as error:  # scans are readable without poses
        return None, None, stamps, [f"{error}: poses not used"]


def _time_unit(found: Found, stamps: Float64 | None) -> TimeUnit | None:
    """Recognise the unit of point times from some scans; None if the format defines it."""
    if found.times_sure or stamps is None:
        return None
    if (names := found.fields.split()) and time_field(names) is None:
        return TimeUnit(note=unread_times(names))
    count = len(found.indices)
    samples = []
    for k in sorted({0, count // 2, count - 1}):
        try:
            times = found.source.read(k).times
        except SeglocError:
            continue  # reported when the scan is read
        if times is not None:
            samples.append((times, float(stamps[k])))
    return time_unit(samples, period_of(stamps))


class Source(Protocol):
    """Reader of single scans; picklable."""

    def read(self, k: int) -> Scan:
        """Read scan k; times, if any, in seconds after the scan's stamp."""
        ...

    def where(self, k: int) -> str:
        """Return the name of scan k for messages: its file or message."""
        ...


@dataclass(frozen=True)
class FileSource:
    """Scans in files, one each."""

    paths: tuple[Path, ...]
    parse: Callable[[bytes], Scan] | None = None  # parser of a file's bytes; None: by suffix

    def where(self, k: int) -> str:
        return str(self.paths[k])

    def read(self, k: int) -> Scan:
        if self.parse is None:
            return read_scan(self.paths[k])
        with faults_of(self.paths[k]):
            return self.parse(read_file(self.paths[k]))


@dataclass(frozen=True)
class Found:
    """Contents that the reader of a format found at a path, before poses are chosen."""

    name: str  # of the recording
    format: str
    source: Source
    indices: Int64  # (N,) numbers of the source's scans
    stamps: Float64 | None  # (N,) seconds
    frame: str  # frame of the points
    fields: str  # fields of each point
    notes: tuple[str, ...] = ()  # faults found, one line each
    topic: str | None = None  # sensor, topic or scene; None in formats with a single one
    # reads the recording's own poses; returns None if it has none
    own_track: Callable[[], Track | None] = field(default=lambda: None, repr=False)
    # reads a pose file in the dataset's own format; returns None for another format
    own_poses: Callable[[Path], Track | None] = field(default=lambda path: None, repr=False)
    # the recording's own poses of a body on which the sensor's mount is unknown
    base_track: Track | None = field(default=None, repr=False)
    # the poses of a moving body in the frame of the points, if that frame seems to be a world's
    body_in_frame: Track | None = field(default=None, repr=False)
    T_base_sensor: Pose | None = None  # (4, 4) mount of the sensor, if recorded
    gravity: GravitySource | None = None
    times_sure: bool = True  # True if the format defines the unit of point times


@dataclass(frozen=True)
class RecordedSequence:
    """A ``Sequence`` whose scans are read on access."""

    name: str  # this and the next three as in :class:`Found`
    format: str
    frame: str
    fields: str
    source: Source
    rows: Int64  # (N,) positions in the source
    indices: Int64  # (N,)
    stamps: Float64 | None  # (N,) seconds
    poses: Float64 | None  # (N, 4, 4) T_world_sensor
    track: Track | None  # from which the poses were interpolated
    motion: Motion | None  # for de-skewing points to the scan's stamp
    notes: tuple[str, ...]
    T_base_sensor: Pose | None = None  # (4, 4) mount on the robot or vehicle, if known
    gravity: GravitySource | None = None  # for scans without poses
    time_unit: TimeUnit | None = None  # of the source's point times; None: seconds after the stamp

    def __len__(self) -> int:
        return len(self.rows)

    def scan(self, i: int) -> Scan:
        """Read scan i; de-skewed if its points have times and poses are known.

        Raise DatasetError if the position does not exist or the scan cannot be read.
        """
        scan = self.raw(i)
        stamp = stamp_at(self, i)
        scan = at_stamp(scan, self.motion, stamp)
        scan.stamp = stamp
        scan.T_odom_sensor = None if self.poses is None else self.poses[i].copy()
        scan.T_base_sensor = self.T_base_sensor
        if self.gravity is not None and (gravity := self.gravity.at(int(self.rows[i]))):
            scan.gravity, scan.gravity_error_deg = gravity.direction, gravity.error_deg
        return scan

    def raw(self, i: int) -> Scan:
        """Read scan i as recorded, without a pose."""
        if not 0 <= i < len(self):
            raise DatasetError(f"{self.name}: no scan at position {i} of {len(self)}")
        scan = self.source.read(int(self.rows[i]))
        return self.time_unit.apply(scan, stamp_at(self, i)) if self.time_unit else scan

    def where(self, i: int) -> str:
        """Return the file or message of scan i."""
        return self.source.where(int(self.rows[i]))

    def select(self, selection: Selection) -> RecordedSequence:
        """Return the scans whose indices are selected, in the same order.

        Raise DatasetError if there are none.
        """
        mask = selection.mask(self.indices)
        if not mask.any():
            span = f"{self.indices.min()} to {self.indices.max()}"
            raise DatasetError(f"{self.name}: {selection} selects none of the scans {span}")
        return self.part(mask)

    def part(self, mask: np.ndarray) -> RecordedSequence:
        """Return the scans at positions of a mask (N,) bool."""
        return replace(
            self,
            rows=self.rows[mask],
            indices=self.indices[mask],
            stamps=None if self.stamps is None else self.stamps[mask],
            poses=None if self.poses is None else self.poses[mask],
        )
