"""Finished clouds of any size, read part by part in float64: files, and folders of tiles."""

from __future__ import annotations

import mmap
import re
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...errors import DatasetError, InvalidScan, requires
from ...geometry import transform
from ...system.checks import checked_pose
from ...system.files import CLOUD_SUFFIXES
from ...system.files import is_cloud as is_cloud
from ...types import Float64
from . import npy, pcd, ply, vtk
from .fields import MAX_HEADER_BYTES, PointLayout, brief, column, faults_of, require_points
from .las import las_parts, point_count
from .scans import natural_key, read_file, read_scan, scan_suffix
from .text import COMMENTS, table_parts, text_parts

PART = 1_000_000
"""Points that are read at a time."""
GLIM = "points_compact.bin"
"""The points of a submap in a dump of GLIM."""
POSE_OF_GLIM = "data.txt"
"""The file beside it with its pose."""
WHOLE = (".e57", ".npy", ".npz", ".vtk")
"""Of files that are read whole, 24 bytes a point."""
_TEXT = (".xyz", ".txt", ".pts", ".asc", ".csv")

Paths = str | Path | Sequence[str | Path]
Progress = Callable[[int, int], None]


def cloud_files(paths: Paths) -> list[Path]:
    """List the files of a cloud: those given, and those in folders and their subfolders.

    Files of a folder are sorted by name, numbers in names by value.

    Raises
    ------
    DatasetError
        If a file is missing or not a cloud by its name, or a folder has none.
    """
    given = [paths] if isinstance(paths, str | Path) else paths
    return list(dict.fromkeys(file for path in given for file in _files(Path(path))))


def cloud_sources(paths: Paths) -> list[Path]:
    """List the files that a cloud is read from: :func:`cloud_files`, and poses of submaps.

    Raises
    ------
    DatasetError
        As :func:`cloud_files`.
    """
    return [
        source
        for file in cloud_files(paths)
        for source in ((file, file.parent / POSE_OF_GLIM) if file.name == GLIM else (file,))
    ]


def _files(where: Path) -> list[Path]:
    if not where.is_dir():
        if not where.is_file():
            raise DatasetError(f"{where}: no such file")
        if not is_cloud(where) and scan_suffix(where) is None:
            names = ", ".join(CLOUD_SUFFIXES)
            raise DatasetError(f"{where}: not a point cloud by its name: {names}")
        return [where]
    # A folder may be called map.pcd, as Autoware's is.
    found = list(where.rglob(GLIM))
    found = found or [file for file in where.rglob("*") if file.is_file() and _is_tile(file)]
    if not found:
        raise DatasetError(f"{where}: no point cloud in this folder")
    return sorted(found, key=lambda file: [natural_key(part) for part in file.parts])


def _is_tile(file: Path) -> bool:
    return is_cloud(file) and not file.name.startswith(".")  # "._a.pcd" of a Mac is none


def count_points(path: Path) -> int:
    """Return the number of points of a file of :func:`cloud_files`, without reading them.

    By the header; that of text by the length of its first lines, and that of other files at most.

    Raises
    ------
    DatasetError
        If the header is malformed; names the file.
    MissingDependency
        If E57 files need a package that is not installed.
    """
    suffix, size = path.suffix.lower(), path.stat().st_size
    with faults_of(path):
        if suffix in (".las", ".laz"):
            return point_count(path)
        if suffix == ".e57":
            text = _of_e57("raw_xml", path)
            return sum(map(int, re.findall(r'<points\b[^>]*\brecordCount="(\d+)"', text)))
        with path.open("rb") as stream:
            head = stream.read(MAX_HEADER_BYTES)
        if suffix in (".pcd", ".ply"):
            return (pcd.point_count if suffix == ".pcd" else ply.point_count)(head)
        if suffix in _TEXT:
            return size * head.count(b"\n") // max(len(head), 1)
    return size // _FLOAT32_BYTES


def read_cloud(
    paths: Paths, progress: Progress | None = None, poses: Float64 | None = None
) -> Iterator[Float64]:
    """Read a cloud of one or more files in parts of about a million points.

    Files share a frame, except submaps of GLIM, whose poses lie beside them.
    PCD, PLY, LAS and XYZ files are read part by part, E57 and compressed PCD files whole.

    Parameters
    ----------
    paths : path, or sequence of paths
        Files and folders.
    progress : callable, optional
        Called with (files read, files in all).
    poses : (F, 4, 4) float64, optional
        Pose of each file in the common frame, in the order of :func:`cloud_files`.

    Yields
    ------
    (N, 3) float64

    Raises
    ------
    DatasetError
        If a file is missing, cut off or malformed (names it), or has no pose.
    MissingDependency
        If the format needs a package that is not installed.
    """
    files = cloud_files(paths)
    if poses is not None and len(poses) != len(files):
        raise DatasetError(f"{len(poses)} poses for {len(files)} files: each file needs one")
    for done, file in enumerate(files):
        with faults_of(file):
            T = _submap_pose(file) if poses is None else poses[done]
            for part in _parts(file):
                yield part if T is None else transform(T, part)
        if progress:
            progress(done + 1, len(files))


