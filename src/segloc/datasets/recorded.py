"""A recording in the format of some dataset or logger, behind the interface of all recordings."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ..errors import ConfigError, DatasetError, SeglocError
from ..io.fields import faults_of
from ..io.scans import read_file, read_scan
from ..motion import Motion, at_stamp
from ..types import Float64, Int64, Pose, Recording, Scan, stamp_at
from .clocks import TimeUnit, period_of, time_unit
from .gravity import GravitySource
from .tracks import Track, read_track

_RANGE = re.compile(r"(\d{0,18})(:?)(\d{0,18})", re.ASCII)


class Sequence(Recording, Protocol):
    """A recording that parts can be taken of."""

    def select(self, selection: Selection) -> Sequence:
        """The scans whose indices are in the selection, in the same order."""
        ...


@dataclass(frozen=True)
class Selection:
    """Ranges of indices, both ends included; None is an open end."""

    ranges: tuple[tuple[int, int | None], ...]

    def mask(self, indices: Int64) -> NDArray[np.bool_]:
        """Which of the indices are selected, (N,) bool."""
        chosen = np.zeros(len(indices), dtype=bool)
        for first, last in self.ranges:
            chosen |= (indices >= first) & (True if last is None else indices <= last)
        return chosen

    def __str__(self) -> str:
        return ",".join(f"{a}:{'' if b is None else b}" for a, b in self.ranges)


def parse_select(text: str) -> Selection:
    """A selection like ``100:947,1001:1100``: inclusive ranges, open ends, single numbers.

    Raises
    ------
    ConfigError
        If a part is not ``7``, ``100:947``, ``100:`` or ``:50``, or ends before it starts.
    """
    return Selection(tuple(_parse_range(part.strip(), text) for part in text.split(",")))


def _parse_range(part: str, text: str) -> tuple[int, int | None]:
    found = _RANGE.fullmatch(part)
    if found is None or not (found[1] or found[3]):
        raise ConfigError(f"selection {text[:80]!r}: {part[:40]!r} is no number and no range")
    first = int(found[1] or 0)
    last = first if not found[2] else int(found[3]) if found[3] else None
    if last is not None and last < first:
        raise ConfigError(f"selection {text[:80]!r}: {part} ends before it starts")
    return first, last


def assembled(
    found: Found,
    poses: Path | None,
    *,
    own_poses: bool = True,
    deskewed: bool = True,
    T_base_sensor: Pose | None = None,
    selection: Selection | None = None,
) -> RecordedSequence:
    """A sequence of the scans that a reader found, with the poses that were asked for.

    Scans that lie outside the poses in time, or in a gap of theirs, are left out and noted.

    poses: a file to take the poses from
    own_poses: whether to take the recording's own where no file is given
    T_base_sensor: (4, 4) where the sensor is on the body that the poses are of, if they are not the
      sensor's
    selection: indices of the scans to keep

    Raise DatasetError if there are no scans, none is selected, the poses cannot be read, or no scan
    has one.
    """
    if not len(found.source):
        raise DatasetError(f"{found.name}: {found.format} without any scan")
    track, at_scans, stamps, said = _posed(found, poses, own_poses, T_base_sensor)
    notes, motion = [*found.notes, *said], None
    if track is not None and deskewed and track.clock == "seconds" and len(track.keys) > 1:
        motion = Motion(track.keys, track.poses)
    unit = _time_unit(found, stamps)
    notes += [unit.note] if unit is not None and unit.note else []
    sequence = RecordedSequence(
        found.name, found.format, found.frame, found.fields, found.source,
        np.arange(len(found.source)), found.indices, stamps, at_scans, track, motion,
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
    lost = f"{int((~known).sum())} of {len(known)} scans left out: no pose in {track.source}"
    if not known.any():
        raise DatasetError(lost)
    used = f"the other {int(known.sum())} are used (--select A:B,C:D uses fewer)"
    return replace(sequence.part(known), notes=(*notes, f"{lost}; {used}"))


def _posed(
    found: Found, poses: Path | None, own_poses: bool, T_base_sensor: Pose | None
) -> tuple[Track | None, Float64 | None, Float64 | None, list[str]]:
    """The sensor's track, its poses at the scans, the scans' stamps, and notes."""
    stamps = found.stamps
    if poses is not None:
        track = _of_file(found, poses, T_base_sensor)
        notes = [track.note] * bool(track.note)
        if stamps is None and track.clock == "seconds" and len(track.keys) == len(found.indices):
            stamps = track.keys
            notes.append(f"{track.source}: poses by time, scans without: paired in their order")
        at_scans = track.at(found.indices, stamps)
        return track, at_scans, stamps, notes
    if not own_poses:
        return None, None, stamps, []
    try:
        own = _own(found, T_base_sensor)
        if own is None:
            return None, None, stamps, []
        return own, own.at(found.indices, stamps), stamps, [own.note] * bool(own.note)
    except DatasetError as error:  # the scans are readable without
        return None, None, stamps, [f"{error}: poses not used"]


def _time_unit(found: Found, stamps: Float64 | None) -> TimeUnit | None:
    """The unit of points' times, by some scans; None if the format defines it."""
    if found.times_sure or stamps is None:
        return None
    count = len(found.source)
    samples = []
    for k in sorted({0, count // 2, count - 1}):
        try:
            times = found.source.read(k).times
        except SeglocError:
            continue  # told where the scan is needed
        if times is not None:
            samples.append((times, float(stamps[k])))
    return time_unit(samples, period_of(stamps))


def _of_file(found: Found, poses: Path, T_base_sensor: Pose | None) -> Track:
    """The sensor's track in a file."""
    if (track := found.own_poses(poses)) is not None:
        return track
    track = read_track(poses, found.indices, found.stamps)
    return track if T_base_sensor is None else track.moved(T_base_sensor)


def _own(found: Found, T_base_sensor: Pose | None) -> Track | None:
    """The sensor's track that comes with the recording, if there is one."""
    track = found.own_track()
    if track is None and found.base_track is not None and T_base_sensor is not None:
        return found.base_track.moved(T_base_sensor)
    return track


class Source(Protocol):
    """Where scans are read from; can be pickled."""

    def __len__(self) -> int: ...

    def read(self, k: int) -> Scan:
        """The scan at position k; times, if any, in seconds after the scan's stamp."""
        ...

    def where(self, k: int) -> str:
        """What the scan at position k is called in messages: its file or message."""
        ...


@dataclass(frozen=True)
class FileSource:
    """One file a scan."""

    paths: tuple[Path, ...]
    parse: Callable[[bytes], Scan] | None = None  # of a file's bytes; None: by its suffix

    def __len__(self) -> int:
        return len(self.paths)

    def where(self, k: int) -> str:
        return str(self.paths[k])

    def read(self, k: int) -> Scan:
        if self.parse is None:
            return read_scan(self.paths[k])
        with faults_of(self.paths[k]):
            return self.parse(read_file(self.paths[k]))


@dataclass(frozen=True)
class Found:
    """What the reader of a format finds at a path, before poses are chosen."""

    name: str  # of the recording
    format: str
    source: Source
    indices: Int64  # (N,) numbers of the source's scans
    stamps: Float64 | None  # (N,) when they were taken, seconds
    frame: str  # the frame of the points
    fields: str  # what the format has of each point
    notes: tuple[str, ...] = ()  # faults that were met, one line each
    topic: str | None = None  # of several sensors, topics or scenes; None in formats that have one
    # reads the poses that come with the recording; None where there are none
    own_track: Callable[[], Track | None] = field(default=lambda: None, repr=False)
    # a track from a file in the dataset's own format; None for a file of another format
    own_poses: Callable[[Path], Track | None] = field(default=lambda path: None, repr=False)
    # the poses that come with the recording where they are of a body that nothing says
    # where the sensor is on
    base_track: Track | None = field(default=None, repr=False)
    # (4, 4) how the sensor is mounted, where the recording says so
    T_base_sensor: Pose | None = None
    gravity: GravitySource | None = None
    # whether the format defines the unit of points' times; otherwise it is recognised
    times_sure: bool = True


@dataclass(frozen=True)
class RecordedSequence:
    """The scans of a recording; a ``Sequence``. Scans are read when they are asked for."""

    name: str  # this and the next: as in :class:`Found`
    format: str
    frame: str
    fields: str
    source: Source
    rows: Int64  # (N,) positions in the source
    indices: Int64  # (N,)
    stamps: Float64 | None  # (N,) seconds
    poses: Float64 | None  # (N, 4, 4) T_world_sensor
    track: Track | None  # what the poses were interpolated from
    # what points with times are corrected by, to where they would be at the scan's stamp
    motion: Motion | None
    notes: tuple[str, ...]
    # (4, 4) how the sensor is mounted on its robot or vehicle, where that is known
    T_base_sensor: Pose | None = None
    gravity: GravitySource | None = None  # of scans without poses
    # of the points' times as the source has them; None for seconds after the stamp
    time_unit: TimeUnit | None = None

    def __len__(self) -> int:
        return len(self.rows)

    def scan(self, i: int) -> Scan:
        """Read the scan at position i, de-skewed where points have times and poses are known.

        Raise DatasetError if there is no such position or the scan cannot be read.
        """
        scan = self.raw(i)
        stamp = stamp_at(self, i)
        scan = at_stamp(scan, self.motion, stamp)
        scan.stamp = stamp
        scan.T_odom_sensor = None if self.poses is None else self.poses[i].copy()
        scan.T_base_sensor = self.T_base_sensor
        if self.gravity is not None and (felt := self.gravity.at(int(self.rows[i]))):
            scan.gravity, scan.gravity_error_deg = felt.direction, felt.error_deg
        return scan

    def raw(self, i: int) -> Scan:
        """The scan at position i as it was recorded, without pose."""
        if not 0 <= i < len(self):
            raise DatasetError(f"{self.name}: no scan at position {i} of {len(self)}")
        scan = self.source.read(int(self.rows[i]))
        return self.time_unit.applied(scan, stamp_at(self, i)) if self.time_unit else scan

    def where(self, i: int) -> str:
        """The file or message of the scan at position i."""
        return self.source.where(int(self.rows[i]))

    def select(self, selection: Selection) -> RecordedSequence:
        """The scans whose indices are in the selection, in the same order.

        Raise DatasetError if there are none.
        """
        mask = selection.mask(self.indices)
        if not mask.any():
            span = f"{self.indices.min()} to {self.indices.max()}"
            raise DatasetError(f"{self.name}: {selection} selects none of the scans {span}")
        return self.part(mask)

    def part(self, mask: np.ndarray) -> RecordedSequence:
        """The scans at some positions, (N,) bool."""
        return replace(
            self,
            rows=self.rows[mask],
            indices=self.indices[mask],
            stamps=None if self.stamps is None else self.stamps[mask],
            poses=None if self.poses is None else self.poses[mask],
        )
