"""A whole query on KITTI odometry 00: one full scan of an earlier pass in a map of later passes.

    python -m segloc_lab.bench.kitti_query DATA [--methods profile,geo] [--threads 1,2]

The map is built of keyframes and padded with mirror images of itself; ``--segments 0`` is the map
as it is. The same number of scans from other places must be rejected.
"""

from __future__ import annotations

import pickle
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

from segloc import Config, Scan, build_map
from segloc.datasets import Sequence
from segloc.frontend import Accumulator, LocalCloudConfig, window
from segloc.system import kernels
from segloc.system.machine import processor
from segloc.types import LocalCloud, stamp_at

from .. import kitti00
from ..report import publish, reporting
from .harness import Row, in_process, query_table, show
from .query import Scene, query_row

NEAR_M, FAR_M = 3.0, 60.0
"""Within map coverage, and farther off than a query sees."""
THIN_M = 0.2


def kitti_scene(folder: Path, method: str, queries: int, accumulated: bool = False) -> Scene:
    """The map of the later passes, and full scans of the first one within its coverage."""
    recording, scans = kitti00.mapped(folder, "single"), kitti00.scans(folder)
    poses = kitti00.poses_of(scans)
    prior_map = build_map(recording, Config.preset(method).model_copy(update={"threads": 1}))
    gaps = np.linalg.norm(poses[:, None, :3, 3] - kitti00.poses_of(recording)[:, :3, 3], axis=2)
    nearest = gaps.argmin(axis=1)
    within_coverage = np.flatnonzero(gaps.min(axis=1) < NEAR_M)
    chosen = within_coverage[np.linspace(0, len(within_coverage) - 1, queries).astype(int)]
    clouds: list[Scan | LocalCloud] = [
        gathered(scans, k) if accumulated else alone(scans, k) for k in chosen
    ]
    mapped = recording.scan(int(nearest[chosen[0]]))
    away = np.flatnonzero(gaps.min(axis=1) > FAR_M)
    others = away[np.linspace(0, len(away) - 1, queries).astype(int)]
    elsewhere: list[Scan | LocalCloud] = [
        gathered(scans, k) if accumulated else alone(scans, k) for k in others
    ]
    queried = list(zip(clouds, poses[chosen], strict=True))
    return Scene(prior_map, queried, mapped, elsewhere)


def alone(scans: Sequence, k: int) -> Scan:
    """One scan, without its pose."""
    return Scan(scans.scan(k).points, stamp=stamp_at(scans, k))


def gathered(scans: Sequence, k: int) -> LocalCloud:
    """The scans of 40 m around one, thinned."""
    config = LocalCloudConfig()
    near = window(
        kitti00.poses_of(scans), k, config.window_m, centred=True, max_gap_m=config.max_gap_m
    )
    cloud = Accumulator(config).gather([scans.scan(i) for i in near], k - near.start)
    return replace(cloud, points=kernels.voxel_grid(cloud.points, THIN_M))


def measure(path: str, segments: int, threads: int, repeats: int) -> Row:
    """The row of one pickled scene, in a process of its own."""
    scene: Scene = pickle.loads(Path(path).read_bytes())
    size = segments or len(scene.prior_map)
    name = f"{scene.prior_map.descriptor} {size}"
    return query_row(name, scene, threads, repeats, segments=size, rivals=segments == 0)


def main() -> None:
    parsed = reporting(__doc__)
    parsed.add_argument("folder", type=Path)
    parsed.add_argument("--methods", default="profile,geo,dsm")
    parsed.add_argument("--segments", default="0,50000,1000000")
    parsed.add_argument("--queries", type=int, default=12)
    parsed.add_argument("--repeats", type=int, default=5)
    parsed.add_argument("--accumulated", action="store_true", help="queries of 40 m of travel")
    parsed.add_argument("--threads", default="1,2")
    options = parsed.parse_args()
    print(processor())
    found: list[tuple[str, Row]] = []
    for method in options.methods.split(","):
        scene = kitti_scene(options.folder, method, options.queries, options.accumulated)
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "scene.pickle"
            path.write_bytes(pickle.dumps(scene))
            for segments in map(int, options.segments.split(",")):
                for threads in map(int, options.threads.split(",")):
                    arguments = (str(path), segments, threads, options.repeats)
                    measured = in_process(threads, measure, *arguments)
                    show([measured])
                    found.append((method, measured))
    publish(options.report, "A query of KITTI 00 by its stages", query_table(found))


if __name__ == "__main__":
    main()
