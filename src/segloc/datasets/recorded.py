"""A recording in the format of some dataset or logger, behind the interface of all recordings."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Protocol

import numpy as np

from ..errors import DatasetError
from ..io.fields import faults_of
from ..io.scans import read_file
from ..motion import Motion, at_stamp
from ..types import Float64, Int64, Pose, Scan, stamp_at
from .base import Selection
from .clocks import TimeUnit
from .gravity import GravitySource
from .tracks import Track


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
    """One file a scan.

    Attributes
    ----------
    paths : tuple of path
    parse : callable
        From the bytes of a file to a scan; raises DatasetError.
    """

    paths: tuple[Path, ...]
    parse: Callable[[bytes], Scan]

    def __len__(self) -> int:
        return len(self.paths)

    def where(self, k: int) -> str:
        return str(self.paths[k])

    def read(self, k: int) -> Scan:
        with faults_of(self.paths[k]):
            return self.parse(read_file(self.paths[k]))


@dataclass(frozen=True)
class Found:
    """What the reader of a format finds at a path, before poses are chosen.

    Attributes
    ----------
    name : str
        Of the recording.
    format : str
    source : Source
    indices : (N,) int64
        Numbers of the source's scans.
    stamps : (N,) float64 or None
        When they were taken, seconds.
    frame : str
        The frame of the points.
    fields : str
        What the format has of each point.
    notes : tuple of str
        Faults that were met, one line each.
    topic : str or None
        Of several sensors, topics or scenes; None in formats that have one.
    own_track : callable
        Reads the poses that come with the recording; None where there are none.
    own_poses : callable
        A track from a file in the dataset's own format; None for a file of another format.
    base_track : Track or None
        The poses that come with the recording where they are of a body that nothing says where the
        sensor is on.
    T_base_sensor : (4, 4) float64 or None
        How the sensor is mounted, where the recording says so.
    gravity : GravitySource or None
    times_sure : bool
        Whether the format defines the unit of points' times; otherwise it is recognised.
    """

    name: str
    format: str
    source: Source
    indices: Int64
    stamps: Float64 | None
    frame: str
    fields: str
    notes: tuple[str, ...] = ()
    topic: str | None = None
    own_track: Callable[[], Track | None] = field(default=lambda: None, repr=False)
    own_poses: Callable[[Path], Track | None] = field(default=lambda path: None, repr=False)
    base_track: Track | None = field(default=None, repr=False)
    T_base_sensor: Pose | None = None
    gravity: GravitySource | None = None
    times_sure: bool = True


@dataclass(frozen=True)
class RecordedSequence:
    """The scans of a recording; a ``Sequence``. Scans are read when they are asked for.

    Attributes
    ----------
    name, format, frame, fields : str
        Of the recording, as in :class:`Found`.
    source : Source
    rows : (N,) int64
        Positions in the source.
    indices : (N,) int64
    stamps : (N,) float64 or None
        Seconds.
    poses : (N, 4, 4) float64 or None
        T_world_sensor.
    track : Track or None
        What the poses were interpolated from.
    motion : Motion or None
        What points with times are corrected by, to where they would be at the scan's stamp.
    notes : tuple of str
    T_base_sensor : (4, 4) float64 or None
        How the sensor is mounted on its robot or vehicle, where that is known.
    gravity : GravitySource or None
        Of scans without poses.
    time_unit : TimeUnit or None
        Of the points' times as the source has them; None for seconds after the stamp.
    """

    name: str
    format: str
    frame: str
    fields: str
    source: Source
    rows: Int64
    indices: Int64
    stamps: Float64 | None
    poses: Float64 | None
    track: Track | None
    motion: Motion | None
    notes: tuple[str, ...]
    T_base_sensor: Pose | None = None
    gravity: GravitySource | None = None
    time_unit: TimeUnit | None = None

    def __len__(self) -> int:
        return len(self.rows)

    def scan(self, i: int) -> Scan:
        """Read the scan at position i, de-skewed where points have times and poses are known.

        Raises
        ------
        DatasetError
            If there is no such position or the scan cannot be read.
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

        Raises
        ------
        DatasetError
            If there are none.
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
