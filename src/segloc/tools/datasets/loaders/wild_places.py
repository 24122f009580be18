"""Wild-Places: a run's folder with ``Clouds`` and ``poses_aligned.csv``.

Format: github.com/csiro-robotics/Wild-Places; J. Knights et al., "Wild-Places: A large-scale
dataset for lidar place recognition in unstructured natural environments", ICRA 2023. A cloud is a
second of a turning sensor, without distortion, in the frame of its pose. The aligned poses of all
runs of a place are in one frame.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from ...io.pcd import parse_pcd
from ..recorded import FileSource, Found
from ..tracks import Track, clean_track, quaternion_poses, read_table

NAME = "Wild-Places"
INNER = ("Clouds", "Clouds_downsampled")
_SCAN = re.compile(r"\d{9,10}\.\d{1,9}\.pcd", re.ASCII)
_TRUTHS = ("poses_aligned.csv", "poses.csv")
_COLUMNS = ("timestamp", "x", "y", "z", "qx", "qy", "qz", "qw")


def recognises(path: Path) -> bool:
    return _truth(path) is not None and any(_clouds(path / inner) for inner in INNER)


def _truth(path: Path) -> Path | None:
    return next((path / name for name in _TRUTHS if (path / name).is_file()), None)


def _clouds(folder: Path) -> list[tuple[float, Path]]:
    """List stamps and files of clouds, in order."""
    if not folder.is_dir():
        return []
    files = (file for file in folder.glob("*.pcd") if _SCAN.fullmatch(file.name))
    return sorted((float(file.stem), file) for file in files)


def find(path: Path, topic: str | None) -> Found:
    clouds = next(found for inner in INNER if (found := _clouds(path / inner)))
    truth = _truth(path)
    return Found(
        name=path.resolve().name,
        format=NAME,
        source=FileSource(tuple(file for _, file in clouds), parse_pcd),
        indices=np.arange(len(clouds)),
        stamps=np.array([stamp for stamp, _ in clouds]),
        own_track=lambda: _track(truth, truth.name) if truth else None,
        frame="of its pose",
        fields="x y z",
        own_poses=lambda file: _track(file, str(file)) if file.suffix == ".csv" else None,
    )


def _track(path: Path, name: str) -> Track:
    rows = read_table(path, _COLUMNS, header=True)
    poses = quaternion_poses(rows[:, 1:4], rows[:, 4:8], str(path))
    return clean_track(name, rows[:, 0], poses)
