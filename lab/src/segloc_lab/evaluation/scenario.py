"""Scenarios: a map, queries in it, and a map of another place."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from segloc.errors import ConfigError
from segloc.frontend import LocalCloudConfig
from segloc.tools.batch import query_positions
from segloc.tools.datasets import open_sequence, poses_at
from segloc.types import Float64, Int64, Recording

MAX_GAP_M = LocalCloudConfig().max_gap_m


@dataclass(frozen=True)
class QuerySet:
    """Queries: scans at some positions of a recording.

    Attributes
    ----------
    recording : Recording
        With poses, if any, by which queries are accumulated.
    positions : (N,) int64
    truths : (N, 4, 4) float64 or None
        True T_map_sensor.
    """

    recording: Recording
    positions: Int64
    truths: Float64 | None


@dataclass(frozen=True)
class OpenedScenario:
    """The recordings of a scenario.

    Attributes
    ----------
    negative : callable or None
        Opens another place by the same kind of sensor: every answer in it is false.
    """

    map: Recording
    negative: Callable[[], Recording] | None
    query_sets: dict[str, QuerySet]


class Scenario(Protocol):
    """A map and its queries; small, to be passed to processes."""

    @property
    def name(self) -> str: ...

    @property
    def segments_alone(self) -> bool:
        """Whether segments are the only proposer, so that only methods differ."""
        ...

    def facts(self) -> tuple[str, str]:
        """Return the kind of place and the sensor, for tables."""
        ...

    def settings(self) -> dict[str, Any]:
        """Return everything that affects :meth:`open`."""
        ...

    def open(self) -> OpenedScenario: ...


@dataclass(frozen=True)
class Pair:
    """A recording to map, and one to localize in it.

    Attributes
    ----------
    map, query : Path
        Paths for :func:`segloc.tools.datasets.open_sequence`.
    map_poses : Path or None
        Poses that define the map frame; by default the recording's own.
    poses : Path or None
        Odometry of the queries, for accumulation; by default the recording's own. Without any,
        queries are single scans.
    truth : Path or None
        True poses of the queries in the map's frame, to score against.
    map_select, select : str or None
        Selected scans; see :func:`segloc.tools.datasets.parse_select`.
    topic : str or None
        Of both recordings, if they have several.
    every_m : float
        Travel between queries [m]; without poses every scan is a query.
    """

    map: Path
    query: Path
    map_poses: Path | None = None
    poses: Path | None = None
    truth: Path | None = None
    map_select: str | None = None
    select: str | None = None
    topic: str | None = None
    every_m: float = 10.0


@dataclass(frozen=True)
class PairScenario:
    """Two recordings of the user."""

    pair: Pair

    name = "own"
    segments_alone = False

    def facts(self) -> tuple[str, str]:
        return "own", "own"

    def settings(self) -> dict[str, Any]:
        opened = self.open()
        parts = (opened.map, opened.query_sets["query"].recording)
        return {
            "pair": {key: str(value) for key, value in asdict(self.pair).items()},
            "scans": [len(part) for part in parts],
            "files": [digest_of_files(path) for path in (self.pair.map, self.pair.query)],
            "poses": [_digest(part.poses) for part in parts],
            "truths": _digest(opened.query_sets["query"].truths),
        }

    def open(self) -> OpenedScenario:
        pair = self.pair
        prior_map = open_sequence(pair.map, pair.map_poses, pair.map_select, topic=pair.topic)
        query = open_sequence(pair.query, pair.poses, pair.select, topic=pair.topic)
        truths = None
        if pair.truth is not None:
            truths = poses_at(query, pair.query, pair.truth, topic=pair.topic)
        path = query.poses if query.poses is not None else truths
        positions = np.arange(len(query), dtype=np.int64)
        if path is not None:
            positions = query_positions(path, pair.every_m, MAX_GAP_M)
        if truths is not None:
            positions = positions[np.isfinite(truths[positions, 0, 0])]
        if not len(positions):
            raise ConfigError(f"{query.name} has no stretch of {pair.every_m:g} m")
        query_set = QuerySet(query, positions, None if truths is None else truths[positions])
        return OpenedScenario(prior_map, None, {"query": query_set})


def digest_of_files(path: Path) -> str:
    """Return a digest of a file, or of the files below a folder: names, sizes, times of change."""
    files = sorted(path.rglob("*")) if path.is_dir() else [path]
    rows = [
        (str(file.relative_to(path)), found.st_size, found.st_mtime_ns)
        for file in files
        if file.is_file() and (found := file.stat())
    ]
    return hashlib.sha256(json.dumps(rows).encode()).hexdigest()[:16]


def _digest(poses: Float64 | None) -> str | None:
    return None if poses is None else hashlib.sha256(poses.tobytes()).hexdigest()[:16]
