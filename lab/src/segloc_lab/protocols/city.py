"""Found, and never falsely, in a map of a million segments.

The real maps of ``kitti00.sh`` are padded with simulated towns, and the real queries are localized
again. Towns are built by ``segloc_lab.simulation``, each simulated and described once; to reach a
million segments without simulating for hours, each is then placed many times: turned, far from the
real map and from one another, with every descriptor moved by noise of a fifth of the spread of
its dimensions and every centroid by noise of 0.2 m. So the padding is made of a few hundred
thousand different views at most, not of a million. The cloud of a town, against which a pose would
be verified, is there in its first place only.

Times are processor time of one thread, medians over whole queries (gathering, segmentation and
description included): those within map coverage, and those outside.

    python -m segloc_lab.protocols.city DATA OUT --store docs/results  # OUT of kitti00.sh
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from segloc import Config, LocalCloud, Localization, Localizer, SegmentMap
from segloc.batch.run import query_clouds
from segloc.batch.score import Evaluation, distances_to_path
from segloc.system.stage_times import StageTimes

from ..evaluation.intervals import share
from ..evaluation.scenario import QuerySet
from ..kitti00 import PROTOCOLS, query_set
from ..padding import padded, town_maps
from ..results.store import Cell, Result
from ..script import storing
from ..stages import processor_clock

NOWHERE_M = 50.0
COLUMNS = (
    *("protocol", "segments", "K", "found within map coverage", "false", "wrong inliers"),
    *("ms within coverage", "ms elsewhere"),
)
Row = tuple[Cell, ...]


def timed(localizer: Localizer, cloud: LocalCloud) -> tuple[Localization, float]:
    """The answer, and the milliseconds of processor time of all but the gathering."""
    watch = StageTimes(processor_clock)
    with watch("query"):
        answer = localizer.localize(cloud)
    return answer, watch.ms["query"]


def run(name: str, queries: QuerySet, localizers: Sequence[Localizer]) -> Iterator[Row]:
    """Localize the queries in every padded map: a row for each."""
    config = localizers[0].config
    answers: list[list[tuple[Localization, float]]] = [[] for _ in localizers]
    clouds = query_clouds(queries.recording, queries.positions, config, processor_clock)
    for cloud, times in clouds:
        for found, localizer in zip(answers, localizers, strict=True):
            answer, elapsed = timed(localizer, cloud)
            found.append((answer, elapsed + times.ms["gathering"]))
    path, truths = localizers[0].prior_map.trajectory, queries.truths
    assert truths is not None
    nowhere = distances_to_path(truths, path) > NOWHERE_M
    for localizer, found in zip(localizers, answers, strict=True):
        results = [answer for answer, _ in found]
        e = Evaluation(np.arange(len(results)), results, path, truths)
        wrong = max((r.inliers for r, n in zip(results, nowhere, strict=True) if n), default=0)
        ms = np.array([elapsed for _, elapsed in found])
        inside = e.within_coverage
        yield (
            name,
            len(localizer.prior_map),
            localizer.matcher.schedule[0],
            share(int((inside & e.correct).sum()), int(inside.sum())),
            int(e.false.sum()),
            wrong,
            *(round(float(np.median(ms[part])), 1) for part in (inside, ~inside)),
        )


def main() -> None:
    options = storing(__doc__)
    options.add_argument("data", type=Path)
    options.add_argument("out", type=Path)
    options.add_argument("--method", default="profile")
    options.add_argument("--sizes", type=int, nargs="*", default=[1_000_000])
    options.add_argument("--towns", type=int, default=3)
    options.add_argument("--first-seed", type=int, default=7000)
    options.add_argument("--protocols", nargs="*", default=list(PROTOCOLS))
    options.add_argument("--step", type=int, default=1, help="one of so many queries")
    options.add_argument("--config", type=Path)
    args = options.parse_args()
    config = Config.load(args.config, args.method).model_copy(update={"threads": 1})
    towns = town_maps(args.out, args.method, args.towns, args.first_seed)
    rows: list[Row] = []
    for name in args.protocols:
        map_name = PROTOCOLS[name].map_name
        prior_map = SegmentMap.load(args.out / f"{map_name}-{args.method}.segmap")
        maps = [prior_map, *(padded(prior_map, towns, size) for size in args.sizes)]
        localizers = [Localizer(each, config) for each in maps]
        rows += run(name, query_set(args.data, name, args.step), localizers)
    sizes = " ".join(map(str, args.sizes))
    Result.measured(
        "million",
        f"python -m segloc_lab.protocols.city DATA OUT --method {args.method} "
        f"--towns {args.towns} --sizes {sizes} --step {args.step} --store docs/results",
        COLUMNS,
        rows,
        methods=(args.method,),
        note=f"`{args.method}`; the towns have {sum(map(len, towns))} segments together. In "
        "brackets 95 % by Wilson. Wrong inliers: most of any candidate of a query that is "
        f"{NOWHERE_M:g} m and more from the map. Milliseconds of processor time of one thread, "
        "medians, on a machine with other work.",
    ).tell(args.store)


if __name__ == "__main__":
    main()
