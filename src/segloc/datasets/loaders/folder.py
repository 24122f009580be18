"""A folder of scans, one file each, with poses in a file beside them."""

from __future__ import annotations

import re
from copy import copy
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...errors import DatasetError
from ...io.scans import read_scan, scan_suffix
from ...io.trajectory import read_trajectory_and_kind
from ...motion import Motion
from ...types import Float64, Int64, Pose, Scan
from ..base import Selection
from ..recorded import corrected

_TEXT_SUFFIXES = frozenset({".csv", ".txt"})  # that poses and lists come in, too
_LISTED = 5
_DIGITS = re.compile(r"\d+", re.ASCII)


@dataclass(frozen=True)
class _Item:
    path: Path
    index: int
    pose: Pose | None
    stamp: float | None


class FolderSequence:
    """The scans of a folder, sorted by name (numbers in names by value: 2 before 10).

    Every file with a suffix that :func:`~segloc.io.read_scan` knows is a scan, except hidden files
    and the poses; .csv and .txt files are scans only where there are none of other formats.

    Parameters
    ----------
    folder : path
        Or the file of one scan.
    poses : path, optional
        A TUM file whose stamps are the scans' indices, or seconds: one with stamps that are no
        whole numbers, and as many rows as there are scans, is taken in the order of the scans. Or
        a KITTI file whose row i is the pose of index i; one with fewer rows than the largest index
        is taken in the order of the scans, too.
    deskew : bool
        Whether points with times are moved, along the poses, to where they would be at the start
        of the scan. Needs poses in seconds.
    T_base_sensor : (4, 4) float64, optional
        Where the sensor is on the body that the poses are of, if they are not the sensor's.

    Attributes
    ----------
    format, frame, fields : str
        For tables, as other recordings have them.
    indices : (N,) int64
        The last number in each file's name; where there is none, the file's position.

    Raises
    ------
    DatasetError
        If the folder is missing or has no scans, two scans have the same number, or the poses
        cannot be read. Poses that do not cover all scans raise once ``poses`` or a scan is asked
        for, so that a selection can leave out what is not covered.
    """

    format = "folder of scans"
    frame = "as recorded"
    fields = ""
    notes: tuple[str, ...] = ()

    def __init__(
        self,
        folder: str | Path,
        poses: str | Path | None = None,
        *,
        deskew: bool = False,
        T_base_sensor: Pose | None = None,
    ) -> None:
        folder = Path(folder)
        self.name = folder.resolve().name
        self._poses_path = None if poses is None else Path(poses)
        paths = _scan_paths(folder, self._poses_path)
        indices = _indices(paths, folder)
        found, stamps = _find_poses(self._poses_path, indices)
        if T_base_sensor is not None:
            found = [None if pose is None else pose @ T_base_sensor for pose in found]
        self._T_base_sensor = T_base_sensor
        self._items = [_Item(*item) for item in zip(paths, indices, found, stamps, strict=True)]
        track = self.poses if deskew and len(paths) > 1 and stamps[0] is not None else None
        self._motion = None if track is None else Motion(np.array(stamps, np.float64), track)

    def __len__(self) -> int:
        return len(self._items)

    @property
    def indices(self) -> Int64:
        """The scans' numbers, (N,) int64."""
        return np.array([item.index for item in self._items], dtype=np.int64)

    @property
    def poses(self) -> Float64 | None:
        """T_odom_sensor of each scan, (N, 4, 4) float64, or None where no poses were given.

        Raises
        ------
        DatasetError
            If some scan has none: names the first such scan and how many there are.
        """
        if self._poses_path is None:
            return None
        return np.array([self._pose(item) for item in self._items])

    @property
    def stamps(self) -> Float64 | None:
        """When the scans start, (N,) float64 seconds, or None where the poses do not say."""
        stamps = [item.stamp for item in self._items]
        return None if None in stamps else np.array(stamps, dtype=np.float64)

    @property
    def track(self) -> str | None:
        """The file that the poses come from."""
        return None if self._poses_path is None else str(self._poses_path)

    def raw(self, i: int) -> Scan:
        """The scan at position i as it was recorded, without pose."""
        if not 0 <= i < len(self):
            raise DatasetError(f"{self.name}: no scan at position {i} of {len(self)}")
        return read_scan(self._items[i].path)

    def where(self, i: int) -> str:
        """The file of the scan at position i."""
        return str(self._items[i].path)

    def scan(self, i: int) -> Scan:
        """Read the scan at position i, de-skewed where that is possible.

        Raises
        ------
        DatasetError
            If there is no such position, the file cannot be read, or its pose is missing.
        """
        scan = self.raw(i)
        item = self._items[i]
        pose = None if self._poses_path is None else self._pose(item)
        scan = corrected(scan, self._motion, item.stamp)
        scan.stamp = item.stamp
        scan.T_odom_sensor = None if pose is None else pose.copy()
        scan.T_base_sensor = self._T_base_sensor
        return scan

    def _pose(self, item: _Item) -> Pose:
        if item.pose is None:
            missing = sum(each.pose is None for each in self._items)
            raise DatasetError(
                f"{self._poses_path}: no pose for {item.path.name}; "
                f"{missing} of {len(self)} scans have none"
            )
        return item.pose

    def select(self, selection: Selection) -> FolderSequence:
        """The scans whose indices are in the selection, in the same order.

        Raises
        ------
        DatasetError
            If there are none.
        """
        chosen = selection.mask(self.indices)
        if not chosen.any():
            span = f"{self.indices.min()} to {self.indices.max()}"
            raise DatasetError(f"{self.name}: {selection} selects none of the scans {span}")
        part = copy(self)
        part._items = [self._items[i] for i in np.flatnonzero(chosen)]
        return part