def _submap_pose(path: Path) -> Float64 | None:
    """Return the pose of a submap in the common frame; None if it lies in that frame."""
    if path.name != GLIM:
        return None
    words = read_file(path.parent / POSE_OF_GLIM).decode("utf-8", "replace").split()
    try:
        first = words.index("T_world_origin:") + 1
        return checked_pose(np.array(words[first : first + 16], float).reshape(4, 4), "pose")
    except (ValueError, InvalidScan) as error:
        raise DatasetError(f"no T_world_origin in data.txt beside it: {error}") from error


def _parts(path: Path) -> Iterator[Float64]:
    suffix = path.suffix.lower()
    if path.name == GLIM:
        return iter([_glim_points(path)])
    if suffix == ".e57":
        return _e57(path)
    if suffix in (".las", ".laz"):
        return las_parts(path, PART)
    if suffix == ".npy":
        return iter([_float64(npy.as_points(npy.parse_array(read_file(path)))[:, :3])])
    if suffix in (".pcd", ".ply", *_TEXT) and path.stat().st_size:
        return _map_rows(path, suffix)
    if suffix in _COORDINATES:
        return iter([_coordinates(read_file(path), suffix)])
    return iter([read_scan(path).points.astype(np.float64)])  # of float32, or empty


_COORDINATES: dict[str, Callable[[bytes], list[NDArray[Any]]]] = {
    ".pcd": pcd.parse_coordinates,
    ".ply": ply.parse_coordinates,
    ".vtk": vtk.parse_coordinates,
    ".npz": npy.parse_coordinates,
}
"""Of files that are read whole."""


def _coordinates(data: bytes, suffix: str) -> Float64:
    """Return the points of a file with all digits that it has, (N, 3)."""
    return _float64(np.column_stack(_COORDINATES[suffix](data)))


_FLOAT32_BYTES = 12  # of a point of GLIM, and the least of others


def _glim_points(path: Path) -> Float64:
    """Return the points of a submap of GLIM, in its own frame."""
    size = path.stat().st_size
    if size % _FLOAT32_BYTES:
        raise DatasetError(
            f"{size} bytes are no multiple of {_FLOAT32_BYTES} bytes per point: the file is cut "
            "off, copy it again"
        )
    return np.fromfile(path, "<f4").reshape(-1, 3).astype(np.float64)


def _float64(points: NDArray[Any]) -> Float64:
    with np.errstate(invalid="ignore"):  # damaged bytes may be signalling NaN
        return np.asarray(points, dtype=np.float64)


def _map_rows(path: Path, suffix: str) -> Iterator[Float64]:
    """A text file, or a PCD or PLY file whose points have all one size."""
    with path.open("rb") as stream, mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as data:
        if suffix in _TEXT:
            for table in text_parts(data, () if suffix == ".csv" else COMMENTS):
                yield table[:, :3]
            return
        head = data[: 1 << 20]
        layout = (pcd.point_layout if suffix == ".pcd" else ply.point_layout)(head)
        if layout is None:
            yield _coordinates(data[:], suffix)
        elif layout.text:
            yield from table_parts(data, layout.start, layout.columns, layout.count, layout.stride)
        else:
            yield from _records(data, layout)


def _records(data: mmap.mmap, layout: PointLayout) -> Iterator[Float64]:
    """The coordinates of binary points."""
    require_points(layout.count, max(len(data) - layout.start, 0) // layout.stride)
    for first in range(0, layout.count, PART):
        count = min(PART, layout.count - first)
        at = layout.start + first * layout.stride
        part = data[at : at + count * layout.stride]
        axes = [
            column(part, dtype, count, place, layout.stride)
            for dtype, place in zip(layout.dtypes, layout.columns, strict=True)
        ]
        yield _float64(np.column_stack(axes))


def _e57(path: Path) -> Iterator[Float64]:
    """All scans of an E57 file, each at its pose in the file's frame."""
    points = np.asarray(_of_e57("read_points", path).points, dtype=np.float64)
    for first in range(0, len(points), PART):
        yield points[first : first + PART]


def _of_e57(function: str, path: Path) -> Any:
    """Return what a function of the package e57 reads of a file."""
    with requires("e57", "e57", "reading .e57 files"):
        import e57
    try:
        return getattr(e57, function)(str(path))
    except BaseException as error:  # of Rust, some no Exception
        if isinstance(error, (MemoryError, KeyboardInterrupt)):
            raise
        raise DatasetError(f"cannot read the E57 file: {brief(error)}") from error
