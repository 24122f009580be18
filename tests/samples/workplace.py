"""A folder with all that the commands of the documents name: recordings, maps, poses; all tiny."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from segloc import Config, build_map, geometry
from segloc.tools.io import Trajectory, write_tum
from segloc.tools.io.scans import write_scan
from segloc.types import Float64, Scan

from .plaza import Plaza, PlazaSequence
from .storey import storey, write_stl

FOLDERS = (
    "monday",
    "tuesday",
    "friday",
    "saturday",
    "drive",
    "MONDAY",
    "TUESDAY",
    "RUN",
    "my_scans",
)
BAGS = ("monday.bag", "tuesday.bag", "wednesday.bag", "thursday.bag", "drive.bag")
SCANS, STEP_M, MOST = 9, 1.5, 24_000


def walk(begin: float = -6.0) -> PlazaSequence:
    """A short walk across the plaza, straight on."""
    steps = PlazaSequence(Plaza(1, objects=90), steps=SCANS)
    steps.poses = np.stack(
        [geometry.yaw_transform(0.02 * k, (begin + STEP_M * k, 1.0, 1.8)) for k in range(SCANS)]
    )
    return steps


def points_of(walked: PlazaSequence, i: int) -> Float64:
    seen = walked.scan(i).points.astype(np.float64)
    return seen[np.random.default_rng(i).permutation(len(seen))[:MOST]]


class Few(PlazaSequence):
    """A walk with fewer points a scan."""

    def scan(self, i: int) -> Scan:
        seen = super().scan(i)
        few = np.random.default_rng(i).permutation(len(seen.points))[:MOST]
        return Scan(seen.points[few], stamp=seen.stamp, T_odom_sensor=seen.T_odom_sensor)


def furnish(root: Path) -> Path:
    """Fill a folder with recordings as folders and bags, poses, a scan and a map."""
    for k, name in enumerate(FOLDERS):
        _folder(root / name, walk(-6.0 + 0.2 * k))
    for k, name in enumerate(BAGS):
        _bag(root / name, walk(-6.0 + 0.2 * k))
    first = walk()
    _kitti(root / "dataset", first)
    _mcap(root / "drive.mcap", first)
    timed = Trajectory(10.25 + np.arange(SCANS), first.poses)
    for name in ("monday", "tuesday", "thursday", "truth"):
        write_tum(root / f"{name}.tum", timed)
    saturday = walk(-6.0 + 0.2 * FOLDERS.index("saturday"))
    write_tum(root / "saturday.tum", Trajectory(np.arange(SCANS), saturday.poses))
    write_scan(root / "scan.pcd", points_of(first, 4))
    points = Plaza(1, objects=90).points
    write_scan(root / "cloud.pcd", points)
    (root / "submaps").mkdir()
    for name, part in zip(("north", "south"), np.array_split(points, 2), strict=True):
        write_scan(root / f"{name}.pcd", part)
        write_scan(root / "submaps" / f"{name}.pcd", part - [5.0, 0.0, 0.0])
    T = geometry.yaw_transform(0.0, (5.0, 0.0, 0.0))
    write_tum(root / "submaps.tum", Trajectory(np.arange(2), np.stack([T, T])))
    write_stl(root / "plan.stl", storey(3))
    build_map(_few(first), Config.preset("profile")).save(root / "site.segmap")
    return root


def _few(walked: PlazaSequence) -> Few:
    made = Few(Plaza(1, objects=90), steps=SCANS)
    made.poses = walked.poses
    return made


def _folder(folder: Path, walked: PlazaSequence) -> None:
    folder.mkdir()
    for i in range(SCANS):
        np.save(folder / f"{i:04d}.npy", points_of(walked, i).astype(np.float32))
    numbers = np.arange(SCANS)
    for name in ("poses", "odometry", "truth"):
        write_tum(folder / f"{name}.tum", Trajectory(numbers, walked.poses))


def _bag(file: Path, walked: PlazaSequence) -> None:
    from .bags import BagWriter

    bag = BagWriter("ros1")
    for i in range(SCANS):
        bag.cloud("/points", 10.25 + i, points_of(walked, i))
    bag.write(file)


def _mcap(folder: Path, walked: PlazaSequence) -> None:
    from .bags import BagWriter

    bag = BagWriter("mcap")
    for i in range(SCANS):
        bag.cloud("/ouster/points", 10.25 + i, points_of(walked, i))
        bag.odometry("/odom", 10.25 + i, walked.poses[i], "lidar")
    bag.write(folder)


T_CAMERA_SENSOR = np.array([[0.0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]])


def _kitti(root: Path, walked: PlazaSequence) -> None:
    """The layout of KITTI odometry; poses are those of a camera in the place of the sensor."""
    sequence = root / "sequences" / "00"
    (sequence / "velodyne").mkdir(parents=True)
    (root / "poses").mkdir()
    for i in range(SCANS):
        points = np.column_stack([points_of(walked, i), np.zeros(MOST)]).astype("<f4")
        points.tofile(sequence / "velodyne" / f"{i:06d}.bin")
    rows = " ".join(f"{value:.9e}" for value in T_CAMERA_SENSOR[:3].reshape(-1))
    (sequence / "calib.txt").write_text(f"Tr: {rows}\n")
    (sequence / "times.txt").write_text("".join(f"{0.1 * i:.6e}\n" for i in range(SCANS)))
    first = geometry.inverse(walked.poses[0])
    poses = T_CAMERA_SENSOR @ (first @ walked.poses) @ geometry.inverse(T_CAMERA_SENSOR)
    lines = (" ".join(f"{value:.9e}" for value in T[:3].reshape(-1)) for T in poses)
    (root / "poses" / "00.txt").write_text("\n".join(lines) + "\n")
