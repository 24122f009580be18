"""Write the queries of all systems, and the clouds that their maps are made of.

Views of the map come in three lengths, and every system may take what suits it: ``long`` gathers
the scans of 40 m around a pose, ``short`` those of 16 m, ``scan`` is a scan alone.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np

from segloc import geometry
from segloc.batch import COVERAGE_RADIUS_M, distances_to_path
from segloc.datasets import Recording
from segloc.frontend import Accumulator, LocalCloudConfig, window
from segloc.system import kernels
from segloc.types import Float64, LocalCloud

from .. import kitti00
from ..protocols.accuracy import VOXEL_M, Reference
from ..recordings import beside, has_room
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
from .exchange import Clouds, Gathering

VIEWS_M = {"long": 40.0, "short": 16.0, "scan": 0.0}
VIEW_EVERY_M = {"long": 8.0, "short": 8.0, "scan": 2.0}
LOCAL = LocalCloudConfig(radius_m=80.0)
THIN_M = 0.1
OFFSETS_M = (0.0, 5.0, 10.0, 15.0)
PATH_M, WORLD_M = 240.0, {"town": 260.0, "park": 240.0}
CHANGED = Conditions(foliage=0.2, replaced=0.2, scaffolding=0.1)

# --- maps and clouds ------------------------------------------------------------------------------


def gathered(recording: Recording, i: int, length_m: float, *, centred: bool) -> LocalCloud:
    """The scans around or behind one of a recording, thinned."""
    poses = kitti00.poses_of(recording)
    scans = window(poses, i, length_m, centred=centred, max_gap_m=LOCAL.max_gap_m)
    cloud = Accumulator(LOCAL).gather([recording.scan(k) for k in scans], i - scans.start)
    return replace(cloud, points=kernels.voxel_grid(cloud.points, THIN_M))


def views(recording: Recording, length_m: float, every_m: float) -> Clouds:
    """Clouds along the path of a map, each with its (level) pose."""
    poses = kitti00.poses_of(recording)
    travelled = geometry.travelled(poses)
    marks = np.arange(0.0, travelled[-1] + 1e-9, every_m)
    found = Gathering()
    for i in np.unique(np.searchsorted(travelled, marks - 1e-9)).tolist():
        cloud = gathered(recording, i, length_m, centred=True)
        found.add(cloud.points, geometry.levelled(poses[i]), cloud.num_scans)
    return found.clouds()


class Cached:
    """A recording that keeps the scans of a window in memory."""

    def __init__(self, recording: Recording) -> None:
        self.name, self.indices, self.poses = recording.name, recording.indices, recording.poses
        self.stamps = recording.stamps
        self.scan = lru_cache(64)(recording.scan)

    def __len__(self) -> int:
        return len(self.indices)


def write_map(recording: Recording, folder: Path) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    for name, length in VIEWS_M.items():
        clouds = views(Cached(recording), length, VIEW_EVERY_M[name])
        clouds.save(folder / f"views-{name}.npz")


def add_accumulated(
    found: Gathering, recording: Recording, positions: list[int], path: Float64, group: str = "all"
) -> None:
    """Queries of the 40 m behind a scan, in a level frame, as a robot has them."""
    poses = kitti00.poses_of(recording)
    near = distances_to_path(poses, path) <= COVERAGE_RADIUS_M
    for i in positions:
        cloud = gathered(recording, i, VIEWS_M["long"], centred=False)
        T_map_local = poses[i] @ geometry.inverse(cloud.T_local_sensor)
        found.add(cloud.points, T_map_local, cloud.num_scans, bool(near[i]), group)


# --- the protocols on real scans ------------------------------------------------------------------


def kitti(data: Path, folder: Path, protocol: str, every: int) -> None:
    """One of the three protocols of KITTI 00 (see ``protocols/kitti00.sh``).

    Its ground truth agrees from pass to pass to about a metre only: queries within map coverage are
    aligned with the map (see ``protocols/accuracy.py``) where two starts end at the same pose.
    """
    prior_map = kitti00.mapped(data, protocol)
    queries = kitti00.query_set(data, protocol, every)
    path, truths, found = kitti00.poses_of(prior_map), queries.truths, Gathering()
    assert truths is not None
    if protocol == "accumulated":
        add_accumulated(found, Cached(queries.recording), queries.positions.tolist(), path)
    else:
        near = distances_to_path(truths, path) <= COVERAGE_RADIUS_M
        for i, truth, inside in zip(queries.positions.tolist(), truths, near, strict=True):
            found.add(queries.recording.scan(i).points, truth, 1, bool(inside))
    write_map(prior_map, folder)
    registered(found.clouds(), Clouds.load(folder / "views-scan.npz")).save(folder / "queries.npz")


def registered(queries: Clouds, views: Clouds) -> Clouds:
    """Return the queries with poses aligned with the map that the views make up."""
    origin = views.poses[0, :3, 3]
    parts = [geometry.transform(T, views[i]) - origin for i, T in enumerate(views.poses)]
    cloud = kernels.voxel_grid(np.concatenate(parts).astype(np.float32), VOXEL_M)
    reference = Reference(cloud, origin)
    poses = queries.poses.copy()
    for q in np.flatnonzero(queries.within_coverage).tolist():
        aligned = reference.pose(queries[q], poses[q])
        if aligned is not None:
            poses[q] = aligned
    return replace(queries, poses=poses)


# --- the protocols on simulated scans -------------------------------------------------------------


def add_scans(found: Gathering, drive: SimulatedSequence, every: int, group: str) -> None:
    """Queries of a single scan without its pose, wherever there is room for a sensor."""
    for i in range(every // 2, len(drive), every):
        scan = drive.scan(i)
        if has_room(scan, drive.sensor.mount_height_m):
            found.add(
                scan.points, drive.truth[i], within_coverage=group != "elsewhere", group=group
            )


def simulated(folder: Path, scene: str, every: int, seed: int = 8000) -> None:
    """A simulated world mapped, then seen from beside, in the opposite direction, and changed."""
    paths = []
    for number in (seed, seed + 1000):
        world = SCENES[scene](number, size_m=WORLD_M[scene])
        paths.append((world, tuple(mapped_way(world, np.random.default_rng([number, 31]), PATH_M))))
    (here, there), lidar = paths, hdl64e(900)
    prior_map = drive_along(here, 0, lidar, seed, Conditions())
    again = drive_along(here, 1, lidar, seed, Conditions(replaced=0.1))
    write_map(prior_map, folder)
    found = Gathering()
    for offset, side in offsets():
        add_scans(found, beside(again, again.truth, side), every, f"{offset:g} m beside")
    add_scans(found, beside(again, again.truth, 3.0, turned=True), every, "opposite direction")
    later = drive_along(here, 2, lidar, seed, CHANGED)
    add_scans(found, later, every, "changed")
    add_scans(found, drive_along(there, 0, lidar, seed, Conditions()), every // 4, "elsewhere")
    found.clouds().save(folder / "queries.npz")


def offsets() -> Iterator[tuple[float, float]]:
    for offset in OFFSETS_M:
        for side in sorted({offset, -offset}):
            yield offset, side


def drive_along(
    path: tuple[World, tuple[int, ...]], session: int, lidar: Lidar, seed: int, now: Conditions
) -> SimulatedSequence:
    world, junctions = path
    route = Route(junctions, 1.1 if session == 0 else 0.3, length_m=PATH_M)
    return simulate_session(world, session, route, lidar, seed, conditions=now)
