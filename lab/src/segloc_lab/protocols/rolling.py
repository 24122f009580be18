r"""Are clouds on the lattice of the odometry as good as clouds that are gathered anew?

The corridor, keyframes and full scans of KITTI odometry 00: each query once gathered anew and once
by the window of its recording, in the map of its place and in the mirror image of that map.

    python -m segloc_lab.protocols.rolling DATA
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache
from itertools import chain
from pathlib import Path

import numpy as np
from rich.progress import track

from segloc import Config, LocalCloud, Localizer, build_map
from segloc.batch.run import query_clouds, query_positions
from segloc.batch.score import COVERAGE_RADIUS_M, distances_to_path
from segloc.frontend.local_cloud import Accumulator, window
from segloc.types import Recording

from .. import kitti00
from ..evaluation.negative_maps import mirrored
from ..evaluation.scenario import MAX_GAP_M
from ..results.store import Result
from ..script import storing
from .real import BACK, OUT, Queries, _corridor, outcome

EVERY_M = 14.0
"""Between full scans of KITTI."""

COLUMNS = ("queries", "all", "within coverage", "found", "false", "false in the mirror")
COMMAND = "python -m segloc_lab.protocols.rolling DATA --store docs/results"


def places(data: Path) -> Iterator[tuple[Recording, Queries]]:
    """What is mapped, and what is looked for in it."""
    back = _corridor(data, BACK)
    everyone = np.arange(len(back), dtype=np.int64)
    truths = kitti00.poses_of(back)
    yield _corridor(data, OUT), Queries("corridor", back, everyone, truths, ())
    kitti = data / "kitti00"
    q = kitti00.query_set(kitti, "accumulated", 3)
    found = Queries("kitti, keyframes", q.recording, q.positions, q.truths, ())
    yield kitti00.mapped(kitti, "accumulated"), found
    full = kitti00.scans(kitti)
    poses = kitti00.poses_of(full)
    positions = query_positions(poses, EVERY_M, MAX_GAP_M)
    found = Queries("kitti, full scans", full, positions, poses[positions], ())
    yield kitti00.mapped(kitti, "single"), found


def anew(queries: Queries, config: Config) -> Iterator[LocalCloud]:
    """The cloud of each query, gathered by itself."""
    local, accumulator = config.local_cloud, Accumulator(config.local_cloud)
    poses = kitti00.poses_of(queries.recording)
    read = lru_cache(128)(queries.recording.scan)
    for position in map(int, queries.positions):
        length, gap = local.window_m, local.max_gap_m
        behind = window(poses, position, length, centred=False, max_gap_m=gap)
        yield accumulator.gather([read(i) for i in behind])


def compare(mapped: Recording, queries: Queries, config: Config) -> Iterator[tuple[str | int, ...]]:
    """A row for either way of gathering."""
    prior_map = build_map(mapped, config)
    localizer, negative = Localizer(prior_map, config), Localizer(mirrored(prior_map), config)
    truths = queries.truths
    assert truths is not None
    near = distances_to_path(truths, prior_map.trajectory) <= COVERAGE_RADIUS_M
    rolled = (cloud for cloud, _ in query_clouds(queries.recording, queries.positions, config))
    for how, clouds in (("anew", anew(queries, config)), ("window", rolled)):
        outcomes, wrong = [], 0
        for cloud, truth in zip(clouds, truths, strict=True):
            outcomes.append(outcome(localizer.localize(cloud).T_map_sensor, truth))
            wrong += negative.localize(cloud).localized
        found = sum(o == "found" and bool(n) for o, n in zip(outcomes, near, strict=True))
        cells = (len(truths), int(near.sum()), found, outcomes.count("false"), wrong)
        yield f"{queries.name}, {how}", *cells


def main() -> None:
    options = storing(__doc__)
    options.add_argument("data", type=Path)
    args = options.parse_args()
    config = Config.preset("profile").model_copy(update={"threads": 1})
    compared = (compare(*place, config) for place in places(args.data))
    rows = list(track(chain.from_iterable(compared), "Gathering and localizing", total=6))
    Result.measured("rolling", COMMAND, COLUMNS, rows, methods=("profile",)).tell(args.store)


if __name__ == "__main__":
    main()
