"""The sets: what is mapped, and which queries are localized there.

Half of the queries, or nearly, are of another place. Simulated worlds have seeds of their own.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import pairwise
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from segloc import geometry
from segloc.tools.batch import COVERAGE_RADIUS_M, distances_to_path, query_positions
from segloc.tools.datasets import open_sequence
from segloc.tools.io import clouds
from segloc.types import Derived, Float64, Int64, Recording, Scan

from .. import kitti00
from ..calibration.worlds import simulated
from ..protocols import real
from ..protocols.finished_clouds import CUT_M
from ..recordings import Files, beside, has_room
from ..simulation import (
    SCENES,
    Conditions,
    Lidar,
    Route,
    SimulatedSequence,
    World,
    hdl64e,
    simulate_session,
)
from ..simulation.drives import mapped_way
from .exchange import ELSEWHERE

FAR_M = 1e6
"""Poses of another place are moved by this, so that no answer is right by accident [m]."""
OFFSETS_M = (0.0, 5.0, 10.0, 15.0)
PATH_M, TOWN_M, TOWN_SEED = 240.0, 260.0, 8000
TOWN_STEP, TOWN_STEP_ELSEWHERE = 16, 5
"""Scans of a drive between two queries."""
CHANGED = Conditions(foliage=0.2, replaced=0.2, scaffolding=0.1)
WORLD_SEED = 65_000
WORLD_EVERY_M = 3.5
"""Distance between queries in the other simulated worlds [m]."""
LINE_M = 5.0
"""Between poses of a path that is known at some places [m]."""
OTHER_WORLD = 100
"""Added to a seed for the world of the queries from elsewhere."""


@dataclass(frozen=True)
class Group:
    """Queries of one recording.

    Attributes
    ----------
    positions : (N,) int64
    truths : (N, 4, 4) float64
        True T_map_sensor.
    name : str
        What is told apart in the tables; ``ELSEWHERE`` for another place.
    gathered : bool
        Whether a query is the cloud of the path behind a scan, and not the scan alone.
    """

    recording: Recording
    positions: Int64
    truths: Float64
    name: str = "all"
    gathered: bool = False

    def thinned(self, every: int) -> Group:
        """Return every N-th query."""
        some = slice(None, None, every)
        return replace(self, positions=self.positions[some], truths=self.truths[some])


@dataclass(frozen=True)
class Material:
    """What a set is made of.

    Attributes
    ----------
    coverage_m : float
        A query is within map coverage up to this distance from the mapped path [m].
    is_approximate : bool
        Whether true poses agree with the map to a metre only, and are aligned with it.
    """

    mapped: Recording
    groups: list[Group]
    coverage_m: float = COVERAGE_RADIUS_M
    is_approximate: bool = False


@dataclass(frozen=True)
class Set:
    """A set of queries and their map.

    Attributes
    ----------
    make : callable
        Returns the material, from the folder of recordings.
    needs : str or None
        Folder of the recordings that must exist; None for simulated sets.
    traits : tuple of str
        What systems have options for: "gathered", "beside", "indoors", "cloud".
    sensor_height_m : float
        Of the viewpoints in a finished cloud.
    """

    make: Callable[[Path], Material]
    needs: str | None = None
    traits: tuple[str, ...] = ()
    sensor_height_m: float = 1.0

    @property
    def is_cloud(self) -> bool:
        """Whether the map is one finished cloud."""
        return "cloud" in self.traits


# --- recordings -----------------------------------------------------------------------------------


def kitti(protocol: str, step: int, step_off_map: int, data: Path) -> Material:
    """Take every N-th query of a protocol of KITTI 00, in the map and off the mapped path."""
    folder = data / "kitti00"
    gathered = kitti00.PROTOCOLS[protocol].accumulated
    mapped, queries = kitti00.mapped(folder, protocol), kitti00.query_set(folder, protocol)
    assert queries.truths is not None
    near = distances_to_path(queries.truths, kitti00.poses_of(mapped)) <= COVERAGE_RADIUS_M
    steps = np.where(near, step, step_off_map)
    chosen = np.flatnonzero(np.arange(len(near)) % steps == 0)
    group = Group(
        queries.recording, queries.positions[chosen], queries.truths[chosen], gathered=gathered
    )
    return Material(mapped, [group], is_approximate=True)


def corridor(data: Path) -> Material:
    """Map the corridor on the way out, localize the way back and scans of a narrower corridor."""
    other = data / "vlp16_narrow_corridor"
    return Material(
        real.corridor(data, real.OUT),
        [
            _group(real.corridor_queries(data), "corridor, single"),
            _elsewhere(open_sequence(other / "scans", other / "poses.tum")),
        ],
    )


def lab(data: Path) -> Material:
    """Map a session of the lab, localize another one and scans of other rooms."""
    other = data / "robosense_e1r_indoor"
    return Material(
        real.lab(data, "0618"),
        [
            _group(real.lab_queries(data), "lab 0622c, single").thinned(2),
            _elsewhere(open_sequence(other / "scans", other / "poses.tum")).thinned(4),
        ],
    )


@dataclass(frozen=True)
class CloudParts:
    """A finished cloud as a recording: each pose has the points that are nearest to it.

    Attributes
    ----------
    cloud : (N, 3) float64
    poses : (K, 4, 4) float64
    """

    name: str
    cloud: Float64
    poses: Float64

    stamps = None

    @property
    def indices(self) -> Int64:
        return np.arange(len(self), dtype=np.int64)

    def __len__(self) -> int:
        return len(self.poses)

    @cached_property
    def _nearest(self) -> Int64:
        return np.asarray(cKDTree(self.poses[:, :3, 3]).query(self.cloud)[1], dtype=np.int64)

    def scan(self, i: int) -> Scan:
        """Return the points that are nearest to pose i, in its frame."""
        T = self.poses[i]
        points = geometry.transform(geometry.inverse(T), self.cloud[self._nearest == i])
        return Scan(points.astype(np.float32), T_odom_sensor=T)


@dataclass(frozen=True)
class Groundless(Derived[Recording]):
    """Scans of an HDL-64E on a car without what lies below 0.3 m, without poses."""

    poses = None

    def scan(self, i: int) -> Scan:
        """Return a scan, cut."""
        points = self.source.scan(i).points
        return Scan(points[points[:, 2] > CUT_M])


def along_lines(poses: Float64, step_m: float) -> Float64:
    """Return poses with others on the lines between them, so that none are far apart."""
    found = [poses[:1]]
    for a, b in pairwise(poses):
        count = int(np.ceil(np.linalg.norm(b[:3, 3] - a[:3, 3]) / step_m))
        between = np.tile(a, (max(count, 1), 1, 1))
        between[:, :3, 3] = np.linspace(a[:3, 3], b[:3, 3], len(between) + 1)[1:]
        between[-1] = b
        found.append(between)
    return np.concatenate(found)


def grand_loop(data: Path) -> Material:
    """Take a finished cloud without ground, scans of months later, and starts of other drives."""
    root = data / "utd_grand_loop"
    queries = open_sequence(root / "scans", root / "poses_registered.tum")
    truths = kitti00.poses_of(queries)
    cloud = np.concatenate(list(clouds.read_cloud(root / "map.laz"))).astype(np.float64)
    starts = Groundless(Files(data / "kitti_starts"))
    nowhere = far(np.tile(np.eye(4), (len(starts), 1, 1)))
    return Material(
        CloudParts("grand loop", cloud, along_lines(truths, LINE_M)),
        [
            Group(queries, np.arange(len(truths), dtype=np.int64), truths),
            Group(starts, np.arange(len(starts), dtype=np.int64), nowhere, ELSEWHERE),
        ],
    )


def _group(queries: Iterator[real.Queries], name: str) -> Group:
    """Return the queries of this name."""
    found = next(each for each in queries if each.name == name)
    assert found.truths is not None
    return Group(found.recording, found.positions, found.truths)


def _elsewhere(recording: Recording) -> Group:
    """Return all scans of another place."""
    truths = kitti00.poses_of(recording)
    return Group(recording, np.arange(len(truths), dtype=np.int64), far(truths), ELSEWHERE)


def far(poses: Float64) -> Float64:
    """Move poses of another place away from those of the map."""
    return geometry.rigid(np.eye(3), np.array([FAR_M, 0.0, 0.0])) @ poses


# --- simulated worlds -----------------------------------------------------------------------------


@dataclass(frozen=True)
class Level(Derived[SimulatedSequence]):
    """Scans of a simulated drive without poses, turned level as by a robot's IMU."""

    poses = None

    def scan(self, i: int) -> Scan:
        """Cast a scan and turn it level."""
        T = self.source.truth[i]
        turn = geometry.inverse(geometry.levelled(T)) @ T
        points = geometry.transform(turn, super().scan(i).points)
        return Scan(points.astype(np.float32))


