"""Recordings: sequences of scans with or without poses."""

from __future__ import annotations

from pathlib import Path

from ..errors import DatasetError
from .base import Recording as Recording
from .base import Selection as Selection
from .base import Sequence as Sequence
from .base import parse_select as parse_select
from .folder import FolderSequence as FolderSequence
from .swathes import Swathes as Swathes
from .swathes import swathes as swathes


def open_sequence(
    path: str | Path,
    poses: str | Path | None = None,
    select: str | Selection | None = None,
) -> Sequence:
    """Open a recording as the command line names it.

    Parameters
    ----------
    path : path
        A folder of scans.
    poses : path, optional
        A TUM or KITTI file. Where it does not exist as given, it is looked for inside the
        sequence's folder, then beside that folder.
    select : str or Selection, optional
        Which indices to keep, as :func:`parse_select` reads them.

    Raises
    ------
    DatasetError
        If there are no scans, the poses are not found or do not cover the selected scans, or
        nothing is selected.
    ConfigError
        If the selection cannot be parsed.
    """
    folder = Path(path)
    selection = parse_select(select) if isinstance(select, str) else select
    found = None if poses is None else _find_poses(Path(poses), folder)
    sequence = FolderSequence(folder, found)
    if selection is not None:
        sequence = sequence.select(selection)
    _ = sequence.poses  # raises where they do not cover the scans
    return sequence


def _find_poses(poses: Path, folder: Path) -> Path:
    for candidate in (poses, folder / poses, folder.resolve().parent / poses):
        if candidate.is_file():
            return candidate
    raise DatasetError(f"{poses}: no such file, neither in {folder} nor beside it")
