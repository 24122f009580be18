"""Files of datasets: records, names and folders."""

from __future__ import annotations

import os
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...errors import DatasetError
from ...system.budget import check_points
from ...types import Float32, Float64, Int64, Scan


def rows_of(data: bytes, dtype: np.dtype[np.void] | str, width: int = 0) -> NDArray[np.generic]:
    """Return bytes as records (N,), or as rows of ``width`` values (N, width).

    Raise DatasetError if the last record is incomplete, as in a truncated file.
    """
    kind = np.dtype(dtype)
    size = kind.itemsize * (width or 1)
    if len(data) % size:
        raise DatasetError(f"cut off: {len(data)} bytes are no multiple of {size} bytes per point")
    check_points(len(data) // size)
    values = np.frombuffer(data, dtype=kind) if data else np.empty(0, dtype=kind)
    return values.reshape(-1, width) if width else values


def float_rows(data: bytes, width: int) -> Float32:
    """Return rows of little-endian float32."""
    return np.asarray(rows_of(data, "<f4", width), dtype=np.float32)


def drop_missing_returns(
    points: NDArray[np.floating], times: NDArray[np.floating] | None = None
) -> Scan:
    """Return a scan without the zeros that stand for firings without a return."""
    hit = (points[:, :3] != 0).any(axis=1)
    if hit.all():
        return Scan(points, times=times)
    return Scan(points[hit], times=None if times is None else times[hit])


def parse_float4(data: bytes) -> Scan:
    """Parse rows of float32: x, y, z, reflectance."""
    return drop_missing_returns(float_rows(data, 4))


def column_times(count: int) -> Float64 | None:
    """Return seconds after the start of an OS1-64's turn, for clouds stored column by column.

    Return None if the cloud is incomplete: columns are then unknown.
    """
    return np.repeat(np.arange(1024) / 1024 * 0.1, 64) if count == 64 * 1024 else None


def scan_files(folder: Path, suffix: str = ".bin") -> list[Path]:
    """List the files NUMBERsuffix of a folder, sorted by number.

    Raise DatasetError if there are none, or two have the same number.
    """
    try:
        names = [path for path in folder.iterdir() if path.name.endswith(suffix)]
    except OSError as error:
        raise DatasetError(f"{folder}: cannot list: {error.strerror or error}") from error
    paths = [path for path in names if path.name[0] != "." and path.stem.isdecimal()]
    if not paths:
        raise DatasetError(f"{folder}: no scans: no files NUMBER{suffix}")
    paths.sort(key=lambda path: int(path.stem))
    for first, second in pairwise(paths):
        if int(first.stem) == int(second.stem):
            raise DatasetError(f"{folder}: {first.name} and {second.name} have the same number")
    return paths


def holds_scans(folder: Path, digits: int = 1) -> bool:
    """Return whether a folder has a file NUMBER.bin of at least this many digits (15: a time).

    Folders of the same name with other files are read as plain folders.
    """
    if not folder.is_dir():
        return False
    names = (path.stem for path in folder.glob("*.bin"))
    return any(name.isdecimal() and len(name) >= digits for name in names)


def numbers(paths: list[Path]) -> Int64:
    """Return the numbers in the names of files, (N,) int64."""
    if any(len(path.stem) > 18 and int(path.stem) > np.iinfo(np.int64).max for path in paths):
        raise DatasetError(f"{paths[-1]}: the number in its name is too large")
    return np.array([int(path.stem) for path in paths], dtype=np.int64)


def in_seconds(paths: list[Path], unit: float) -> Float64:
    """Return the numbers in file names as stamps [s], (N,) float64; ``unit`` is in seconds."""
    return np.asarray(numbers(paths) * unit, dtype=np.float64)


def locations(path: Path) -> list[Path]:
    """Return where a folder is as it was given, and behind links."""
    return list(dict.fromkeys((Path(os.path.normpath(path.absolute())), path.resolve())))


def relative(path: Path, root: Path) -> str:
    """Return a file's path inside a recording, for messages and tables."""
    return str(path.relative_to(root)) if path.is_relative_to(root) else str(path)


def choose(path: Path, present: list[str], topic: str | None) -> str:
    """Return the chosen sensor, or the only one.

    Raise DatasetError if there are several and none is chosen, or the chosen one is missing.
    """
    if topic is not None and topic not in present:
        raise DatasetError(f"{path}: no {topic!r}; available: {', '.join(present) or 'none'}")
    if topic is None and len(present) > 1:
        raise DatasetError(f"{path}: several sensors, choose one: --topic {'|'.join(present)}")
    return topic or present[0]