def world(kind: str, seed: int, _: Path) -> Material:
    """Make a world in which a fifth of the objects are replaced before queries are recorded."""
    here, there = (simulated(kind, s) for s in (seed, seed + OTHER_WORLD))
    groups = []
    for each, name in ((here, "all"), (there, ELSEWHERE)):
        drive = next(iter(each.queries.values()))
        at = query_positions(drive.truth, WORLD_EVERY_M, 10.0)
        groups.append(_levelled(drive, at, name))
    return Material(here.mapped, groups)


def _levelled(drive: SimulatedSequence, at: Int64, name: str) -> Group:
    truths = np.array([geometry.levelled(drive.truth[i]) for i in at]).reshape(-1, 4, 4)
    return Group(Level(drive), at, far(truths) if name == ELSEWHERE else truths, name)


def town(_: Path) -> Material:
    """Map a town, then see it from beside, in the opposite direction, and changed."""
    towns = []
    for seed in (TOWN_SEED, TOWN_SEED + 1000):
        made = SCENES["town"](seed, size_m=TOWN_M)
        towns.append((made, tuple(mapped_way(made, np.random.default_rng([seed, 31]), PATH_M))))
    (here, there), lidar = towns, hdl64e(900)
    again = _drive(here, 1, lidar, Conditions(replaced=0.1))
    drives = [
        (f"{offset:g} m beside", beside(again, again.truth, side))
        for offset in OFFSETS_M
        for side in sorted({offset, -offset})
    ]
    drives.append(("opposite direction", beside(again, again.truth, 3.0, turned=True)))
    drives.append(("changed", _drive(here, 2, lidar, CHANGED)))
    drives.append((ELSEWHERE, _drive(there, 0, lidar, Conditions())))
    groups = [
        _levelled(drive, _with_room(drive, name == ELSEWHERE), name) for name, drive in drives
    ]
    mapped = _drive(here, 0, lidar, Conditions())
    return Material(mapped, groups, coverage_m=OFFSETS_M[-1] + COVERAGE_RADIUS_M)


