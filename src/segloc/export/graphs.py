"""Aligned sessions as a pose graph of others, and their loops."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import DatasetError, InvalidScan
from ..io.g2o import PoseEdges, format_g2o
from ..motion import odometry_covariance
from ..system.checks import checked_pose
from ..system.files import write_text
from ..types import Float64, Int64
from .sources import AlignedSource


def write_loops(source: AlignedSource, out: Path) -> list[str]:
    """The accepted loops, one JSON object a line."""
    lines = [json.dumps(loop, allow_nan=False) + "\n" for loop in _accepted(source)]
    write_text(out, "".join(lines))
    return []


def write_g2o(source: AlignedSource, out: Path) -> list[str]:
    """All scans as vertices, odometry and accepted loops as edges.

    Vertices are numbered through all sessions; the first of each component is fixed.
    """
    sessions = range(len(source.names))
    tracks = [source.session(k) for k in sessions]
    first = np.concatenate([[0], np.cumsum([len(track) for track in tracks])]).astype(np.int64)
    edges = [_odometry(source, k, int(first[k])) for k in sessions]
    edges.append(_loops(source, [track.stamps for track in tracks], first))
    fixed = [int(first[members[0]]) for members in source.components]
    poses = np.concatenate([track.poses for track in tracks])
    write_text(out, format_g2o(poses, edges, fixed))
    return []


def _accepted(source: AlignedSource) -> list[dict[str, Any]]:
    return [loop for loop in source.loops() if loop.get("accepted") is True]


def _odometry(source: AlignedSource, session: int, first: int) -> PoseEdges:
    """From each scan to the next."""
    poses = source.odometry(session).poses
    numbers = np.arange(first, first + len(poses) - 1, dtype=np.int64)
    T = np.linalg.inv(poses[:-1]) @ poses[1:]
    length = np.linalg.norm(T[:, :3, 3], axis=1)
    return PoseEdges(numbers, numbers + 1, T, odometry_covariance(length, *source.noise))


def _loops(source: AlignedSource, numbers: list[Float64], first: Int64) -> PoseEdges:
    found = _accepted(source)
    ends = {"target": np.empty(len(found), np.int64), "source": np.empty(len(found), np.int64)}
    T, covariance = np.empty((len(found), 4, 4)), np.empty((len(found), 6, 6))
    for n, loop in enumerate(found):
        try:
            for end, rows in ends.items():
                k, scan = int(loop[f"{end}_session"]), float(loop[f"{end}_scan"])
                rows[n] = first[k] + np.flatnonzero(numbers[k] == scan)[0]
            T[n] = checked_pose(loop["T_target_source"], "T_target_source")
            covariance[n] = loop["covariance"]
        except (KeyError, IndexError, TypeError, ValueError, InvalidScan) as error:
            raise DatasetError(
                f"{source.path}/loops.jsonl: accepted loop {n + 1} is not of these sessions"
            ) from error
    return PoseEdges(ends["target"], ends["source"], T, covariance)
