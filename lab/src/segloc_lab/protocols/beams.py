"""Single scans with fewer beams: full HDL-64E scans, thinned to 32, 16 and 8 beams.

The map is that of the protocol *single* of ``kitti00.sh``, made of thinned keyframes of later
passes. A beam is a band of elevation, 26.9 degrees divided by 64; every second, fourth or eighth
is kept.

    python -m segloc_lab.protocols.beams DATA/scans OUT/later-profile.segmap
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from segloc import Config, Localizer, SegmentMap
from segloc.batch.run import localize_sequence
from segloc.batch.score import Evaluation
from segloc.datasets import open_sequence

from ..evaluation.failures import funnel
from ..evaluation.intervals import share
from ..evaluation.scenario import QuerySet
from ..kitti00 import poses_of
from ..recordings import BEAMS, FewerBeams
from ..results.store import Result
from ..script import storing

KEPT_EVERY = (1, 2, 4, 8)


def main() -> None:
    options = storing(__doc__)
    options.add_argument("scans", type=Path)
    options.add_argument("prior_map", type=Path)
    options.add_argument("--truth", type=Path, default=Path("scans.tum"))
    options.add_argument("--step", type=int, default=1, help="one of so many scans")
    options.add_argument("--config", type=Path)
    args = options.parse_args()
    prior_map = SegmentMap.load(args.prior_map)
    localizer = Localizer(prior_map, Config.load(args.config, prior_map.descriptor))
    recording = open_sequence(args.scans)
    positions = np.arange(0, len(recording), args.step)
    truths = poses_of(open_sequence(args.scans, args.truth))[positions]
    rows = []
    for every in KEPT_EVERY:
        thinned = FewerBeams(recording, every)
        results = localize_sequence(localizer, thinned, positions)
        e = Evaluation(positions, results, prior_map.trajectory, truths)
        inside = e.within_coverage
        failed = inside & ~e.correct
        lost = funnel(localizer, QuerySet(thinned, positions[failed], truths[failed])).counts()
        stages = ", ".join(f"{n} {stage}" for stage, n in lost.items() if n)
        found = share(int((inside & e.correct).sum()), int(inside.sum()))
        segments = int(np.median([r.counts["segments"] for r in results]))
        rows.append((BEAMS // every, found, int(e.false.sum()), segments, stages or None))
    columns = (
        "beams",
        "found within map coverage",
        "false",
        "segments, median",
        "lost by segments",
    )
    command = f"python -m segloc_lab.protocols.beams SCANS MAP --step {args.step}"
    methods = (prior_map.descriptor,)
    Result.measured("beams", command, columns, rows, methods=methods).tell(args.store)


if __name__ == "__main__":
    main()
