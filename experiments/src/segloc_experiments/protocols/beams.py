"""Single scans with fewer beams: full HDL-64E scans, thinned to 32, 16 and 8 beams.

The map is that of the protocol *single* of ``kitti00.sh``, made of thinned keyframes of later
passes. A beam is a band of elevation, 26.9 degrees divided by 64; every second, fourth or eighth
is kept.

    python benchmarks/beams.py DATA/scans OUT/later-profile.segmap
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from segloc import Config, Localizer, Scan, SegmentMap
from segloc.batch.failures import funnel
from segloc.batch.run import localize_sequence
from segloc.batch.score import Evaluation
from segloc.datasets import Sequence, open_sequence

LOWEST_DEG, HIGHEST_DEG, BEAMS = -24.9, 2.0, 64


class Thinned:
    """A recording of which every so many beams are kept, without poses."""

    poses = None

    def __init__(self, recording: Sequence, keep_every: int) -> None:
        self.name = f"{recording.name}, {BEAMS // keep_every} beams"
        self.indices = recording.indices
        self._recording, self._every = recording, keep_every

    def __len__(self) -> int:
        return len(self.indices)

    def scan(self, i: int) -> Scan:
        """The scan at position i, thinned."""
        points = self._recording.scan(i).points
        elevation = np.degrees(np.arctan2(points[:, 2], np.hypot(points[:, 0], points[:, 1])))
        beam = np.floor((elevation - LOWEST_DEG) / (HIGHEST_DEG - LOWEST_DEG) * BEAMS)
        return Scan(points[beam % self._every == 0])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scans", type=Path)
    parser.add_argument("prior_map", type=Path)
    parser.add_argument("--truth", type=Path, default=Path("scans.tum"))
    parser.add_argument("--step", type=int, default=1, help="ask every so many scans")
    parser.add_argument("--config", type=Path)
    args = parser.parse_args()
    prior_map = SegmentMap.load(args.prior_map)
    localizer = Localizer(prior_map, Config.load(args.config, prior_map.descriptor))
    recording = open_sequence(args.scans)
    truths = open_sequence(args.scans, args.truth).poses
    assert truths is not None
    positions = np.arange(0, len(recording), args.step)
    print("| beams | found | false | segments | lost |\n|---|---|---|---|---|", flush=True)
    for every in (1, 2, 4, 8):
        thinned = Thinned(recording, every)
        results = localize_sequence(localizer, thinned, positions)
        e = Evaluation(positions, results, prior_map.trajectory, truths[positions])
        found = e.within_coverage & e.correct
        lost = funnel(localizer, thinned, truths, positions[e.within_coverage & ~found])
        stages = ", ".join(f"{n} {stage}" for stage, n in lost.counts().items() if n)
        segments = int(np.median([r.counts["segments"] for r in results]))
        print(
            f"| {BEAMS // every} | {found.sum()} of {e.within_coverage.sum()} | {e.false.sum()} "
            f"| {segments} | {stages or '-'} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
