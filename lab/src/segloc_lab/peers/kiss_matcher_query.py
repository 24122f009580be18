"""KISS-Matcher (Lim et al., ICRA 2025): features and a robust global registration.

It aligns two clouds and searches no map, so Scan Context names the places to try: the best few.
A query is aligned with the view of such a place, not with the map joined from all views, where it
finds far less. Its best pose is scored by its number of inliers, or as Scan Context's own poses
are, by GICP and overlap.

    python -m segloc_lab.peers.kiss_matcher_query OUT/single --views scan
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import argparse
from pathlib import Path

import kiss_matcher
import numpy as np
from numpy.typing import NDArray

from segloc import geometry

from ..script import parser
from .exchange import near, opened, run
from .scan_context import Places, Query, ScanContexts, sideways

RADIUS_M = 60.0


def registered(
    matcher: kiss_matcher.KISSMatcher, query: NDArray[np.float32], view: NDArray[np.float32]
) -> tuple[NDArray[np.float64], int]:
    """T_view_query and how many correspondences agree with it."""
    matcher.reset()
    solution = matcher.estimate(query, view)
    T = geometry.rigid(np.asarray(solution.rotation), np.asarray(solution.translation))
    return T, int(matcher.get_num_final_inliers())


def answer(folder: Path, options: argparse.Namespace) -> None:
    """Write answers by overlap after GICP, and by the number of inliers alone."""
    systems = "kiss_matcher", "kiss_matcher-inliers"
    views, queries, (verified, alone), todo = opened(folder, options, *systems)
    if not todo:
        return
    contexts, places = ScanContexts(views, options.radius), Places(views)
    clouds = sum(near(views[i], RADIUS_M).nbytes for i in range(len(views)))
    alone.map_bytes = np.array(contexts.nbytes + clouds)
    verified.map_bytes = np.array(contexts.nbytes + clouds + places.nbytes)
    # All clouds are level, which its quatro solver makes use of.
    settings = kiss_matcher.KISSMatcherConfig(options.voxel, use_quatro=True)
    matcher = kiss_matcher.KISSMatcher(settings)
    for q in todo:
        with verified.timed(q), alone.timed(q):
            candidates = contexts.candidates(queries[q], sideways(options.shifts), options.top)
        for candidate in candidates:
            places.target(candidate.view)  # part of the map: prepared before it is queried
        with verified.timed(q), alone.timed(q):
            cloud = near(queries[q], RADIUS_M)
            poses = []
            for candidate in candidates:
                T, inliers = registered(matcher, cloud, near(views[candidate.view], RADIUS_M))
                poses.append((views.poses[candidate.view] @ T, inliers))
        alone.give(q, *max(poses, key=lambda item: item[1]))
        with verified.timed(q):
            query = Query(queries[q])
            refined = [
                places.refined(query, T, candidate.view)
                for (T, _), candidate in zip(poses, candidates, strict=True)
            ]
        verified.give(q, *max(refined, key=lambda item: item[1]))
        for answers, system in zip((verified, alone), systems, strict=True):
            answers.save(folder, system, q)


def main() -> None:
    options = parser(__doc__)
    options.add_argument("--voxel", type=float, default=0.5, help="metres")
    options.add_argument("--radius", type=float, default=80.0, help="of a context, metres")
    options.add_argument("--top", type=int, default=3, help="places that are tried")
    options.add_argument("--shifts", type=float, nargs="+", default=[0.0], help="sideways, metres")
    run(options, answer)


if __name__ == "__main__":
    main()
