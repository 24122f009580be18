"""Matching and poses of both attempts, in a real map and among a million segments.

Queries of ``kitti00.sh`` that lie outside map coverage are tried twice; here all of them are, and
each stage is timed by itself: processor time of one thread, medians. Towns as in ``city``.

    python -m segloc_experiments.bench.escalation DATA OUT      # OUT as filled by kitti00.sh
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from segloc import Config, Localizer, SegmentMap
from segloc.batch.run import query_clouds
from segloc.batch.score import distances_to_path
from segloc.segmentation import Segmentation
from segloc.stage_times import StageTimes
from segloc.types import Descriptors

from ..kitti00 import PROTOCOLS, query_set
from ..padding import padded, town_maps
from ..script import head, parser, row
from ..stages import processor_clock

FAR_M = 50.0


def described(
    data: Path, protocol: str, localizer: Localizer, step: int
) -> Iterator[tuple[Segmentation, Descriptors]]:
    """The queries far from the map, segmented and described."""
    queries = query_set(data, protocol, step)
    assert queries.truths is not None
    far = distances_to_path(queries.truths, localizer.prior_map.trajectory) > FAR_M
    for cloud, _ in query_clouds(queries.recording, queries.positions[far], localizer.config):
        scene = localizer.segmenter.segment(cloud)
        yield scene, localizer.descriptor.describe(scene.segments)


def stages(localizer: Localizer, scene: Segmentation, descriptors: Descriptors) -> list[float]:
    """Milliseconds of matching and of poses, one attempt after another."""
    search = localizer.matcher.neighbours(descriptors)
    watch = StageTimes(processor_clock)
    for attempt in localizer.matcher.schedule:
        with watch(f"matching {attempt}"):
            matches = search.matches(attempt)
        with watch(f"pose {attempt}"):
            localizer.estimator.estimate(
                scene.segments.centroids, localizer.prior_map.centroids, matches
            )
    return list(watch.ms.values())


def main() -> None:
    options = parser(__doc__)
    options.add_argument("data", type=Path)
    options.add_argument("out", type=Path)
    options.add_argument("--method", default="profile")
    options.add_argument("--size", type=int, default=1_000_000)
    options.add_argument("--towns", type=int, default=3)
    options.add_argument("--step", type=int, default=8, help="one of so many queries")
    args = options.parse_args()
    config = Config.preset(args.method).model_copy(update={"threads": 1})
    towns = town_maps(args.out, args.method, args.towns, 7000)
    prior_map = SegmentMap.load(args.out / f"first-{args.method}.segmap")
    localizers = [Localizer(m, config) for m in (prior_map, padded(prior_map, towns, args.size))]
    columns = ("run", "segments", "K", "matching", "poses", "matching again", "poses again")
    print(head(*columns))
    for name in (name for name, p in PROTOCOLS.items() if p.map_name == "first"):
        queries = list(described(args.data, name, localizers[0], args.step))
        for localizer in localizers:
            times = np.median([stages(localizer, *query) for query in queries], axis=0)
            attempts = ", ".join(map(str, localizer.matcher.schedule))
            cells = [f"{ms:.1f}" for ms in times]
            print(row(name, len(localizer.prior_map), attempts, *cells), flush=True)


if __name__ == "__main__":
    main()
