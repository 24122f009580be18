"""Matching and poses of both attempts, in a real map and among a million segments.

Queries of ``kitti00.sh`` that have no place in the map are asked twice; here all of them are, and
each stage is timed by itself: processor time of one thread, medians. Towns as in ``city.py``.

    python benchmarks/bench_escalation.py DATA OUT      # OUT as filled by kitti00.sh
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from segloc import Config, Localizer, SegmentMap
from segloc.batch.score import distances_to_path
from segloc.segmentation import Segmentation
from segloc.types import Descriptors

from ..protocols.city import PROTOCOLS, padded, queries, towns

FAR_M = 50.0


def described(
    data: Path, protocol: str, localizer: Localizer, step: int
) -> Iterator[tuple[Segmentation, Descriptors]]:
    """The queries far from the map, segmented and described."""
    path = localizer.prior_map.trajectory
    for scans, truth in queries(data, protocol, localizer.config, step):
        if distances_to_path(truth[None], path)[0] > FAR_M:
            scene = localizer.segmenter.segment(localizer.accumulator.gather(scans))
            yield scene, localizer.descriptor.describe(scene.segments)


def stages(localizer: Localizer, scene: Segmentation, descriptors: Descriptors) -> list[float]:
    """Milliseconds of matching and of poses, one attempt after another."""
    proposals = localizer.matcher.proposals(descriptors)
    clock = [time.process_time()]
    for _ in localizer.matcher.attempts:
        matches = next(proposals)
        clock.append(time.process_time())
        localizer.estimator.estimate(
            scene.segments.centroids, localizer.prior_map.centroids, matches
        )
        clock.append(time.process_time())
    return (1e3 * np.diff(clock)).tolist()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("data", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--method", default="profile")
    parser.add_argument("--size", type=int, default=1_000_000)
    parser.add_argument("--towns", type=int, default=3)
    parser.add_argument("--step", type=int, default=8, help="ask every so many of the queries")
    args = parser.parse_args()
    config = Config.preset(args.method).model_copy(update={"threads": 1})
    padding = towns(args.out, args.method, args.towns, 7000)
    prior_map = SegmentMap.load(args.out / f"first-{args.method}.segmap")
    localizers = [Localizer(m, config) for m in (prior_map, padded(prior_map, padding, args.size))]
    print("| run | segments | K | matching | poses | matching again | poses again |")
    print("|---|---|---|---|---|---|---|")
    for protocol in (name for name, p in PROTOCOLS.items() if p[-1] == "first"):
        asked = list(described(args.data, protocol, localizers[0], args.step))
        for localizer in localizers:
            times = np.median([stages(localizer, *query) for query in asked], axis=0)
            attempts = ", ".join(map(str, localizer.matcher.attempts))
            cells = " | ".join(f"{ms:.1f}" for ms in times)
            print(f"| {protocol} | {len(localizer.prior_map)} | {attempts} | {cells} |", flush=True)


if __name__ == "__main__":
    main()
