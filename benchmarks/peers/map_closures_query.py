"""The queries of ``bench_query.py`` by map-closures, in a virtual environment of its own.

    python benchmarks/bench_query.py KITTI00 --export clouds.npz
    python3 -m venv peers && peers/bin/pip install map-closures "numpy<2.3"
    peers/bin/python benchmarks/peers/map_closures_query.py clouds.npz

Each view of the map becomes a local map of map-closures; a query is found if the best closure
gives a pose within 3 m. Times are of the processor, for storing and asking at once: there is no
call for asking alone.
"""

import statistics
import sys
import time

import numpy as np
from map_closures.config import MapClosuresConfig
from map_closures.map_closures import MapClosures

NEAR_M = 3.0
MIN_INLIERS = 5


def main(path: str) -> None:
    data = np.load(path)
    for kind in ("single", "accumulated"):
        ask(data, kind)


def ask(data: np.lib.npyio.NpzFile, kind: str) -> None:
    """Store the views, ask for every query of a kind, and print what came of it."""
    views = sum(name.startswith("view_pose") for name in data.files)
    queries = sum(name.startswith("pose") for name in data.files)
    closures = MapClosures(MapClosuresConfig())
    for k in range(views):
        closures.get_best_closure(k, data[f"view{k}"].astype(np.float64))
    times, found, wrong = [], 0, 0
    for k in range(queries):
        cloud, truth = data[f"{kind}{k}"].astype(np.float64), data[f"pose{k}"]
        start = time.process_time()
        best = closures.get_best_closure(views + k, cloud)
        times.append(1e3 * (time.process_time() - start))
        if not 0 <= best.source_id < views or best.number_of_inliers < MIN_INLIERS:
            continue
        # The pose takes points of the view to the query.
        T = data[f"view_pose{best.source_id}"] @ np.linalg.inv(np.asarray(best.pose))
        right = np.linalg.norm(T[:2, 3] - truth[:2, 3]) < NEAR_M
        found, wrong = found + right, wrong + (not right)
    print(f"map-closures, {views} views, {queries} {kind} clouds: {found} found, ", end="")
    print(f"{wrong} wrong, median {statistics.median(times):.0f} ms a query")


if __name__ == "__main__":
    main(sys.argv[1])
