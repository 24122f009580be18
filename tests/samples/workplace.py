"""A folder with all that the commands of the documents name: recordings, maps, poses; all tiny."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from segloc import Config, build_map, geometry
from segloc.tools.io import Trajectory, write_tum
from segloc.tools.io.scans import write_scan
from segloc.types import Float32, Scan

from .datasets import START, kitti
from .plaza import Plaza, PlazaSequence
from .storey import storey, write_stl

FOLDERS = ("monday", "tuesday", "friday", "saturday", "drive", "MONDAY", "TUESDAY", "my_scans")
BAGS = ("tuesday.bag", "drive.bag")
SCANS, STEP_M, MOST = 9, 1.5, 24_000


class Steps(PlazaSequence):
    """A short walk across the plaza, straight on, with few points a scan."""

    def __init__(self, begin: float = -6.0) -> None:
        super().__init__(Plaza(1, objects=90), steps=SCANS)
        way = [(begin + STEP_M * k, 1.0, 1.8) for k in range(SCANS)]
        self.poses = np.stack([geometry.yaw_transform(0.02 * k, at) for k, at in enumerate(way)])

    def scan(self, i: int) -> Scan:
        seen = super().scan(i)
        few = np.random.default_rng(i).permutation(len(seen.points))[:MOST]
        return Scan(seen.points[few], stamp=seen.stamp, T_odom_sensor=seen.T_odom_sensor)

    def seen(self, i: int) -> Float32:
        """Points of a scan."""
        return self.scan(i).points


def furnish(root: Path) -> Path:
    """Fill a folder with recordings as folders and bags, poses, a scan and a map."""
    for k, name in enumerate(FOLDERS):
        _folder(root / name, Steps(-6.0 + 0.2 * k))
    for k, name in enumerate(BAGS):
        _bag(root / name, Steps(-6.0 + 0.2 * k))
    first = Steps()
    first.stamps = START + 0.1 * first.indices
    kitti(root / "dataset", first)
    _mcap(root / "drive.mcap", first)
    timed = Trajectory(10.25 + np.arange(SCANS), first.poses)
    for name in ("monday", "tuesday", "truth"):
        write_tum(root / f"{name}.tum", timed)
    saturday = Steps(-6.0 + 0.2 * FOLDERS.index("saturday"))
    write_tum(root / "saturday.tum", Trajectory(np.arange(SCANS), saturday.poses))
    write_scan(root / "scan.pcd", first.seen(4))
    points = Plaza(1, objects=90).points
    points = points[np.hypot(points[:, 0], points[:, 1]) < 25.0]
    write_scan(root / "cloud.pcd", points)
    (root / "submaps").mkdir()
    for name, part in zip(("north", "south"), np.array_split(points, 2), strict=True):
        write_scan(root / f"{name}.pcd", part)
        write_scan(root / "submaps" / f"{name}.pcd", part - [5.0, 0.0, 0.0])
    T = geometry.yaw_transform(0.0, (5.0, 0.0, 0.0))
    write_tum(root / "submaps.tum", Trajectory(np.arange(2), np.stack([T, T])))
    write_stl(root / "plan.stl", storey(3))
    build_map(first, Config.preset("profile")).save(root / "site.segmap")
    return root


def _folder(folder: Path, walked: Steps) -> None:
    folder.mkdir()
    for i in range(SCANS):
        np.save(folder / f"{i:04d}.npy", walked.seen(i))
    numbers = np.arange(SCANS)
    for name in ("poses", "odometry", "truth"):
        write_tum(folder / f"{name}.tum", Trajectory(numbers, walked.poses))


def _bag(file: Path, walked: Steps) -> None:
    from .bags import BagWriter

    bag = BagWriter("ros1")
    for i in range(SCANS):
        bag.cloud("/points", 10.25 + i, walked.seen(i))
    bag.write(file)


def _mcap(folder: Path, walked: Steps) -> None:
    from .bags import BagWriter

    bag = BagWriter("mcap")
    for i in range(SCANS):
        bag.cloud("/ouster/points", 10.25 + i, walked.seen(i))
        bag.odometry("/odom", 10.25 + i, walked.poses[i], "lidar")
    bag.write(folder)
