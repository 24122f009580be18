"""small_gicp from a given start: what a tracker does that knows roughly where it is.

It searches no map: the start is the true pose, moved by half a metre and turned by two degrees,
and the target is the map around the nearest view. Its pose is scored by overlap, as Scan Context's
are.

    python -m segloc_lab.peers.small_gicp_query OUT/single
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from segloc import geometry

from ..script import parser
from .exchange import opened, run
from .scan_context import FINE_M, Floats, Places, Query

OFF_M, OFF_DEG = 0.5, 2.0


def start_near(T: Floats, seed: int) -> Floats:
    """Return a pose off the true one, in a direction drawn at random."""
    rng = np.random.default_rng(seed)
    turn = rng.uniform(-np.pi, np.pi)
    moved = OFF_M * np.cos(turn), OFF_M * np.sin(turn), 0.0
    return T @ geometry.yaw_transform(np.radians(OFF_DEG) * rng.choice([-1, 1]), moved)


def answer(folder: Path, options: argparse.Namespace) -> None:
    """Write the pose of each query after GICP, and its overlap."""
    views, queries, (answers,), todo = opened(folder, options, "small_gicp")
    if not todo:
        return
    places = Places(views)
    answers.map_bytes = np.array(places.nbytes)
    for q in todo:
        start = start_near(queries.poses[q], q)
        view = int(np.linalg.norm(views.poses[:, :3, 3] - start[:3, 3], axis=1).argmin())
        places.target(view)  # part of the map: prepared before it is queried
        with answers.timed(q):
            found = places.refined(Query(queries[q]), start, view, (FINE_M,))
        answers.give(q, *found)
        answers.save(folder, "small_gicp", q)


def main() -> None:
    run(parser(__doc__), answer)


if __name__ == "__main__":
    main()