def _scan_paths(folder: Path, poses: Path | None) -> list[Path]:
    if folder.is_file() and scan_suffix(folder):
        return [folder]
    if not folder.is_dir():
        fault = "no recording in a known format" if folder.exists() else "no such folder or file"
        raise DatasetError(f"{folder}: {fault}")
    try:
        files = [path for path in folder.iterdir() if path.is_file()]
    except OSError as error:
        raise DatasetError(f"{folder}: cannot list: {error.strerror or error}") from error
    scans = [
        path
        for path in files
        if scan_suffix(path) and path.name[0] != "." and not (poses and _same(path, poses))
    ]
    others = [path for path in scans if scan_suffix(path) not in _TEXT_SUFFIXES]
    if not scans:
        raise DatasetError(
            f"{folder}: no scans in a known format among its {len(files)} files{_below(folder)}"
        )
    return sorted(others or scans, key=_natural_key)


def _below(folder: Path) -> str:
    """Which folders in it may be meant."""
    names = sorted(
        path.name
        for path in folder.iterdir()
        if path.is_dir() and any(scan_suffix(file) for file in path.iterdir())
    )
    listed = ", ".join(names[:_LISTED]) + (", ..." if len(names) > _LISTED else "")
    return f"; there are some in {listed}" if names else ""


def _same(path: Path, other: Path) -> bool:
    return other.exists() and path.samefile(other)


def _natural_key(path: Path) -> tuple[list[tuple[str, int]], str]:
    """Compares the numbers in names by value; the name itself decides between 1 and 01."""
    pairs = re.findall(r"(\D*)(\d*)", path.name, flags=re.ASCII)
    return [(text, int(digits or 0)) for text, digits in pairs], path.name


def _indices(paths: list[Path], folder: Path) -> list[int]:
    seen: dict[int, Path] = {}
    for position, path in enumerate(paths):
        numbers = _DIGITS.findall(path.name[: -len(scan_suffix(path) or "")])
        index = int(numbers[-1]) if numbers else position
        if index > np.iinfo(np.int64).max:
            raise DatasetError(f"{path}: the number in its name is too large")
        if index in seen:
            raise DatasetError(
                f"{folder}: {seen[index].name} and {path.name} are both scan {index}"
            )
        seen[index] = path
    return list(seen)


def _find_poses(
    path: Path | None, indices: list[int]
) -> tuple[list[Pose | None], list[float | None]]:
    """The scans' poses, and their stamps where the poses have seconds."""
    nothing: list[None] = [None] * len(indices)
    if path is None:
        return [*nothing], [*nothing]
    trajectory, kind = read_trajectory_and_kind(path)
    if kind == "tum" and len(trajectory) == len(indices) and (trajectory.stamps % 1).any():
        return list(np.array(trajectory.poses)), trajectory.stamps.tolist()
    by_position = kind == "kitti" and len(trajectory) <= max(indices)
    keys = range(len(indices)) if by_position else indices
    return [trajectory.at(key) for key in keys], [*nothing]
