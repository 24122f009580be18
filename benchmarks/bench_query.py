"""A whole query on KITTI odometry 00: one full scan of an earlier pass in a map of later passes.

    python benchmarks/bench_query.py KITTI00 [--methods geo,dsm] [--segments 0,50000,1000000]

KITTI00 holds ``keyframes/`` (thinned), ``scans/`` (full) and their poses (``*.tum``). The map is
built of keyframes and padded with perturbed copies of itself; 0 is the map as it is.
"""

import argparse
import pickle
import tempfile
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from segloc import Config, Scan, build_map
from segloc.datasets import open_sequence
from segloc.evaluation.bench.harness import Row, in_process
from segloc.evaluation.bench.query import Scene, query_row
from segloc.evaluation.bench.report import machine, show

MAPPED = "619:654,988:1003,1361:1600"
NEAR_M = 3.0


def kitti_scene(folder: Path, method: str, queries: int) -> Scene:
    """The map of the later passes, and full scans of the first one that lie on its way."""
    keyframes = open_sequence(folder / "keyframes", Path("keyframes.tum"), MAPPED)
    scans = open_sequence(folder / "scans", Path("scans.tum"))
    site = build_map(keyframes, Config.preset(method).model_copy(update={"threads": 1}))
    distance, nearest = cKDTree(keyframes.poses[:, :3, 3]).query(scans.poses[:, :3, 3])
    with_place = np.flatnonzero(distance < NEAR_M)
    chosen = with_place[np.linspace(0, len(with_place) - 1, queries).astype(int)]
    alone = [Scan(scans.scan(i).points, stamp=float(i)) for i in chosen]
    mapped = keyframes.scan(int(nearest[chosen[0]]))
    return Scene(site, list(zip(alone, scans.poses[chosen], strict=True)), mapped)


def measure(path: str, segments: int, threads: int, repeats: int) -> Row:
    """The row of one pickled scene, in a process of its own."""
    scene: Scene = pickle.loads(Path(path).read_bytes())
    size = segments or len(scene.site)
    name = f"{scene.site.descriptor} {size}"
    return query_row(name, scene, threads, repeats, segments=size, rivals=segments == 0)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--methods", default="geo,dsm")
    parser.add_argument("--segments", default="0,50000,1000000")
    parser.add_argument("--queries", type=int, default=12)
    parser.add_argument("--repeats", type=int, default=5)
    options = parser.parse_args()
    print(machine())
    for method in options.methods.split(","):
        scene = kitti_scene(options.folder, method, options.queries)
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "scene.pickle"
            path.write_bytes(pickle.dumps(scene))
            for segments in map(int, options.segments.split(",")):
                for threads in (1, 2):
                    show(
                        [
                            in_process(
                                threads, measure, str(path), segments, threads, options.repeats
                            )
                        ]
                    )


if __name__ == "__main__":
    main()
