"""Run by ``make wheel-check`` in an environment that holds the wheel and nothing else.

    python wheel_smoke.py             # the methods that segloc brings the weights of
    python wheel_smoke.py METHOD...   # these; others come with segloc-lab

Scans and maps go through files: a recording as KITTI stores it, and a real scan of KITTI where one
lies in ../shared. The sample is part of the wheel.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import numpy as np
from samples.plaza import Plaza, PlazaSequence

import segloc
from segloc import (
    Config,
    Localizer,
    SegmentMap,
    WeightsError,
    build_map,
    geometry,
    open_sequence,
    sample,
)
from segloc.descriptors import create
from segloc.tools.io import read_scan, write_scan

METHODS = ("profile", "geo", "dsm", "dsm-fq", "esm")
WITH_EXPERIMENTS = ("segmap", "segmatch-eigen", "segmatch-esf", "nsm")
HEAVY = ("torch", "matplotlib", "trimesh", "embreex", "rosbags", "rclpy", "viser", "open3d")
REAL = Path(__file__).resolve().parents[2] / "shared" / "data" / "formats" / "kitti_000000.bin"

Pose = np.ndarray


def write_float4(path: Path, points: np.ndarray) -> None:
    """As KITTI's and most loggers' ``velodyne_points``: x, y, z, reflectance in little endian."""
    columns = np.zeros((len(points), 4), "<f4")
    columns[:, :3] = points
    path.write_bytes(columns.tobytes())


def recording(folder: Path, scans: list[np.ndarray], poses: Pose) -> Path:
    """A folder of scans with KITTI's poses, rows of 3 x 4 numbers."""
    folder.mkdir(parents=True)
    for number, points in enumerate(scans):
        write_float4(folder / f"{number:06d}.bin", points)
    np.savetxt(folder / "poses.txt", poses[:, :3].reshape(len(poses), 12))
    return folder


def check(method: str, mapped: Path, query: Path, truth: Pose, folder: Path) -> None:
    """A scan is found in the map of a recording; everything comes from files."""
    path = folder / f"{method}.segmap"
    build_map(open_sequence(mapped, "poses.txt"), Config.preset(method)).save(path)
    result = Localizer(SegmentMap.load(path)).localize(read_scan(query))
    assert result.localized and result.T_map_sensor is not None, f"{method}: {result.reason}"
    assert np.abs(result.T_map_sensor - truth).max() < 0.1, method


def plaza(folder: Path) -> tuple[Path, Path, Pose]:
    """A recording of a square, and a scan taken elsewhere in it as a PCD file."""
    square = Plaza(0)
    walk = PlazaSequence(square, steps=5)
    scans = [walk.scan(k).points for k in range(5)]
    truth = geometry.yaw_transform(1.0, (-7.0, -2.0, 1.7))
    points = square.scan(truth, posed=False, seed=77).points
    write_scan(folder / "query.pcd", points)
    assert np.array_equal(read_scan(folder / "query.pcd").points, points)
    return recording(folder / "plaza", scans, walk.poses), folder / "query.pcd", truth


def real(folder: Path) -> tuple[Path, Path, Pose]:
    """A map of half of the points of a real scan; the other half, turned, is to be found in it."""
    points = read_scan(REAL).points
    truth = geometry.yaw_transform(2.0, (0.0, 0.0, 1.73))
    turned = geometry.transform(geometry.inverse(truth), points[1::2] + [0.0, 0.0, 1.73])
    write_float4(folder / "query.bin", turned)
    pose = geometry.yaw_transform(0.0, (0.0, 0.0, 1.73))
    return recording(folder / "street", [points[::2]], pose[None]), folder / "query.bin", truth


def check_sample() -> None:
    """Find a scan of Tuesday in the map of Monday, and none of another town."""
    localizer = Localizer(build_map(sample.load("monday"), Config()))
    tuesday = sample.load("tuesday")
    found = localizer.localize(tuesday.scan(20))
    assert found.T_map_sensor is not None, found.message
    assert np.abs(found.T_map_sensor - tuesday.truth[20]).max() < 0.2
    assert not localizer.localize(sample.load("elsewhere").scan(0)).localized


def refuses(method: str) -> None:
    """A method for comparison names the package of its weights."""
    try:
        _ = create(method).pruner
    except WeightsError as error:
        assert "segloc-lab" in str(error), error
    else:
        raise AssertionError(f"{method}: its weights are not meant to be part of the wheel")


methods = sys.argv[1:] or METHODS
with tempfile.TemporaryDirectory() as name:
    scenes = [plaza(Path(name))] + ([real(Path(name))] if REAL.is_file() else [])
    for method in methods:
        for scene in scenes:
            check(method, *scene, Path(name))
if not sys.argv[1:]:
    check_sample()
    for method in WITH_EXPERIMENTS:
        refuses(method)
for heavy in HEAVY:
    assert heavy not in sys.modules, heavy
print(f"segloc {segloc.__version__}: {len(scenes)} scenes, {', '.join(methods)}")
