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
from .exchange import Clouds, near, run
from .scan_context import Candidate, Propose, ScanContexts, answer_refined, sideways

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
    # All clouds are level, which its quatro solver makes use of.
    settings = kiss_matcher.KISSMatcherConfig(options.voxel, use_quatro=True)
    matcher = kiss_matcher.KISSMatcher(settings)

    def prepared(views: Clouds) -> tuple[Propose, int]:
        contexts = ScanContexts(views, options.radius)
        clouds = sum(near(views[i], RADIUS_M).nbytes for i in range(len(views)))

        def propose(points: NDArray[np.float32]) -> list[Candidate]:
            found, cloud = [], near(points, RADIUS_M)
            for place in contexts.candidates(points, sideways(options.shifts), options.top):
                T, inliers = registered(matcher, cloud, near(views[place.view], RADIUS_M))
                found.append(Candidate(place.view, -inliers, views.poses[place.view] @ T))
            return found

        return propose, contexts.nbytes + clouds

    answer_refined(folder, options, ("kiss_matcher", "kiss_matcher-inliers"), prepared)


def main() -> None:
    options = parser(__doc__)
    options.add_argument("--voxel", type=float, default=0.5, help="metres")
    options.add_argument("--radius", type=float, default=80.0, help="of a context, metres")
    options.add_argument("--top", type=int, default=3, help="places that are tried")
    options.add_argument("--shifts", type=float, nargs="+", default=[0.0], help="sideways, metres")
    run(options, answer)


if __name__ == "__main__":
    main()
