"""Write the queries of all systems, and the clouds that their maps are made of.

Views of the map come in three lengths, and every system may take what suits it: ``long`` gathers
the scans of 40 m around a pose, ``short`` those of 16 m, ``scan`` is a scan alone. The views of a
finished cloud are what is visible in it from the viewpoints that segloc chooses on free ground; the
cloud itself lies beside them.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from segloc import Config, SegmentMap, geometry
from segloc.frontend import Accumulator, LocalCloudConfig, window
from segloc.map import ThinCloud
from segloc.system import kernels
from segloc.tools.batch import distances_to_path
from segloc.types import Float64, LocalCloud, Recording

from .. import kitti00
from ..protocols.accuracy import VOXEL_M, Reference
from ..recordings import Cached, posed
from .exchange import Clouds, Gathering
from .sets import Group, Set

VIEWS_M = {"long": 40.0, "short": 16.0, "scan": 0.0}
VIEW_EVERY_M = {"long": 8.0, "short": 8.0, "scan": 2.0}
LOCAL = LocalCloudConfig(radius_m=80.0)
THIN_M = 0.1
WINDOW = 64
"""Scans that are kept in memory: windows overlap."""


def export(folder: Path, chosen: Set, data: Path, every: int) -> None:
    """Write a set: the views of its map, its path, and every N-th query."""
    material = chosen.make(data)
    folder.mkdir(parents=True, exist_ok=True)
    path = kitti00.poses_of(material.mapped)
    if chosen.is_cloud:
        write_cloud(material.mapped, folder, chosen.sensor_height_m)
    else:
        for name, length in VIEWS_M.items():
            found = views(Cached(material.mapped, WINDOW), length, VIEW_EVERY_M[name])
            found.save(folder / f"views-{name}.npz")
    np.save(folder / "path.npy", path)
    gathering = Gathering()
    for group in material.groups:
        add(gathering, group.thinned(every), path, material.coverage_m)
    queries = gathering.clouds()
    if material.is_approximate:
        queries = aligned(queries, Clouds.load(folder / "views-scan.npz"))
    queries.save(folder / "queries.npz")


def add(found: Gathering, group: Group, path: Float64, coverage_m: float) -> None:
    """Add the queries of a group, gathered ones in a level frame."""
    near = distances_to_path(group.truths, path) <= coverage_m
    recording = Cached(group.recording, WINDOW)
    for i, truth, inside in zip(group.positions.tolist(), group.truths, near, strict=True):
        if not group.gathered:
            found.add(recording.scan(i).points, truth, 1, bool(inside), group.name)
            continue
        cloud = gathered(recording, i, VIEWS_M["long"], centred=False)
        T_map_local = truth @ geometry.inverse(cloud.T_local_sensor)
        found.add(cloud.points, T_map_local, cloud.num_scans, bool(inside), group.name)


def gathered(recording: Recording, i: int, length_m: float, *, centred: bool) -> LocalCloud:
    """The scans around or behind one of a recording, thinned."""
    poses = kitti00.poses_of(recording)
    scans = window(poses, i, length_m, centred=centred, max_gap_m=LOCAL.max_gap_m)
    cloud = Accumulator(LOCAL).gather([recording.scan(k) for k in scans], i - scans.start)
    return replace(cloud, points=kernels.voxel_grid(cloud.points, THIN_M))


def views(recording: Recording, length_m: float, every_m: float) -> Clouds:
    """Clouds along the path of a map, each with its (level) pose."""
    poses = kitti00.poses_of(recording)
    travelled = geometry.distance_travelled(poses)
    marks = np.arange(0.0, travelled[-1] + 1e-9, every_m)
    found = Gathering()
    for i in np.unique(np.searchsorted(travelled, marks - 1e-9)).tolist():
        cloud = gathered(recording, i, length_m, centred=True)
        found.add(cloud.points, geometry.levelled(poses[i]), cloud.num_scans)
    return found.clouds()


def write_cloud(recording: Recording, folder: Path, sensor_height_m: float) -> None:
    """Write all scans as one cloud, and the views from segloc's viewpoints in it."""
    points = np.concatenate(list(posed(recording)))
    np.savez(folder / "cloud.npz", points=points, sensor_height_m=sensor_height_m)
    prior_map = SegmentMap.from_cloud(points, Config(threads=1), sensor_height=sensor_height_m)
    cloud, found = ThinCloud.of(points), Gathering()
    for T in prior_map.trajectory:
        eye, seen = cloud.view_from(T[:3, 3] - cloud.origin, LOCAL.radius_m)
        found.add(seen - eye.astype(np.float32), T, 2)
    found.clouds().save(folder / "views-scan.npz")


def aligned(queries: Clouds, views: Clouds) -> Clouds:
    """Return the queries with poses aligned with the map where two starts end at one pose."""
    origin = views.poses[0, :3, 3]
    parts = [geometry.transform(T, views[i]) - origin for i, T in enumerate(views.poses)]
    cloud = kernels.voxel_grid(np.concatenate(parts).astype(np.float32), VOXEL_M)
    reference = Reference(cloud, origin)
    poses = queries.poses.copy()
    for q in np.flatnonzero(queries.within_coverage).tolist():
        T = reference.pose(queries[q], poses[q])
        if T is not None:
            poses[q] = T
    return replace(queries, poses=poses)
