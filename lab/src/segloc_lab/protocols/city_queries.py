"""Queries in the tiles of a city in a separate process: results and cost.

    python -m segloc_lab.protocols.city_queries WORK WAY OUT SEED...

``large_city`` begins it.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import json
import time
from pathlib import Path
from typing import Any

import numpy as np

from segloc import Config, Prior
from segloc.system.stage_times import StageTimes
from segloc.tiles import TiledLocalizer, TiledMap

from ..city import opened, queries
from ..outcomes import outcome
from ..script import parser
from ..stages import held_mb, highest_mb, processor_clock

WIDE = "ten times as wide"
WAYS = (
    "no prior",
    "prior",
    "elsewhere",
    "elsewhere, prior",
    f"no prior, {WIDE}",
    f"elsewhere, {WIDE}",
)
RADIUS_M = 200.0
MEMORY_BYTES = 48_000_000
"""Size of the cache of tiles."""


def query_results(work: Path, way: str, seeds: list[int]) -> dict[str, Any]:
    """Results of the queries of some towns, with the cost of each; memory is of this process."""
    place, has_prior = way.split(", ")[0], way in ("prior", "elsewhere, prior")
    tiles = TiledMap(work / ("wide" if WIDE in way else "tiles"), memory_bytes=MEMORY_BYTES)
    localizer = TiledLocalizer(tiles, Config(threads=1), clock=processor_clock)
    path, rng = localizer.prior_map.trajectory[:, :2, 3], np.random.default_rng(0)
    ready_mb, answers = held_mb(), []
    for file in queries(work / "pieces", seeds):
        cloud, truth = opened(file)
        about = path[rng.integers(len(path))] if place == "elsewhere" else truth[:2, 3]
        near = Prior(about + rng.uniform(-0.5, 0.5, 2) * RADIUS_M, RADIUS_M)
        times = StageTimes(processor_clock)
        began = time.process_time()
        query = localizer.describe(cloud, times)
        described = time.process_time()
        answer = localizer.locate(query, times, near=near if has_prior else None)
        ended = time.process_time()
        again = localizer.locate(query, near=near if has_prior else None)
        spent_again = time.process_time() - ended
        found = outcome(answer.T_map_sensor, None if place == "elsewhere" else truth)
        entry: dict[str, Any] = {"query": file.stem, "outcome": found}
        entry["times"] = dict(answer.times_ms)
        entry |= {"describe_ms": 1e3 * (described - began), "search_ms": 1e3 * (ended - described)}
        entry |= {"again_ms": 1e3 * spent_again, "same": again.inliers == answer.inliers}
        answers.append({**entry, "reason": str(getattr(answer, "reason", ""))})
    return {"answers": answers, "peak_mb": highest_mb(), "ready_mb": ready_mb}


def main() -> None:
    options = parser(__doc__)
    options.add_argument("work", type=Path, help="of `large_city`")
    options.add_argument("way", choices=WAYS)
    options.add_argument("out", type=Path)
    options.add_argument("seeds", type=int, nargs="+", metavar="SEED", help="towns")
    args = options.parse_args()
    args.out.write_text(json.dumps(query_results(args.work, args.way, args.seeds)))


if __name__ == "__main__":
    main()
