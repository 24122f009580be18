"""Open recordings for verbs: print notes, and run odometry on request."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from ...errors import ConfigError, DatasetError
from ...frontend.local_cloud import LocalCloudConfig
from ...frontend.mounting import MountConfig
from ...frontend.tilt import frame_tilt, level_recording
from ...types import Float64, Pose, Recording
from ..datasets import NO_POSES, Sequence, open_sequence, poses_at
from ..datasets.odometry import compute_odometry, kept_odometry, odometry_path
from . import options
from .console import busy, note, progress

BODY_SCANS = 12
"""Scans in which points on the robot itself are sought."""


def open_recording(
    path: Path,
    poses: Path | None = None,
    select: str | None = None,
    *,
    topic: str | None = None,
    deskew: bool = True,
    odometry: bool = False,
    local: LocalCloudConfig | None = None,
) -> Sequence:
    """Open a recording as :func:`~segloc.tools.datasets.open_sequence` does.

    With ``odometry`` its poses are read from the odometry file beside it, which is computed if
    missing, without the points on the body of ``local``. These poses are the sensor's; others are
    the base's if its mount is set.
    """
    local = local or LocalCloudConfig()
    if odometry:
        if poses is not None:
            raise ConfigError("--odometry and --poses exclude each other")
        poses = _odometry_of(path, topic, local)
    T = None if odometry else place_of_sensor(local.mount)
    sequence = open_sequence(path, poses, select, topic=topic, deskew=deskew, T_base_sensor=T)
    for line in getattr(sequence, "notes", ()):
        note(line)
    return sequence


def open_recordings(
    paths: list[Path],
    poses: list[Path] | None,
    select: list[str] | None,
    *,
    topic: str | None,
    deskew: bool,
    odometry: bool,
    local: LocalCloudConfig,
) -> Iterator[Sequence]:
    """Open several recordings, one after another, with the values of options for each."""
    files = options.each(poses, len(paths), "--poses")
    scans = options.each(select, len(paths), "--select")
    for path, file, chosen in zip(paths, files, scans, strict=True):
        yield open_recording(
            path, file, chosen, topic=topic, deskew=deskew, odometry=odometry, local=local
        )


def true_poses(
    recording: Recording,
    path: Path,
    truth: Path | None,
    topic: str | None,
    T_base_sensor: Pose | None = None,
) -> Float64 | None:
    """Read true poses of a recording's scans, NaN where unknown; None without a file."""
    if truth is None:
        return None
    found = poses_at(recording, path, truth, topic, T_base_sensor=T_base_sensor)
    if lost := int(np.isnan(found[:, 0, 0]).sum()):
        note(f"{lost} of {len(found)} scans are not scored: no pose in {truth}")
    return found


def place_of_sensor(mount: MountConfig | None) -> Pose | None:
    """Return T_base_sensor if poses in files are those of the base."""
    return mount.T_base_sensor if mount is not None and mount.poses_of_base else None


def _odometry_of(path: Path, topic: str | None, local: LocalCloudConfig) -> Path:
    """Return the file with the recording's odometry, computed if missing."""
    file = odometry_path(path, topic)
    recording = open_sequence(path, NO_POSES, topic=topic)
    if kept_odometry(file, recording, path):
        note(f"odometry from {file}")
        return file
    with progress("Odometry") as update:
        compute_odometry(recording, file, local.without_body, update)
    note(f"odometry written to {file}")
    return file


def check_fit(recording: Recording, path: Path, config: LocalCloudConfig) -> None:
    """Reject a recording that would smear a map; note smaller faults.

    Raises
    ------
    DatasetError
        With the fault and its remedy.
    """
    from ..doctor import body_findings, require_mappable, sample_scans

    with busy("Checking scans"):
        body = body_findings(sample_scans(recording, BODY_SCANS), config)
    for finding in body:
        note(str(finding))
    with busy("Checking scans against poses"):
        fault = require_mappable(recording, config, path, "--unchecked")
    if fault is not None:
        note(str(fault))


def check_passes(recordings: list[Sequence], config: LocalCloudConfig, align: str) -> None:
    """Reject recordings whose passes over one place disagree; note smaller offsets.

    Parameters
    ----------
    align : str
        Command that joins them.

    Raises
    ------
    DatasetError
        With the offset and its remedy.
    """
    from ..doctor import revisit_findings, session_findings

    with busy("Comparing passes over the same places"):
        findings = [each for r in recordings for each in revisit_findings(r, config)]
        findings += session_findings(recordings, config)
    for finding in findings:
        if finding.wrong:
            raise DatasetError(
                f"{finding.what}: the map would show things twice there. {align} joins them; "
                "--unchecked builds the map anyway"
            )
        note(str(finding))


def levelled_poses(recording: Recording, config: LocalCloudConfig, level: bool) -> Recording:
    """Return the recording with levelled poses if requested; otherwise note a tilted frame.

    Raises
    ------
    ConfigError
        If there are no poses to level.
    DatasetError
        If levelling is requested, and the scans show too few walls.
    """
    if recording.poses is None:
        if level:
            raise ConfigError("--level needs poses: scans without poses are levelled one by one")
        return recording
    try:
        with busy("Checking whether the frame is level"):
            tilt = frame_tilt(recording, config)
    except DatasetError:
        if level:
            raise
        return recording  # an unreadable scan may not be selected later
    if level:
        if tilt is not None:
            note(f"poses turned by {tilt.tilt_deg:.1f} degrees about the first, so that z is up")
        return level_recording(recording, tilt)[0]
    if tilt is not None and tilt.is_significant:
        note(f"the poses' z axis is {tilt.tilt_deg:.1f} degrees off vertical: --level corrects it")
    return recording
