"""From what the reader of a format finds to a sequence with the poses that were asked for."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from ..errors import DatasetError, SeglocError
from ..motion import Motion
from ..types import Float64, Pose
from .base import Selection
from .clocks import TimeUnit, period_of, time_unit
from .recorded import Found, RecordedSequence
from .tracks import Track, read_track


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

    Parameters
    ----------
    found : Found
    poses : path, optional
        A file to take the poses from.
    own_poses : bool
        Whether to take the recording's own where no file is given.
    deskewed : bool
    T_base_sensor : (4, 4) float64, optional
        Where the sensor is on the body that the poses are of, if they are not the sensor's.
    selection : Selection, optional
        Indices of the scans to keep.

    Raises
    ------
    DatasetError
        If there are no scans, none is selected, the poses cannot be read, or no scan has one.
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
