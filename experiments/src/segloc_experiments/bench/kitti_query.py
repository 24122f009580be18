"""A whole query on KITTI odometry 00: one full scan of an earlier pass in a map of later passes.

    python benchmarks/bench_query.py KITTI00 [--methods profile,geo] [--segments 0,50000,1000000]

KITTI00 holds ``keyframes/`` (thinned), ``scans/`` (full) and their poses (``*.tum``). The map is
built of keyframes and padded with perturbed copies of itself; 0 is the map as it is.
"""

import argparse
import pickle
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from segloc import Config, Scan, _native, build_map, geometry
from segloc.datasets import Sequence, open_sequence
from segloc.local_cloud import Accumulator, LocalCloudConfig, window
from segloc.system import processor
from segloc.types import LocalCloud

from .harness import Row, in_process
from .query import Scene, query_row
from .rows import show

MAPPED = "619:654,988:1003,1361:1600"
NEAR_M = 3.0
THIN_M = 0.2


def kitti_scene(folder: Path, method: str, queries: int, accumulated: bool = False) -> Scene:
    """The map of the later passes, and full scans of the first one that lie on its way."""
    keyframes = open_sequence(folder / "keyframes", Path("keyframes.tum"), MAPPED)
    scans = open_sequence(folder / "scans", Path("scans.tum"))
    prior_map = build_map(keyframes, Config.preset(method).model_copy(update={"threads": 1}))
    distance, nearest = cKDTree(keyframes.poses[:, :3, 3]).query(scans.poses[:, :3, 3])
    within_coverage = np.flatnonzero(distance < NEAR_M)
    chosen = within_coverage[np.linspace(0, len(within_coverage) - 1, queries).astype(int)]
    clouds = [gathered(scans, k) if accumulated else alone(scans, k) for k in chosen]
    mapped = keyframes.scan(int(nearest[chosen[0]]))
    return Scene(prior_map, list(zip(clouds, scans.poses[chosen], strict=True)), mapped)


def alone(scans: Sequence, k: int) -> Scan:
    """One scan, without its pose."""
    return Scan(scans.scan(k).points, stamp=float(scans.indices[k]))


def gathered(scans: Sequence, k: int) -> LocalCloud:
    """The scans of 40 m around one, thinned."""
    config = LocalCloudConfig()
    near = window(scans.poses, k, config.window_m, centred=True, max_gap_m=config.max_gap_m)
    cloud = Accumulator(config).gather([scans.scan(i) for i in near], k - near.start)
    return replace(cloud, points=_native.voxel_grid(cloud.points, THIN_M))


def export(folder: Path, scene: Scene, file: Path) -> None:
    """Write the map's views and the queries for methods that live elsewhere (``peers/``)."""
    config = Config()
    keyframes = open_sequence(folder / "keyframes", Path("keyframes.tum"), MAPPED)
    accumulator, poses = Accumulator(config.local_cloud), keyframes.poses
    view = config.mapping.views[0]
    arrays = {}
    for number, k in enumerate(range(0, len(keyframes), int(view.every_m / 2))):
        near = window(poses, k, view.length_m, centred=True, max_gap_m=10.0)
        cloud = accumulator.gather([keyframes.scan(i) for i in near], k - near.start)
        arrays[f"view{number}"] = cloud.points
        arrays[f"view_pose{number}"] = geometry.levelled(poses[k])
    scans = open_sequence(folder / "scans", Path("scans.tum"))
    for number, (scan, pose) in enumerate(scene.queries):
        arrays[f"single{number}"], arrays[f"pose{number}"] = scan.points, pose
        k = int(np.flatnonzero(scans.indices == int(scan.stamp))[0])
        arrays[f"accumulated{number}"] = gathered(scans, k).points
    np.savez(file, **arrays)


def measure(path: str, segments: int, threads: int, repeats: int) -> Row:
    """The row of one pickled scene, in a process of its own."""
    scene: Scene = pickle.loads(Path(path).read_bytes())
    size = segments or len(scene.prior_map)
    name = f"{scene.prior_map.descriptor} {size}"
    return query_row(name, scene, threads, repeats, segments=size, rivals=segments == 0)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--methods", default="profile,geo,dsm")
    parser.add_argument("--segments", default="0,50000,1000000")
    parser.add_argument("--queries", type=int, default=12)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--accumulated", action="store_true", help="queries of 40 m of travel")
    parser.add_argument("--threads", default="1,2")
    parser.add_argument("--export", type=Path, metavar="NPZ", help="write the clouds, no timing")
    options = parser.parse_args()
    if options.export:
        export(
            options.folder, kitti_scene(options.folder, "profile", options.queries), options.export
        )
        return
    print(processor())
    for method in options.methods.split(","):
        scene = kitti_scene(options.folder, method, options.queries, options.accumulated)
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "scene.pickle"
            path.write_bytes(pickle.dumps(scene))
            for segments in map(int, options.segments.split(",")):
                for threads in map(int, options.threads.split(",")):
                    show(
                        [
                            in_process(
                                threads, measure, str(path), segments, threads, options.repeats
                            )
                        ]
                    )


if __name__ == "__main__":
    main()
