"""A map that ends: parts of a real drive as maps, all the rest of it localized in them.

Streets go on where a map ends, and look much the same there. The drive of KITTI 00 is cut into
parts, each is mapped, and keyframes of all other parts are localized in it, each alone and
accumulated. What is found farther than 5 m or 5 degrees from the truth is false.

    python -m segloc_lab.protocols.parts DATA
"""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np

from segloc.batch.run import query_positions
from segloc.batch.score import Evaluation, Tolerance
from segloc.datasets import Sequence
from segloc.descriptors import create
from segloc.types import Int64

from ..evaluation.comparison import build_place
from ..evaluation.scenario import MAX_GAP_M, QuerySet
from ..kitti00 import keyframes, poses_of
from ..results.store import Cell, Result
from ..script import storing
from .change import evaluations

BOUNDS = (100, 240, 380, 520, 660)
TOLERANCE = Tolerance(metres=5.0, degrees=5.0)
BEYOND_M = 20.0
WINDOW_SCANS = 30
"""They span more than a query gathers."""


def counted(part: str, name: str, recording: Sequence, e: Evaluation) -> tuple[Cell, ...]:
    """What was found within coverage, near it and beyond it, and which answers are false."""
    beyond = e.distance_to_map > BEYOND_M
    inside, near = e.within_coverage, ~e.within_coverage & ~beyond
    found = (f"{(e.correct & where).sum()} of {where.sum()}" for where in (inside, near))
    false = (int((e.false & ~beyond).sum()), int((e.false & beyond).sum()))
    which = " ".join(str(recording.indices[i]) for i in e.indices[e.false]) or None
    return part, name, len(e), *found, *false, which


def outside(drive: Sequence, first: int, last: int, every_m: float) -> Int64:
    """Positions of the queries that show nothing of the scans from ``first`` to ``last``."""
    positions = query_positions(poses_of(drive), every_m, MAX_GAP_M)
    behind = drive.indices[np.maximum(positions - WINDOW_SCANS, 0)]
    return positions[(drive.indices[positions] < first) | (behind > last)]


def main() -> None:
    options = storing(__doc__)
    options.add_argument("data", type=Path)
    options.add_argument("--method", default="profile")
    options.add_argument("--bounds", nargs="+", type=int, default=list(BOUNDS))
    options.add_argument("--select", default="100:1820")
    options.add_argument("--every", type=float, default=30.0, metavar="METRES")
    args = options.parse_args()
    posed = keyframes(args.data, args.select)
    alone = keyframes(args.data, args.select, posed=False)
    truths = poses_of(posed)
    descriptors = {args.method: create(args.method, 1)}
    within = ("within coverage", f"to {BEYOND_M:g} m")
    false_of = ("false", f"false beyond {BEYOND_M:g} m")
    columns = ("map", "clouds", "queries", *within, *false_of, "which")
    rows = []
    queries = false = 0
    for first, last in pairwise(args.bounds):
        part = f"{first}:{last - 1}"
        mapped = build_place(keyframes(args.data, part), descriptors)
        positions = outside(posed, first, last - 1, args.every)
        for name, recording in {"alone": alone, "accumulated": posed}.items():
            query_set = QuerySet(recording, positions, truths[positions])
            (e,) = evaluations(query_set, descriptors, {part: mapped}, TOLERANCE).values()
            rows.append(counted(part, name, recording, e))
            queries, false = queries + len(e), false + int(e.false.sum())
    bounds = " ".join(map(str, args.bounds))
    command = f"python -m segloc_lab.protocols.parts DATA --bounds {bounds}"
    command += f" --select {args.select} --every {args.every:g}"
    note = f"{false} of {queries} are false."
    methods = (args.method,)
    Result.measured("parts", command, columns, rows, methods=methods, note=note).tell(args.store)


if __name__ == "__main__":
    main()
