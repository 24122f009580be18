"""Sources of exports: a map, or the output folder of a command."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from ...errors import DatasetError, InvalidScan
from ...map.georeference import KEY, Georeference
from ...map.info import CLOUD_FRAME
from ...map.segment_map import SegmentMap
from ...system.checks import checked_pose
from ...types import Float64, Pose
from ..io import Trajectory, read_trajectory
from ..io.scans import read_file

_QUERIES, _STATES = "localizations.jsonl", "states.jsonl"


@dataclass(frozen=True)
class MapSource:
    """A map to export."""

    path: Path
    prior_map: SegmentMap
    what = "a map"


@dataclass(frozen=True)
class FoundSource:
    """Results of `segloc localize` or `segloc live`."""

    path: Path  # output folder
    track: Trajectory  # T_map_sensor by stamp, or by scan number
    timed: bool  # True if by stamp
    georeference: Georeference | None  # of the map
    T_map_cloud: Pose  # of the map
    is_drive: bool  # True if of `segloc live`
    what = "results of `segloc localize` or `segloc live`"

    def answers(self) -> Iterator[dict[str, Any]]:
        """Read the records that have a pose: the pose as ``T``, the covariance as an array."""
        path = self.path / (_STATES if self.is_drive else _QUERIES)
        key = "T_map_base" if self.is_drive else "T_map_sensor"
        for record in _records(path):
            if record.get(key) is not None:
                T, covariance = _pose(record[key], f"{path}: {key}"), record.get("covariance")
                if covariance is not None:
                    covariance = _matrix(covariance, 6, f"{path}: covariance")
                yield {**record, "T": T, "covariance": covariance}


@dataclass(frozen=True)
class AlignedSource:
    """Results of `segloc align`."""

    path: Path  # output folder
    names: list[str]  # of the sessions
    components: list[list[int]]  # groups of sessions that share a frame
    # errors assumed of odometry: `odometry_m`, `odometry_deg`, `odometry_scale`
    noise: tuple[float, float, float]
    what = "results of `segloc align`"

    def session(self, k: int) -> Trajectory:
        """Read T_world_sensor of a session, by scan number."""
        return read_trajectory(self.path / f"session_{k}.tum")

    def odometry(self, k: int) -> Trajectory:
        """Read T_odom_sensor of a session, by scan number."""
        return read_trajectory(self.path / f"odometry_{k}.tum")

    def loops(self) -> Iterator[dict[str, Any]]:
        """Read accepted and rejected loops."""
        yield from _records(self.path / "loops.jsonl")


Source: TypeAlias = MapSource | FoundSource | AlignedSource


def open_source(path: Path) -> Source:
    """Open a map, or the results in a folder, by the files in it.

    Raise DatasetError if it is neither, or a file in it cannot be read; MapFormatError if it is a
    file, but not a map.
    """
    if not path.is_dir():
        return MapSource(path, SegmentMap.load(path))
    if (path / "alignment.json").is_file():
        return _open_aligned(path)
    for kept in (_QUERIES, _STATES):
        if (path / kept).is_file():
            timed = "no times" not in _read(path / "poses.tum")[:300]
            track = read_trajectory(path / "poses.tum")
            return FoundSource(path, track, timed, *_frame(path), kept == _STATES)
    raise DatasetError(
        f"{path}: neither a map nor results: no alignment.json, {_QUERIES} or {_STATES} in it"
    )


def _frame(path: Path) -> tuple[Georeference | None, Pose]:
    """Read the georeference and the transform from the cloud that were stored of the map."""
    file = path / "summary.json"
    facts = _parse(_read(file), str(file)) if file.is_file() else {}
    where, T_map_cloud = facts.get(KEY), facts.get(CLOUD_FRAME, np.eye(4))
    return (
        None if where is None else Georeference.of({KEY: json.dumps(where)}),
        _pose(T_map_cloud, f"{file}: {CLOUD_FRAME}"),
    )


def _pose(rows: Any, where: str) -> Pose:
    try:
        return checked_pose(_matrix(rows, 4, where), where)
    except InvalidScan as error:
        raise DatasetError(f"{where}: damaged: {error}") from error


def _matrix(rows: Any, size: int, where: str) -> Float64:
    try:
        return np.array(rows, np.float64).reshape(size, size)
    except (ValueError, TypeError) as error:
        raise DatasetError(f"{where}: damaged: {error}") from error


def _open_aligned(path: Path) -> AlignedSource:
    file = path / "alignment.json"
    facts = _parse(_read(file), str(file))
    try:
        names = [str(session["name"]) for session in facts["sessions"]]
        components = [[int(k) for k in members] for members in facts["components"]]
        noise = facts["odometry"]
        erred = tuple(float(noise[f"odometry_{key}"]) for key in ("m", "deg", "scale"))
    except (KeyError, TypeError, ValueError) as error:
        raise DatasetError(f"{file}: not written by this `segloc align`: {error}") from error
    if sorted(k for members in components for k in members) != list(range(len(names))):
        raise DatasetError(f"{file}: its components do not match its sessions")
    return AlignedSource(path, names, components, (erred[0], erred[1], erred[2]))


def _records(path: Path) -> Iterator[dict[str, Any]]:
    """Read the objects of a file of JSON lines."""
    for number, line in enumerate(_read(path).splitlines(), 1):
        yield _parse(line, f"{path}: line {number}")


def _read(path: Path) -> str:
    return read_file(path).decode("utf-8", "replace")


def _parse(text: str, where: str) -> dict[str, Any]:
    try:
        values = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise DatasetError(f"{where}: damaged: {error}") from error
    if not isinstance(values, dict):
        raise DatasetError(f"{where}: damaged: no JSON object")
    return values
