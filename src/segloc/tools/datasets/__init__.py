"""Recordings: sequences of scans with or without poses."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ...errors import DatasetError
from ...types import Float64, Pose
from ...types import Recording as Recording
from .loaders import folder
from .recorded import Found, assemble
from .recorded import RecordedSequence as RecordedSequence
from .recorded import Selection as Selection
from .recorded import Sequence as Sequence
from .recorded import parse_select as parse_select

NO_POSES = "none"
"""Value of ``poses`` that ignores a recording's own poses."""


def open_sequence(
    path: str | Path,
    poses: str | Path | None = None,
    select: str | Selection | None = None,
    *,
    topic: str | None = None,
    deskew: bool = True,
    T_base_sensor: Pose | None = None,
) -> RecordedSequence:
    """Open a recording of any known format.

    Scans are read on access, except up to three to recognise the unit of point times. Scans
    without a pose are left out and noted.

    Parameters
    ----------
    path : path
        A dataset's sequence, a bag, or a folder of scans.
    poses : path, optional
        File in TUM, KITTI or the dataset's own format: as given, else inside the sequence's
        folder, else beside it. By default the recording's own poses; "none" ignores them.
    select : str or Selection, optional
        Indices to keep, as :func:`parse_select` reads them.
    topic : str, optional
        Sensor, topic or scene, if there are several.
    deskew : bool
        True to de-skew points with times to the stamp of their scan.
    T_base_sensor : (4, 4) float64, optional
        Mount of the sensor on the body of ``poses``, or of a bag's odometry that tf does not
        connect with the sensor. Other poses of a recording are the sensor's.

    Raises
    ------
    DatasetError
        If there are no scans, the poses are not found or cover none of the selected scans, there
        are several sensors and no ``topic``, or nothing is selected.
    ConfigError
        If the selection cannot be parsed.
    MissingDependency
        If the format needs a package that is not installed.
    """
    where = Path(path)
    try:
        selection = parse_select(select) if isinstance(select, str) else select
        own_poses = str(poses) != NO_POSES
        file = _find_poses(Path(poses), where) if poses is not None and own_poses else None
        found = _find(where, file, topic)
        return assemble(found, file, selection, own_poses, deskew, T_base_sensor)
    except DatasetError as error:
        text = str(error)
        if any(str(file) in text for file in (where, poses) if file is not None):
            raise
        raise DatasetError(f"{where}: {text}") from error
    except MemoryError as error:
        raise DatasetError(f"{where}: not enough memory to open it") from error
    except OSError as error:
        reason = error.strerror or str(error)
        raise DatasetError(f"{error.filename or where}: cannot read: {reason}") from error


def _find(where: Path, poses: Path | None, topic: str | None) -> Found:
    from .formats import identify

    known = identify(where)
    if known is None:
        found = folder.find(where, poses)
    else:
        layout, root, sensor = known
        found = layout.find(root, topic or sensor)
    if topic is not None and found.topic is None:
        raise DatasetError(f"{where}: {found.format} has no topics, so no {topic!r}")
    return found


def poses_at(
    recording: Recording,
    path: str | Path,
    poses: str | Path,
    topic: str | None = None,
    *,
    T_base_sensor: Pose | None = None,
) -> Float64:
    """Return reference poses of a recording's scans, to score against.

    Parameters
    ----------
    recording : Recording
        Opened from ``path``; may be a selection.
    path, poses, topic, T_base_sensor
        As for :func:`open_sequence`.

    Returns
    -------
    (N, 4, 4) float64
        NaN for scans without a pose.

    Raises
    ------
    DatasetError
        If no scan has one.
    """
    same = Selection(tuple((int(i), int(i)) for i in recording.indices))
    known = open_sequence(path, poses, same, topic=topic, T_base_sensor=T_base_sensor)
    if known.poses is None:
        raise DatasetError(f"{poses}: no pose for any scan")
    found = np.full((len(recording), 4, 4), np.nan)
    rows = {int(index): pose for index, pose in zip(known.indices, known.poses, strict=True)}
    for k, index in enumerate(recording.indices):
        if int(index) in rows:
            found[k] = rows[int(index)]
    return found


def _find_poses(poses: Path, folder: Path) -> Path:
    for candidate in (poses, folder / poses, folder.resolve().parent / poses):
        if candidate.is_file():
            return candidate
    raise DatasetError(f"{poses}: no such file, neither in {folder} nor beside it")
