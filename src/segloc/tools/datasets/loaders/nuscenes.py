"""nuScenes: the folder of ``v1.0-mini`` (or another version), ``samples`` and ``sweeps``.

Format: the schema of nuscenes.org and github.com/nutonomy/nuscenes-devkit; H. Caesar et al.,
"nuScenes: A multimodal dataset for autonomous driving", CVPR 2020. A recording is a scene, chosen
like a topic: ``--topic scene-0061``.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from ....errors import DatasetError
from ....types import Float64
from ...io.fields import brief
from ...io.kitti_bin import parse_nuscenes
from ..layout import choose
from ..recorded import FileSource, Found
from ..tracks import clean_track, quaternion_poses

NAME = "nuScenes"
INNER: tuple[str, ...] = ()
_CHANNEL = "LIDAR_TOP"
_MAX_NAMED = 12

Row = dict[str, Any]


def recognises(path: Path) -> bool:
    return bool(_versions(path))


def _versions(path: Path) -> list[Path]:
    if not path.is_dir():
        return []
    return sorted(file.parent for file in path.glob("v1.0-*/scene.json"))


def find(path: Path, topic: str | None) -> Found:
    """Read the tables and follow one scene's sweeps."""
    scenes = {
        str(row.get("name")): (folder, row)
        for folder in _versions(path)
        for row in _table(folder, "scene")
    }
    if not scenes:
        raise DatasetError(f"{path}: no scene in its tables")
    named = sorted(scenes)
    if topic is None and len(named) > _MAX_NAMED:
        few = ", ".join(named[:_MAX_NAMED])
        raise DatasetError(f"{path}: {len(named)} scenes, choose one: --topic {few}, ...")
    name = choose(path, named, topic)
    folder, scene = scenes[name]
    try:
        listed = _sweeps(folder, scene)
        there = [k for k, sweep in enumerate(listed) if (path / sweep["filename"]).is_file()]
        sweeps = [listed[k] for k in there]
        if not sweeps:
            raise DatasetError(f"{path}: none of the {len(listed)} sweeps of {name} is there")
        stamps = np.array([int(sweep["timestamp"]) * 1e-6 for sweep in sweeps])
        files = tuple(path / sweep["filename"] for sweep in sweeps)
    except DatasetError:
        raise
    except (LookupError, TypeError, ValueError, AttributeError, OverflowError) as error:
        raise DatasetError(f"{folder}: inconsistent tables: {error!r}"[:500]) from error
    return Found(
        name=name,
        format=NAME,
        source=FileSource(files, parse_nuscenes),
        indices=np.array(there, dtype=np.int64),
        stamps=stamps,
        own_track=lambda: clean_track("ego_pose", stamps, _poses(folder, sweeps)),
        topic=name,
        frame=_CHANNEL,
        fields="x y z intensity ring",
        notes=_missing(len(listed) - len(sweeps), len(listed)),
    )


def _missing(count: int, listed: int) -> tuple[str, ...]:
    return (f"{count} of {listed} sweeps left out: no files",) if count else ()


def _table(folder: Path, name: str) -> list[Row]:
    path = folder / f"{name}.json"
    if path.exists() and not path.is_file():
        raise DatasetError(f"{path}: not a regular file")
    try:
        rows = json.loads(path.read_bytes())
    except (OSError, ValueError, RecursionError) as error:
        raise DatasetError(f"{path}: {brief(error)}") from error
    except MemoryError as error:
        raise DatasetError(f"{path}: not enough memory to read it") from error
    if not isinstance(rows, list) or not all(isinstance(row, dict) for row in rows):
        raise DatasetError(f"{path}: not a table")
    return rows


def _sweeps(folder: Path, scene: Row) -> list[Row]:
    """Return the scene's sweeps of the roof LiDAR, in order."""
    sensors = {row["token"] for row in _table(folder, "sensor") if row["channel"] == _CHANNEL}
    mounts = {
        row["token"]: row
        for row in _table(folder, "calibrated_sensor")
        if row["sensor_token"] in sensors
    }
    samples = {
        row["token"] for row in _table(folder, "sample") if row["scene_token"] == scene["token"]
    }
    rows = [
        {**row, "mount": mounts[row["calibrated_sensor_token"]]}
        for row in _table(folder, "sample_data")
        if row["sample_token"] in samples and row["calibrated_sensor_token"] in mounts
    ]
    return sorted(rows, key=lambda row: int(row["timestamp"]))


def _poses(folder: Path, sweeps: list[Row]) -> Float64:
    try:
        wanted = {sweep["ego_pose_token"] for sweep in sweeps}
        egos = {row["token"]: row for row in _table(folder, "ego_pose") if row["token"] in wanted}
        T_world_car = _stack([egos[sweep["ego_pose_token"]] for sweep in sweeps], folder)
        T_car_lidar = _stack([sweep["mount"] for sweep in sweeps], folder)
    except (LookupError, TypeError, ValueError, AttributeError) as error:
        raise DatasetError(
            f"{folder}: ego_pose does not fit the sweeps: {error!r}"[:500]
        ) from error
    return T_world_car @ T_car_lidar


def _stack(rows: list[Row], folder: Path) -> Float64:
    xyz = np.array([row["translation"] for row in rows], dtype=np.float64).reshape(-1, 3)
    wxyz = np.array([row["rotation"] for row in rows], dtype=np.float64).reshape(-1, 4)
    return quaternion_poses(xyz, wxyz[:, [1, 2, 3, 0]], str(folder))
