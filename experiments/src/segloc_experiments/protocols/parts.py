"""A map that ends: parts of a real drive as maps, asked from all the rest of it.

Streets go on where a map ends, and look much the same there. The drive of KITTI 00 is cut into
parts, each is mapped, and keyframes of all other parts are asked in it, each alone and accumulated.
What is found farther than 5 m or 5 degrees from the truth is false.

    python benchmarks/parts.py DATA
"""

from __future__ import annotations

import argparse
from itertools import pairwise
from pathlib import Path

import numpy as np

from segloc.batch.comparison import MappedPlace, build_place
from segloc.batch.run import query_positions
from segloc.batch.score import Evaluation, Tolerance
from segloc.config import Config
from segloc.datasets import NO_POSES, Sequence, open_sequence
from segloc.descriptors import create

from .change import Scenario, answers

BOUNDS = (100, 240, 380, 520, 660)
TOLERANCE = Tolerance(metres=5.0, degrees=5.0)
BEYOND_M = 20.0


def report(
    name: str, part: str, prior_map: MappedPlace, scenario: Scenario, method: str
) -> tuple[int, int]:
    """Print what was found near the map's way and beyond it; how many were asked, and false."""
    answered = answers(prior_map, scenario, {method: create(method, 1)})[method]
    truths = scenario.truths[scenario.positions]
    e = Evaluation(answered.indices, answered.results, prior_map.trajectory, truths, TOLERANCE)
    beyond = e.distance_to_map > BEYOND_M
    cells = [
        part,
        name,
        str(len(e)),
        f"{(e.correct & e.within_coverage).sum()} of {e.within_coverage.sum()}",
        f"{(e.correct & ~e.within_coverage & ~beyond).sum()} of {(~e.within_coverage & ~beyond).sum()}",
        str((e.false & ~beyond).sum()),
        str((e.false & beyond).sum()),
        " ".join(str(scenario.recording.indices[i]) for i in e.indices[e.false]) or "-",
    ]
    print(f"| {' | '.join(cells)} |", flush=True)
    return len(e), int(e.false.sum())


def outside(drive: Sequence, first: int, last: int, every_m: float) -> np.ndarray:
    """Positions of the queries that show nothing of the scans from ``first`` to ``last``."""
    poses, local = drive.poses, Config().local_cloud
    assert poses is not None
    positions = query_positions(poses, every_m, local.max_gap_m)
    behind = drive.indices[np.maximum(positions - 30, 0)]  # 30 scans span more than a window
    return positions[(drive.indices[positions] < first) | (behind > last)]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("data", type=Path)
    parser.add_argument("--method", default="profile")
    parser.add_argument("--bounds", nargs="+", type=int, default=list(BOUNDS))
    parser.add_argument("--select", default="100:1820")
    parser.add_argument("--every", type=float, default=30.0, metavar="METRES")
    args = parser.parse_args()
    folder = args.data / "keyframes"
    posed = open_sequence(folder, "keyframes.tum", args.select)
    alone = open_sequence(folder, NO_POSES, args.select)
    truths = posed.poses
    assert truths is not None
    print("| map | clouds | queries | at a place | to 20 m | false | false beyond 20 m | which |")
    print(f"{'|---' * 8}|", flush=True)
    asked = false = 0
    for first, last in pairwise(args.bounds):
        part = f"{first}:{last - 1}"
        mapped = open_sequence(folder, "keyframes.tum", part)
        prior_map = build_place(mapped, {args.method: create(args.method, 1)})
        positions = outside(posed, first, last - 1, args.every)
        for name, recording in {"alone": alone, "accumulated": posed}.items():
            scenario = Scenario(name, recording, positions, truths)
            n, wrong = report(name, part, prior_map, scenario, args.method)
            asked, false = asked + n, false + wrong
    print(f"{false} of {asked} are false")


if __name__ == "__main__":
    main()