def _with_room(drive: SimulatedSequence, dense: bool) -> Int64:
    """Return positions along a drive at which nothing stands where the sensor does."""
    step = TOWN_STEP_ELSEWHERE if dense else TOWN_STEP
    found = (
        i
        for i in range(step // 2, len(drive), step)
        if has_room(drive.scan(i), drive.sensor.mount_height_m)
    )
    return np.fromiter(found, dtype=np.int64)


def _drive(
    path: tuple[World, tuple[int, ...]], session: int, lidar: Lidar, now: Conditions
) -> SimulatedSequence:
    made, junctions = path
    route = Route(junctions, 1.1 if session == 0 else 0.3, length_m=PATH_M)
    return simulate_session(made, session, route, lidar, TOWN_SEED, conditions=now)


SETS = {
    "single": Set(partial(kitti, "single", 10, 10), "kitti00"),
    "accumulated": Set(partial(kitti, "accumulated", 2, 6), "kitti00", ("gathered",)),
    "kitti-cloud": Set(partial(kitti, "single", 10, 10), "kitti00", ("cloud",), 1.73),
    "corridor": Set(corridor, "vlp16_corridor", ("indoors",)),
    "corridor-cloud": Set(corridor, "vlp16_corridor", ("indoors", "cloud")),
    "grand-loop": Set(grand_loop, "utd_grand_loop", ("cloud",)),
    "lab": Set(lab, "mid360_lab", ("indoors",)),
    "town": Set(town, None, ("beside",)),
    "forest": Set(partial(world, "forest", WORLD_SEED)),
    "warehouse": Set(partial(world, "warehouse", WORLD_SEED), None, ("indoors",)),
    "offices": Set(partial(world, "offices", WORLD_SEED), None, ("indoors",)),
}
"""KITTI 00 by single scans and by 40 m of scans gathered; halls and a corridor of a VLP-16, driven
back; a finished cloud of campus streets, and scans of months later; a lab of a MID-360 on other
days; simulated worlds. In ``-cloud`` and ``grand-loop`` the map is one cloud."""
