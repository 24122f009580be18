"""Write the queries that all systems are asked, and the clouds that their maps are made of.

    python benchmarks/peers/export.py OUT accumulated sparse single --data KITTI00
    python benchmarks/peers/export.py OUT town park

Views of the map come in three lengths, and every system may take what suits it: ``long`` gathers
the scans of 40 m around a pose, ``short`` those of 16 m, ``scan`` is a scan alone.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np

from segloc import _native, geometry
from segloc.batch.run import query_positions
from segloc.batch.score import COVERAGE_RADIUS_M, distances_to_path
from segloc.datasets import Recording, Sequence, open_sequence
from segloc.local_cloud import Accumulator, LocalCloudConfig, window
from segloc.simulation import SCENES, Conditions, Route, SimulatedSequence, hdl64e, simulate_session
from segloc.simulation.drives import mapped_way
from segloc.simulation.motion.paths import on_ground
from segloc.types import Float64, LocalCloud, Scan

from .exchange import Clouds, Gathering

VIEWS_M = {"long": 40.0, "short": 16.0, "scan": 0.0}
VIEW_EVERY_M = {"long": 8.0, "short": 8.0, "scan": 2.0}
LOCAL = LocalCloudConfig(radius_m=80.0)
THIN_M = 0.1
OFFSETS_M = (0.0, 5.0, 10.0, 15.0)
WAY_M, WORLD_M, ROOM_M = 240.0, {"town": 260.0, "park": 240.0}, 1.5
CHANGED = Conditions(foliage=0.2, replaced=0.2, scaffolding=0.1)


# --- maps and clouds ------------------------------------------------------------------------------


def gathered(recording: Recording, i: int, length_m: float, *, centred: bool) -> LocalCloud:
    """The scans around or behind one of a recording, thinned."""
    scans = window(recording.poses, i, length_m, centred=centred, max_gap_m=LOCAL.max_gap_m)
    cloud = Accumulator(LOCAL).gather([recording.scan(k) for k in scans], i - scans.start)
    return replace(cloud, points=_native.voxel_grid(cloud.points, THIN_M))


def views(recording: Recording, length_m: float, every_m: float) -> Clouds:
    """Clouds along the way of a map, each with its (level) pose."""
    way = geometry.travelled(recording.poses)
    marks = np.arange(0.0, way[-1] + 1e-9, every_m)
    found = Gathering()
    for i in np.unique(np.searchsorted(way, marks - 1e-9)).tolist():
        cloud = gathered(recording, i, length_m, centred=True)
        found.add(cloud.points, geometry.levelled(recording.poses[i]), cloud.num_scans)
    return found.clouds()


class Cached:
    """A recording that keeps the scans of a window in memory."""

    def __init__(self, recording: Recording) -> None:
        self.name, self.indices, self.poses = recording.name, recording.indices, recording.poses
        self.scan = lru_cache(64)(recording.scan)

    def __len__(self) -> int:
        return len(self.indices)


def write_map(recording: Recording, folder: Path) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    for name, length in VIEWS_M.items():
        clouds = views(Cached(recording), length, VIEW_EVERY_M[name])
        clouds.save(folder / f"views-{name}.npz")
        print(f"{folder.name}: {len(clouds)} views {name}", flush=True)


def add_accumulated(
    found: Gathering, recording: Recording, positions: list[int], path: Float64, group: str = "all"
) -> None:
    """Queries of the 40 m behind a scan, in a level frame, as a robot has them."""
    near = distances_to_path(recording.poses, path) <= COVERAGE_RADIUS_M
    for i in positions:
        cloud = gathered(recording, i, VIEWS_M["long"], centred=False)
        T_map_local = recording.poses[i] @ geometry.inverse(cloud.T_local_sensor)
        found.add(cloud.points, T_map_local, cloud.num_scans, bool(near[i]), group)


# --- the protocols on real scans ------------------------------------------------------------------


def kitti(data: Path, out: Path, protocol: str, every: int) -> None:
    """One of the three protocols of KITTI 00 (see docs/results.md)."""
    mapped, asked, folder = {
        "accumulated": ("100:947", "948:1820", "keyframes"),
        "sparse": ("100:947", "948:1820", "keyframes"),
        "single": ("619:654,988:1003,1361:1600", ":", "scans"),
    }[protocol]
    prior_map = open_sequence(data / "keyframes", "keyframes.tum", mapped)
    selection = None if asked == ":" else asked
    drive: Sequence = open_sequence(data / folder, f"{folder}.tum", selection)
    positions = list(range(len(drive)))
    if protocol != "single":
        positions = query_positions(drive.poses, 10.0, LOCAL.max_gap_m).tolist()
    positions, found = positions[::every], Gathering()
    if protocol == "accumulated":
        add_accumulated(found, Cached(drive), positions, prior_map.poses)
    else:
        near = distances_to_path(drive.poses, prior_map.poses) <= COVERAGE_RADIUS_M
        for i in positions:
            found.add(drive.scan(i).points, drive.poses[i], 1, bool(near[i]))
    write_map(prior_map, out / protocol)
    found.clouds().save(out / protocol / "queries.npz")


# --- the protocols on simulated scans -------------------------------------------------------------


def beside(drive: SimulatedSequence, offset_m: float, turned: bool = False) -> SimulatedSequence:
    """The session seen from so many metres to the left of its way, perhaps the other way round."""
    shift = geometry.yaw_transform(np.pi if turned else 0.0, (0.0, offset_m, 0.0))
    moved = np.stack([T @ shift for T in drive.truth])
    yaw = np.array([geometry.heading(T) for T in moved])
    poses = on_ground(drive.world.terrain, moved[:, :2, 3], yaw, drive.sensor.mount_height_m)
    return replace(drive, truth=poses, poses=poses, _last=None)


def has_room(scan: Scan, mount_height_m: float) -> bool:
    """Whether nothing stands where the sensor does."""
    x, y, z = scan.points.T
    near = (x**2 + y**2 < ROOM_M**2) & (z > 0.4 - mount_height_m)
    return len(scan) > 1000 and not near.any()


def add_scans(found: Gathering, drive: SimulatedSequence, every: int, group: str) -> None:
    """Queries of a single scan without its pose, wherever there is room for a sensor."""
    for i in range(every // 2, len(drive), every):
        scan = drive.scan(i)
        if has_room(scan, drive.sensor.mount_height_m):
            found.add(scan.points, drive.truth[i], has_place=group != "elsewhere", group=group)


def simulated(out: Path, scene: str, every: int, seed: int = 8000) -> None:
    """A simulated world mapped, then seen from beside, the other way round, and changed."""
    way = []
    for number in (seed, seed + 1000):
        world = SCENES[scene](number, size_m=WORLD_M[scene])
        way.append((world, tuple(mapped_way(world, np.random.default_rng([number, 31]), WAY_M))))
    (here, there), lidar = way, hdl64e(900)
    prior_map = drive_along(here, 0, lidar, seed, Conditions())
    again = drive_along(here, 1, lidar, seed, Conditions(replaced=0.1))
    write_map(prior_map, out / scene)
    found = Gathering()
    for offset, side in offsets():
        add_scans(found, beside(again, side), every, f"{offset:g} m beside")
    add_scans(found, beside(again, 3.0, turned=True), every, "opposite direction")
    later = drive_along(here, 2, lidar, seed, CHANGED)
    add_scans(found, later, every, "changed")
    add_scans(found, drive_along(there, 0, lidar, seed, Conditions()), every // 4, "elsewhere")
    found.clouds().save(out / scene / "queries.npz")


def offsets() -> Iterator[tuple[float, float]]:
    for offset in OFFSETS_M:
        for side in sorted({offset, -offset}):
            yield offset, side


def drive_along(
    way: tuple[object, tuple[int, ...]], session: int, lidar: object, seed: int, now: Conditions
) -> SimulatedSequence:
    world, junctions = way
    route = Route(junctions, 1.1 if session == 0 else 0.3, length_m=WAY_M)
    return simulate_session(world, session, route, lidar, seed, conditions=now)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("out", type=Path)
    parser.add_argument("protocols", nargs="+", help="accumulated, sparse, single, town, park")
    parser.add_argument("--data", type=Path, help="folder of KITTI 00, for the first three")
    parser.add_argument("--every", type=int, default=1, help="keep every so many real queries")
    parser.add_argument("--step", type=int, default=8, help="simulated scans between queries")
    options = parser.parse_args()
    for protocol in options.protocols:
        if protocol in WORLD_M:
            simulated(options.out, protocol, options.step)
        elif options.data is None:
            parser.error(f"{protocol} needs --data")
        else:
            kitti(options.data, options.out, protocol, options.every)


if __name__ == "__main__":
    main()
