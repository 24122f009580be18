"""What is asked where: each course is a map, the queries asked in it, and a map they are not in."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from ..datasets import NO_POSES, Recording, Swathes, open_sequence, poses_at
from ..errors import ConfigError, DatasetError
from ..local_cloud import LocalCloudConfig
from ..simulation.suites import SIX, TestSet
from ..types import Float64, Int64
from .localization import query_positions
from .workspace import Pair, Workspace

EVERY_M = 10.0
_STRANGER_SEED = 10_000
_GAP_M = LocalCloudConfig().max_gap_m


@dataclass(frozen=True)
class Ask:
    """Queries: scans at some positions of a recording.

    Attributes
    ----------
    recording : Recording
        Its poses, where it has any, are those by which queries are accumulated.
    positions : (N,) int64
    truths : (N, 4, 4) float64 or None
        True T_map_sensor.
    """

    recording: Recording
    positions: Int64
    truths: Float64 | None


@dataclass(frozen=True)
class Opened:
    """The recordings of a course.

    Attributes
    ----------
    map : Recording
    stranger : Recording or None
        Another place seen by the same kind of sensor: what is found in it is false.
    asks : dict of str to Ask
    """

    map: Recording
    stranger: Recording | None
    asks: dict[str, Ask]


@dataclass(frozen=True)
class Facts:
    """What a table says of a course: kind of place, sensor, and the length of its queries' way."""

    kind: str
    sensor: str


class Course(Protocol):
    """A map, and the queries that are asked in it; small, so that processes can be handed it."""

    @property
    def name(self) -> str: ...

    def facts(self) -> Facts: ...

    def settings(self) -> dict[str, Any]:
        """Everything that decides what :meth:`open` gives."""
        ...

    def open(self) -> Opened: ...


@dataclass(frozen=True)
class SuiteCourse:
    """A simulated test set; the stranger is a world of another seed, built by the same rules."""

    test: TestSet
    scale: str
    seed: int

    @property
    def name(self) -> str:
        return self.test.name

    def facts(self) -> Facts:
        return Facts(self.test.kind, self.test.sensor)

    def settings(self) -> dict[str, Any]:
        return {"set": asdict(self.test), "scale": self.scale, "seed": self.seed}

    def open(self) -> Opened:
        sessions = self.test.sessions(self.scale, seed=self.seed)
        asks = {name: _simulated(item) for name, item in sessions.items() if name != "map"}
        return Opened(sessions["map"], self.stranger(), asks)

    def stranger(self) -> Recording:
        """What the map of another world is made of."""
        alone = replace(self.test, tests=self.test.tests[:1], length_m=self._session_length())
        return alone.sessions(self.scale, seed=self.seed + _STRANGER_SEED)["map"]

    def _session_length(self) -> float:
        return self.test.length_m / len(self.test.tests)


def _simulated(recording: Recording) -> Ask:
    truth = np.asarray(getattr(recording, "truth", recording.poses))
    if isinstance(recording, Swathes):  # they lie 30 m apart: each is a query by itself
        return Ask(recording, np.arange(len(recording), dtype=np.int64), truth)
    positions = query_positions(truth, EVERY_M, _GAP_M)
    return Ask(recording, positions, truth[positions])


