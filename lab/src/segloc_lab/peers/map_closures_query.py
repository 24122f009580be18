"""map-closures (Gupta et al., ICRA 2024): ORB features of density images of local maps.

    python -m segloc_lab.peers.map_closures_query OUT/accumulated --views long

Run it in an environment of its own (see README.md). There is no call that searches without
storing, so the time of a query includes storing it, and closures with earlier queries are left out.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from map_closures.config import MapClosuresConfig
from map_closures.map_closures import MapClosures
from numpy.typing import NDArray

from ..script import parser
from .exchange import opened, run

RADIUS_M = 50.0


def near(points: NDArray[np.float32]) -> NDArray[np.float64]:
    """The points near the sensor, which is at the origin."""
    inside: NDArray[np.bool_] = np.hypot(points[:, 0], points[:, 1]) < RADIUS_M
    return points[inside].astype(np.float64)


def answer(folder: Path, options: argparse.Namespace) -> None:
    views, queries, (answers,), todo = opened(folder, options, "map_closures")
    if not todo:
        return
    closures = MapClosures(MapClosuresConfig(density_map_resolution=options.resolution))
    for i in range(len(views)):
        closures.get_best_closure(i, near(views[i]))
    for q in todo:
        cloud = near(queries[q])
        with answers.timed(q):
            found = closures.get_top_k_closures(len(views) + q, cloud, options.top)
        mapped = [
            c for c in found if 0 <= c.source_id < len(views) and c.target_id == len(views) + q
        ]
        if mapped:
            best = max(mapped, key=lambda closure: closure.number_of_inliers)
            # The pose takes points of the view to the query.
            T = views.poses[best.source_id] @ np.linalg.inv(np.asarray(best.pose))
            answers.give(q, T, float(best.number_of_inliers))
        answers.save(folder, "map_closures", q)


def main() -> None:
    options = parser(__doc__)
    options.add_argument("--resolution", type=float, default=0.5, help="of the images, metres")
    options.add_argument("--top", type=int, default=20, help="closures looked at")
    run(options, answer, "long")


if __name__ == "__main__":
    main()
