"""Oxford RobotCar and its radar set: a traversal's folder with ``lms_front``, ``gps``, ``vo``, ...

Format: robotcar-dataset.robots.ox.ac.uk/documentation and the extrinsics of its SDK; W. Maddern et
al., "1 Year, 1000 km: The Oxford RobotCar Dataset", IJRR 2017. The car's frame has x forward,
y right, z down, and the world is north, east, down. Both are turned about x here: the world is
north, west, up, and points are in the frame of the car with x forward, y left, z up.
"""

from __future__ import annotations

import csv
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from .... import geometry
from ....errors import DatasetError
from ....types import Float64, Pose, Scan
from ...io.pose_files import header_of
from ...io.scans import read_file
from ..layout import (
    choose,
    float_rows,
    holds_scans,
    in_seconds,
    numbers,
    relative,
    rows_of,
    scan_files,
)
from ..recorded import FileSource, Found
from ..tracks import Z_UP, Track, clean_track, euler_poses, mount, read_table

NAME = "Oxford RobotCar"
MOUNTS = {
    "lms_front": ((1.7589, 0.2268, 1.0411), (-0.0437, -1.4572, 0.0356)),
    "lms_rear": ((-2.5850, 0.2852, 1.0885), (-2.8405, -1.5090, -0.3614)),
    "velodyne_left": ((-0.60072, -0.34077, -0.26837), (-0.0053948, -0.041998, -3.1337)),
    "velodyne_right": ((-0.61153, 0.55676, -0.27023), (0.0027052, -0.041999, -3.1357)),
}
"""T_car_sensor: x, y, z in metres and roll, pitch, yaw in radians."""
INS_MOUNT = ((-1.7132, 0.1181, 1.1948), (-0.0125, 0.0400, 0.0050))
INNER = tuple(MOUNTS)
_POSES = ("gps/rtk.csv", "rtk.csv", "gps/ins.csv", "vo/vo.csv")  # in order of accuracy
_UNUSABLE = frozenset({"INS_INACTIVE", "INS_ALIGNING"})


def recognises(path: Path) -> bool:
    return any(holds_scans(path / name, 15) for name in MOUNTS)


def find(path: Path, topic: str | None) -> Found:
    present = [name for name in MOUNTS if holds_scans(path / name, 15)]
    sensor = choose(path, present, topic)
    files = scan_files(path / sensor)
    stamps = numbers(files)
    truth = next((name for name in _POSES if (path / name).is_file()), None)
    kind = "reflectance" if sensor.startswith("lms") else "intensity"
    missing = _missing(path / f"{sensor}.timestamps", set(stamps.tolist()))
    return Found(
        name=path.resolve().name,
        format=NAME,
        source=FileSource(tuple(files), partial(parse, sensor=sensor)),
        indices=np.arange(len(files)),
        stamps=in_seconds(files, 1e-6),
        own_track=lambda: _track(path / truth, truth) if truth else None,
        topic=sensor,
        frame=f"car, z up ({sensor})",
        fields=f"x y {kind}" if sensor.startswith("lms") else f"x y z {kind}",
        notes=(missing,) if missing else (),
        own_poses=lambda file: (
            _track(file, relative(file, path)) if file.suffix == ".csv" and _is_own(file) else None
        ),
    )


def parse(data: bytes, sensor: str) -> Scan:
    """Parse a sweep of a LMS (rows of float64: x, y, reflectance) or a Velodyne scan (4 rows)."""
    if sensor.startswith("lms"):
        points = np.array(rows_of(data, "<f8", 3), dtype=np.float64)
        points[:, 2] = 0.0
    else:
        if len(data) % 16:
            raise DatasetError(f"cut off: {len(data)} bytes are not four rows of float32")
        points = float_rows(data, 1).reshape(4, -1).T[:, :3].astype(np.float64)
    points = points[(points != 0).any(axis=1)]  # zeros are firings without a return
    with np.errstate(all="ignore"):  # non-finite points are dropped by Scan
        return Scan(geometry.transform(Z_UP @ mount(*MOUNTS[sensor]), points))


def _missing(path: Path, stamps: set[int]) -> str:
    """Return a note on listed scans without a file."""
    if not path.is_file():
        return ""
    listed = read_table(path, [0], separator=None)[:, 0]
    lost = sum(int(stamp) not in stamps for stamp in listed[np.isfinite(listed)])
    return f"{lost} of the {len(listed)} scans in {path.name} are missing" if lost else ""


def _is_own(path: Path) -> bool:
    """Return whether a table has columns of the set: of the INS, or of visual odometry."""
    header = header_of(path)
    return not header or header.startswith("source_timestamp")


def _track(path: Path, name: str) -> Track:
    """Read poses of the car from an INS, RTK or visual odometry file."""
    header = read_file(path).partition(b"\n")[0].decode("ascii", "replace").split(",")
    if header[0].strip() == "source_timestamp":
        return _visual_odometry(path, name)
    columns = ("timestamp", "northing", "easting", "down", "roll", "pitch", "yaw")
    rows = read_table(path, columns, header=True)
    aligned = _usable_rows(path)
    if len(aligned) != len(rows):
        raise DatasetError(f"{path}: rows without an INS status")
    lost = len(rows) - int(aligned.sum())
    if lost == len(rows):
        raise DatasetError(f"{path}: the INS was never aligned")
    rows = rows[aligned]
    poses = upright(euler_poses(rows[:, 1:4], rows[:, 4:]), mount(*INS_MOUNT))
    track = clean_track(name, rows[:, 0] * 1e-6, poses)
    if not lost:
        return track
    notes = [f"{name}: {lost} poses left out: INS not aligned", *filter(None, [track.note])]
    return replace(track, note="; ".join(notes))


def _usable_rows(path: Path) -> np.ndarray:
    lines = read_file(path).decode("ascii", "replace").splitlines()
    try:
        table = [row for row in csv.DictReader(lines) if any(row.values())]
    except csv.Error as error:
        raise DatasetError(f"{path}: {error}") from error
    return np.array([row.get("ins_status") not in _UNUSABLE for row in table])


def _visual_odometry(path: Path, name: str) -> Track:
    """Chain the relative poses: each row has the later frame's pose in the earlier frame."""
    columns = ("source_timestamp", "destination_timestamp", "x", "y", "z", "roll", "pitch", "yaw")
    rows = read_table(path, columns, header=True)
    earlier, later = rows[:, :2].min(axis=1), rows[:, :2].max(axis=1)
    broken = np.flatnonzero(earlier[1:] != later[:-1])
    if len(broken):
        raise DatasetError(f"{path}: row {broken[0] + 2} does not start where the last one ended")
    poses = np.empty((len(rows) + 1, 4, 4))
    poses[0] = np.eye(4)
    for k, step in enumerate(euler_poses(rows[:, 2:5], rows[:, 5:])):
        poses[k + 1] = poses[k] @ step
    stamps = np.concatenate([earlier[:1], later]) * 1e-6
    return clean_track(name, stamps, upright(poses, np.eye(4)))


def upright(T_world_source: Float64, T_car_source: Pose) -> Float64:
    """Return poses of the car with z up from those of a pose source with z down."""
    poses: Float64 = Z_UP @ T_world_source @ geometry.inverse(T_car_source) @ Z_UP
    return poses
