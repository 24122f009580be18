"""Read and write point clouds; the file name's suffix selects the format."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

from numpy.typing import ArrayLike

from ...errors import DatasetError
from ...system.budget import check_bytes
from ...system.files import write_bytes
from ...types import Float32, Float64, Scan
from . import pcd, ply, text
from .fields import MAX_HEADER_BYTES, faults_of
from .kitti_bin import format_kitti, parse_kitti, parse_nuscenes
from .las import format_laz, parse_las
from .npy import format_npy, format_npz, parse_npy, parse_npz
from .pcd import format_pcd, parse_pcd
from .ply import format_ply, parse_ply
from .text import format_csv, parse_csv, parse_txt
from .vtk import parse_vtk

_PARSERS: dict[str, Callable[[bytes], Scan]] = {
    ".pcd.bin": parse_nuscenes,
    ".bin": parse_kitti,
    ".pcd": parse_pcd,
    ".ply": parse_ply,
    ".csv": parse_csv,
    ".vtk": parse_vtk,
    ".las": parse_las,
    ".laz": parse_las,
    ".npy": parse_npy,
    ".npz": parse_npz,
    ".txt": parse_txt,
    ".xyz": parse_txt,
    ".pts": parse_txt,
    ".asc": parse_txt,
}
_FORMATTERS: dict[str, Callable[[Float32], bytes]] = {
    ".bin": format_kitti,
    ".pcd": format_pcd,
    ".ply": format_ply,
    ".csv": format_csv,
    ".npy": format_npy,
}
_TIMED_FORMATTERS: dict[str, Callable[[Float32, Float64 | None], bytes]] = {
    ".laz": format_laz,
    ".npz": format_npz,
}


_NAMERS: dict[str, Callable[[bytes], list[str]]] = {
    ".pcd": pcd.field_names,
    ".ply": ply.field_names,
    **dict.fromkeys((".csv", ".txt", ".xyz", ".pts", ".asc"), text.field_names),
}


def scan_suffix(path: Path) -> str | None:
    """Return the readable suffix of a file's name, in lower case, or None."""
    name = path.name.lower()
    return next((suffix for suffix in _PARSERS if name.endswith(suffix)), None)


def natural_key(name: str) -> tuple[list[tuple[str, int]], str]:
    """Sort numbers in names by value; the name itself breaks ties such as 1 and 01."""
    pairs = re.findall(r"(\D*)(\d*)", name, flags=re.ASCII)
    return [(text, int(digits or 0)) for text, digits in pairs], name


def scan_suffixes() -> tuple[str, ...]:
    """Return the suffixes that :func:`read_scan` supports."""
    return tuple(_PARSERS)


def read_scan(path: str | Path) -> Scan:
    """Read one point cloud.

    ============== ==================================================================
    suffix         format
    ============== ==================================================================
    .bin           KITTI: float32 x, y, z, reflectance
    .pcd.bin       nuScenes: float32 x, y, z, intensity, ring
    .pcd           PCL: ascii, binary, binary_compressed
    .ply           ascii, binary of either byte order
    .csv           named columns (libpointmatcher), or the first three
    .txt .xyz      the same between white space, commas or semicolons, with comments; the
    .pts .asc      first line may be the number of points
    .vtk           legacy, ASCII and BINARY
    .las .laz      needs the extra ``io``
    .npy .npz      (N, >= 3); array ``points`` or the only one, optional ``times``
    ============== ==================================================================

    Times come from a field named t, time, timestamp, time_offset_ns and the like
    (``point_times``), or from LAS GPS times: fractional types are in seconds, integers
    in nanoseconds. An empty file is a scan without points if the format has no header (.bin, .txt
    and similar), and an error otherwise.

    Raises
    ------
    DatasetError
        If the file is missing, of an unknown format, truncated or malformed, or has more points
        than ``SEGLOC_MAX_POINTS``.
    MissingDependency
        If the format needs a package that is not installed.
    """
    path = Path(path)
    suffix = scan_suffix(path)
    if suffix is None:
        raise DatasetError(f"{path}: unknown format; supported: {', '.join(_PARSERS)}")
    with faults_of(path):
        return _PARSERS[suffix](read_file(path))


def field_names(path: Path) -> tuple[str, ...]:
    """Return the names of the fields of a file's points, by its header.

    Empty if the format has no names, or the file cannot be read.
    """
    namer = _NAMERS.get(scan_suffix(path) or "")
    if namer is None or not path.is_file():
        return ()
    try:
        with path.open("rb") as file:
            return tuple(name for name in namer(file.read(MAX_HEADER_BYTES)) if name)
    except (DatasetError, OSError):
        return ()  # reported when the scan is read


def read_file(path: Path) -> bytes:
    """Read all bytes of a regular file.

    Raise DatasetError if it is missing, unreadable, or larger than any scan may be.
    """
    try:
        if not path.exists():
            raise DatasetError("no such file")
        if not path.is_file():  # a pipe or device might never end
            raise DatasetError("not a regular file")
        check_bytes(path.stat().st_size, "a file")
        return path.read_bytes()
    except (OSError, ValueError) as error:
        raise DatasetError(f"cannot read: {error}") from error


def write_scan(path: str | Path, points: ArrayLike, times: ArrayLike | None = None) -> None:
    """Write x, y, z to a ``.bin .pcd .ply .npy .npz .laz`` or ``.csv`` file.

    Formats except ``.laz`` (steps of 1 mm) keep every bit of float32. The file is written
    atomically.

    Parameters
    ----------
    path : path
        Its folder must exist; an existing file is replaced.
    points : (N, >=3) array of any float dtype
        Coordinates [m]. Points that are not finite are dropped.
    times : (N,) array, optional
        Time of each point [s]; only in ``.npz`` and ``.laz``.

    Raises
    ------
    DatasetError
        If the suffix is unknown or cannot store times, or coordinates are beyond the format's
        range.
    SeglocError
        If the file cannot be written.
    InvalidScan
        If the points or times have the wrong shape or dtype.
    MissingDependency
        If the format needs a package that is not installed.
    """
    path = Path(path)
    suffix = scan_suffix(path)
    known = {**_FORMATTERS, **_TIMED_FORMATTERS}
    if suffix not in known:
        raise DatasetError(f"{path}: cannot write this format; supported: {', '.join(known)}")
    if times is not None and suffix not in _TIMED_FORMATTERS:
        raise DatasetError(
            f"{path}: cannot store times; formats with times: {', '.join(_TIMED_FORMATTERS)}"
        )
    scan = Scan(points, times=times)
    try:
        if suffix in _TIMED_FORMATTERS:
            data = _TIMED_FORMATTERS[suffix](scan.points, scan.times)
        else:
            data = _FORMATTERS[suffix](scan.points)
    except DatasetError as error:
        raise DatasetError(f"{path}: {error}") from error
    write_bytes(path, data, sweep=False)
