"""KITTI odometry and SemanticKITTI: ``sequences/00``, with ``velodyne`` and ``calib.txt``.

Format: the development kit's readme.txt, cvlibs.net/datasets/kitti/eval_odometry.php. Poses are
those of the left camera; ``Tr`` of calib.txt takes Velodyne points to it.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from .... import geometry
from ....errors import DatasetError
from ....types import Float64, Int64, Pose
from ...io.pose_files import read_pose_file
from ...io.scans import read_file
from ..layout import holds_scans, locations, numbers, parse_float4, relative, scan_files
from ..recorded import FileSource, Found
from ..tracks import Track, matrix_poses, read_table

NAME = "KITTI odometry"
INNER = ("velodyne",)


def recognises(path: Path) -> bool:
    beside = any((path / name).is_file() for name in ("calib.txt", "times.txt"))
    return beside and holds_scans(path / "velodyne")


def find(path: Path, topic: str | None) -> Found:
    files = scan_files(path / "velodyne")
    indices = numbers(files)
    stamps, note = _stamps(path / "times.txt", indices)
    folder = path.resolve()
    # SemanticKITTI's, then the benchmark's.
    beside = (at.parent.parent / "poses" / f"{at.name}.txt" for at in locations(path))
    truths = path / "poses.txt", *beside
    truth = next((file for file in truths if file.is_file()), None)
    return Found(
        name=folder.name,
        format=NAME,
        source=FileSource(tuple(files), parse_float4),
        indices=indices,
        stamps=stamps,
        own_track=lambda: camera_track(truth, path, relative(truth, path)) if truth else None,
        frame="velodyne",
        fields="x y z reflectance",
        notes=(note,) if note else (),
        own_poses=lambda file: camera_track(file, path, str(file)),
    )


def _stamps(path: Path, indices: Int64) -> tuple[Float64 | None, str]:
    if not path.is_file():
        return None, "times.txt is missing: scans have no times"
    times = read_table(path, [0], separator=None)[:, 0]
    if len(times) <= indices.max():
        return (
            None,
            f"times.txt has {len(times)} rows, but scans go up to {indices.max()}: not used",
        )
    return times[indices], ""


def camera_track(file: Path, folder: Path, name: str) -> Track | None:
    """Read a KITTI file of camera poses as poses of the Velodyne; None for a TUM file.

    The world is the first Velodyne frame: x forward, z up.
    """
    found = read_pose_file(file)
    trajectory = found.trajectory
    if found.kind != "kitti" or not len(trajectory):
        return None
    T_cam_velo = read_calibration(folder / "calib.txt", "Tr")
    poses = geometry.inverse(T_cam_velo) @ np.array(trajectory.poses) @ T_cam_velo
    return Track(name, np.array(trajectory.stamps), poses, "numbers")


def read_calibration(path: Path, key: str) -> Pose:
    """Read the rigid transform of a line ``key: 12 numbers`` of a calibration file.

    Raise DatasetError if the file or the line is missing, or the transform is not rigid.
    """
    values = read_values(path, key)
    if values.shape != (12,):
        raise DatasetError(f"{path}: {key} has {len(values)} numbers, not 12")
    T: Pose = matrix_poses(values[None], f"{path}: {key}")[0]
    if np.abs(T[:3, :3] - values.reshape(3, 4)[:, :3]).max() > 1e-2:
        raise DatasetError(f"{path}: {key} is not a rigid transform")
    return T


def read_values(path: Path, key: str) -> Float64:
    """Read the numbers after ``key:`` in a calibration file."""
    if not path.is_file():
        raise DatasetError(f"{path}: no such file; it is needed to read the poses")
    for line in read_file(path).decode("utf-8", "replace").splitlines():
        name, _, rest = line.partition(":")
        if name.strip() == key:
            try:
                return np.array([float(word) for word in rest.split()])
            except ValueError as error:
                raise DatasetError(f"{path}: {key}: {error}") from error
    raise DatasetError(f"{path}: no line {key!r}")