@dataclass(frozen=True)
class KittiCourse:
    """KITTI odometry 00, as keyframes and as full scans with TUM poses.

    "kitti00": the first half of the drive is mapped and all of the rest is asked every 10 m,
    accumulated, and as one thinned keyframe each (sparse). "kitti00-later": the later passes are
    mapped, and every full scan of the first 827 m is asked by itself. The stranger is the simulated
    town of the test set that has the same sensor.
    """

    data: Path
    later: bool
    scale: str
    seed: int

    @property
    def name(self) -> str:
        return "kitti00-later" if self.later else "kitti00"

    def facts(self) -> Facts:
        return Facts("Urban, real", "hdl64e")

    def settings(self) -> dict[str, Any]:
        folders = [self.data, self.data / "keyframes", self.data / "scans"]
        for folder in folders:
            if not folder.is_dir():
                raise DatasetError(f"{folder}: no such folder; --kitti needs keyframes and scans")
        sizes = [_size(folder) for folder in folders]
        return {"course": self.name, "bytes": sizes, "scale": self.scale, "seed": self.seed}

    def open(self) -> Opened:
        keyframes, scans = self.data / "keyframes", self.data / "scans"
        town = next(test for test in SIX if test.name == "kitti")
        stranger = SuiteCourse(town, self.scale, self.seed).stranger()
        if self.later:
            site = open_sequence(keyframes, "keyframes.tum", "619:654,988:1003,1361:1600")
            truths = open_sequence(scans, "scans.tum").poses
            alone = open_sequence(scans, NO_POSES)
            positions = np.arange(len(alone), dtype=np.int64)
            return Opened(site, stranger, {"single": Ask(alone, positions, truths)})
        site = open_sequence(keyframes, "keyframes.tum", "100:947")
        accumulated = open_sequence(keyframes, "keyframes.tum", "948:1820")
        sparse = open_sequence(keyframes, NO_POSES, "948:1820")
        truths = accumulated.poses
        assert truths is not None  # it was opened with them
        positions = query_positions(truths, EVERY_M, _GAP_M)
        chosen = truths[positions]
        asks = {
            "accumulated": Ask(accumulated, positions, chosen),
            "sparse": Ask(sparse, positions, chosen),
        }
        return Opened(site, stranger, asks)


@dataclass(frozen=True)
class PairCourse:
    """Two recordings of the user's own."""

    pair: Pair

    @property
    def name(self) -> str:
        return "own"

    def facts(self) -> Facts:
        return Facts("own", "own")

    def settings(self) -> dict[str, Any]:
        opened = self.open()
        parts = (opened.map, opened.asks["query"].recording)
        return {
            "pair": {key: str(value) for key, value in asdict(self.pair).items()},
            "scans": [len(part) for part in parts],
            "bytes": [_size(folder) for folder in (self.pair.map, self.pair.query)],
            "poses": [_sum(part.poses) for part in parts],
            "truths": _sum(opened.asks["query"].truths),
        }

    def open(self) -> Opened:
        pair = self.pair
        site = open_sequence(pair.map, pair.map_poses, pair.map_select, topic=pair.topic)
        query = open_sequence(pair.query, pair.poses, pair.select, topic=pair.topic)
        truths = None
        if pair.truth is not None:
            truths = poses_at(query, pair.query, pair.truth, topic=pair.topic)
        way = query.poses if query.poses is not None else truths
        positions = np.arange(len(query), dtype=np.int64)
        if way is not None:
            positions = query_positions(way, pair.every_m, _GAP_M)
        if not len(positions):
            raise ConfigError(f"{query.name} has no stretch of {pair.every_m:g} m")
        ask = Ask(query, positions, None if truths is None else truths[positions])
        return Opened(site, None, {"query": ask})


def _size(path: Path) -> int:
    """Bytes of a file, or of the files in a folder."""
    files = path.iterdir() if path.is_dir() else [path]
    return sum(file.stat().st_size for file in files if file.is_file())


def _sum(poses: Float64 | None) -> float | None:
    return None if poses is None else float(np.abs(poses).sum())


def courses(workspace: Workspace) -> Sequence[Course]:
    """The user's own pair where there is one; else the suite, and KITTI where it is at hand."""
    if workspace.sequences is not None:
        return [PairCourse(workspace.sequences)]
    scale, seed = workspace.scale, workspace.seed
    chosen: list[Course] = [SuiteCourse(test, scale, seed) for test in workspace.sets]
    if workspace.data is not None:
        chosen += [KittiCourse(workspace.data, later, scale, seed) for later in (False, True)]
    return chosen
