"""KITTI raw: a drive's folder with ``velodyne_points`` and ``oxts``, calibration beside it.

Format: the raw development kit's readme.txt and dataformat.txt, cvlibs.net/datasets/kitti/
raw_data.php; A. Geiger et al., "Vision meets robotics: The KITTI dataset", IJRR 2013.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from .... import geometry
from ....errors import DatasetError
from ....types import Float64
from ...io.scans import read_file
from ..layout import holds_scans, locations, numbers, parse_float4, scan_files
from ..recorded import FileSource, Found
from ..tracks import Track, clean_track, euler_poses, matrix_poses
from .kitti import read_values

NAME = "KITTI raw"
INNER = ("velodyne_points/data", "velodyne_points")
_EARTH_RADIUS_M = 6378137.0
_MAX_PACKET = 4096  # bytes


def recognises(path: Path) -> bool:
    return holds_scans(path / "velodyne_points" / "data")


def find(path: Path, topic: str | None) -> Found:
    files = scan_files(path / "velodyne_points" / "data")
    indices = numbers(files)
    times = _read_times(path / "velodyne_points" / "timestamps.txt")
    notes = []
    stamps = None
    if times is None:
        notes.append("velodyne_points/timestamps.txt is missing: scans have no times")
    elif len(times) <= indices.max():
        notes.append(f"velodyne_points/timestamps.txt has only {len(times)} rows: not used")
    else:
        stamps = times[indices]
        if np.isnan(stamps).any():
            first = indices[np.isnan(stamps)][0]
            raise DatasetError(f"{path}: timestamps.txt has no time for scan {first}")
    return Found(
        name=path.resolve().name,
        format=NAME,
        source=FileSource(tuple(files), parse_float4),
        indices=indices,
        stamps=stamps,
        own_track=lambda: _oxts_track(path, timed=stamps is not None),
        frame="velodyne",
        fields="x y z reflectance",
        notes=tuple(notes),
    )


def _oxts_track(path: Path, *, timed: bool) -> Track | None:
    folder = path / "oxts" / "data"
    if not folder.is_dir():
        return None
    files = scan_files(folder, ".txt")
    packets = np.array([_read_packet(file) for file in files])
    T_velo_imu = _imu_to_velo(path)
    poses = mercator_poses(packets) @ geometry.inverse(T_velo_imu)
    keys = numbers(files)
    stamps = _read_times(path / "oxts" / "timestamps.txt") if timed else None
    if stamps is not None and len(stamps) > keys.max():
        return clean_track("oxts", stamps[keys], poses)
    return Track("oxts", keys.astype(np.float64), poses, "numbers")


def mercator_poses(packets: Float64) -> Float64:
    """Return T_world_imu (N, 4, 4) of OXTS packets (N, 6): lat, lon [deg], alt, roll, pitch, yaw.

    x points east, y north, z up; the origin is the first packet's position.
    """
    latitude, longitude = np.radians(packets[:, 0]), np.radians(packets[:, 1])
    scale = np.cos(latitude[0])
    x = scale * _EARTH_RADIUS_M * longitude
    y = scale * _EARTH_RADIUS_M * np.log(np.tan(np.pi / 4 + latitude / 2))
    xyz = np.column_stack([x, y, packets[:, 2]])
    return euler_poses(xyz - xyz[0], packets[:, 3:6])


def _read_packet(path: Path) -> list[float]:
    words = read_file(path)[:_MAX_PACKET].decode("ascii", "replace").split()
    try:
        values = [float(word) for word in words[:6]]
    except ValueError as error:
        raise DatasetError(f"{path}: {error}") from error
    if len(values) < 6 or not np.isfinite(values).all():
        raise DatasetError(f"{path}: not an OXTS packet of 30 numbers")
    return values


def _imu_to_velo(path: Path) -> Float64:
    for folder in (path, *(at.parent for at in locations(path))):
        file = folder / "calib_imu_to_velo.txt"
        if file.is_file():
            R, t = read_values(file, "R"), read_values(file, "T")
            if R.shape != (9,) or t.shape != (3,):
                raise DatasetError(f"{file}: R and T have {len(R)} and {len(t)} numbers")
            T = matrix_poses(np.column_stack([R.reshape(3, 3), t]).reshape(1, 12), str(file))[0]
            return np.asarray(T, dtype=np.float64)
    raise DatasetError(f"{path}: calib_imu_to_velo.txt is missing, in the drive and beside it")


def _read_times(path: Path) -> Float64 | None:
    """Read lines like ``2011-09-26 13:02:25.594360375`` as seconds since 1970.

    NaN for a blank line, where a scan is missing.
    """
    if not path.is_file():
        return None
    lines = read_file(path).decode("ascii", "replace").rstrip().split("\n")
    try:
        moments = np.array([line.strip() or "NaT" for line in lines], "datetime64[ns]")
    except ValueError as error:
        raise DatasetError(f"{path}: {error}") from error
    times = np.where(np.isnat(moments), np.nan, moments.astype(np.int64) * 1e-9)
    return np.asarray(times, dtype=np.float64)
