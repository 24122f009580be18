"""Found, and never wrongly, in a map of a million segments.

The real maps of ``kitti00.sh`` are padded with simulated towns, and the real queries are asked
again. Towns are built by ``segloc.simulation``, each simulated and described once; to reach a
million segments without simulating for hours, each is then placed many times: turned, far from the
real map and from one another, with every descriptor moved by noise of a fifth of the spread of
its dimensions and every centroid by noise of 0.2 m. So the padding is made of a few hundred
thousand different views at most, not of a million. The cloud of a town, against which a pose would
be verified, is there in its first place only.

Times are processor time of one thread, medians over whole queries (gathering, segmentation and
description included): those that have a place in the map, and those that have none.

    python benchmarks/city.py DATA OUT --method profile      # OUT as filled by kitti00.sh
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Iterator
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np

from segloc import Config, Localization, Localizer, Scan, SegmentMap, build_map, geometry
from segloc.batch.run import query_positions
from segloc.batch.score import Evaluation, distances_to_path
from segloc.datasets import open_sequence, parse_select
from segloc.local_cloud import window
from segloc.simulation import demo_sessions
from segloc.types import Descriptors, Float64

FAR_M = 20_000.0
APART_M = 2_000.0
PROTOCOLS = {
    "accumulated": ("keyframes", "keyframes.tum", "948:1820", 10.0, "first"),
    "sparse": ("keyframes", None, "948:1820", 10.0, "first"),
    "single": ("scans", None, None, None, "later"),
}


def towns(out: Path, method: str, count: int, first_seed: int) -> list[SegmentMap]:
    """Maps of simulated towns; kept in ``out``."""
    maps = []
    for seed in range(first_seed, first_seed + count):
        path = out / f"town-{seed}-{method}.segmap"
        if not path.exists():
            build_map(demo_sessions(seed)["map"], Config.preset(method)).save(path)
        maps.append(SegmentMap.load(path))
    return maps


def padded(prior_map: SegmentMap, padding: list[SegmentMap], size: int) -> SegmentMap:
    """The map with other places around it, up to ``size`` segments.

    Where segments are put depends on ``size`` alone: maps of one place by several methods, padded
    with maps of other places by the same methods, are again maps of one place.
    """
    city = prior_map.crop(prior_map.trajectory[:, :2, 3].mean(axis=0), math.inf)
    centre = prior_map.centroids.mean(axis=0)
    turns, shifts, noise = (np.random.default_rng([size, k]) for k in range(3))
    place = 0
    while len(city) < size:
        town = padding[place % len(padding)]
        take = min(len(town), size - len(city))
        at = (FAR_M + APART_M * (place % 8), APART_M * (place // 8), 0.0)
        turn = turns.uniform(-math.pi, math.pi)
        T = geometry.yaw_transform(turn, tuple((centre + at).tolist()))
        middle = np.append(town.centroids[:, :2].mean(axis=0), 0.0)
        spread = 0.2 * town.vectors.std(axis=0)
        vectors = town.vectors[:take] + noise.normal(0, spread, (take, town.dim))
        centroids = geometry.transform(T, town.centroids[:take] - middle)
        cloud = np.empty((0, 3))
        if place < len(padding):
            cloud = geometry.transform(T, town.cloud + town.origin - middle)
        quality = None if town.quality is None else town.quality[:take]
        city.add(
            Descriptors(vectors.astype(np.float32), quality),
            centroids + shifts.normal(0, 0.2, centroids.shape),
            town.sizes[:take],
            session=place + 1,
            stamp=0.0,
            cloud=cloud,
        )
        place += 1
    return city


def queries(
    data: Path, protocol: str, config: Config, step: int
) -> Iterator[tuple[list[Scan], Float64]]:
    """Every ``step``-th query of a protocol of kitti00.sh, and its true pose."""
    folder, poses, select, every, _ = PROTOCOLS[protocol]
    selection = None if select is None else parse_select(select)
    truth = Path(f"{folder}.tum")
    recording = open_sequence(data / folder, None if poses is None else Path(poses), selection)
    truths = open_sequence(data / folder, truth, selection).poses
    assert truths is not None
    local, read = config.local_cloud, lru_cache(64)(recording.scan)
    positions = list(range(len(recording)))
    if every is not None:
        positions = query_positions(truths, every, local.max_gap_m).tolist()
    for i in positions[::step]:
        scans = range(i, i + 1)
        if recording.poses is not None:
            length, gap = local.window_m, local.max_gap_m
            scans = window(recording.poses, i, length, centred=False, max_gap_m=gap)
        yield [read(k) for k in scans], truths[i]


def timed(localizer: Localizer, scans: list[Scan]) -> Localization:
    """The answer, with the processor time of the whole query."""
    start = time.process_time()
    answer = localizer.localize(scans)
    elapsed = 1e3 * (time.process_time() - start)
    return replace(answer, times_ms={**answer.times_ms, "query": elapsed})


def run(data: Path, protocol: str, cities: list[SegmentMap], config: Config, step: int) -> None:
    """Ask every city the queries of a protocol, and print a row for each."""
    localizers = [Localizer(city, config) for city in cities]
    results: list[list[Localization]] = [[] for _ in cities]
    truths = []
    for scans, truth in queries(data, protocol, config, step):
        truths.append(truth)
        for answers, localizer in zip(results, localizers, strict=True):
            answers.append(timed(localizer, scans))
    path, poses = cities[0].trajectory, np.array(truths)
    nowhere = distances_to_path(poses, path) > 50.0
    for city, localizer, answers in zip(cities, localizers, results, strict=True):
        e = Evaluation(np.arange(len(answers)), answers, path, poses)
        wrong = max((r.inliers for r, n in zip(answers, nowhere, strict=True) if n), default=0)
        query = np.array([r.times_ms["query"] for r in answers])
        ms = [np.median(query[e.within_coverage]), np.median(query[~e.within_coverage])]
        print(
            f"| {protocol} | {len(city)} | {localizer.matcher.schedule[0]} | "
            f"{int((e.within_coverage & e.correct).sum())} of {int(e.within_coverage.sum())} | "
            f"{int(e.false.sum())} | {wrong} | " + " | ".join(f"{v:.1f}" for v in ms) + " |",
            flush=True,
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("data", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--method", default="profile")
    parser.add_argument("--sizes", type=int, nargs="*", default=[100_000, 300_000, 1_000_000])
    parser.add_argument("--towns", type=int, default=6)
    parser.add_argument("--first-seed", type=int, default=7000)
    parser.add_argument("--protocols", nargs="*", default=list(PROTOCOLS))
    parser.add_argument("--step", type=int, default=1, help="ask every so many of the queries")
    parser.add_argument("--config", type=Path)
    args = parser.parse_args()
    config = Config.load(args.config, args.method).model_copy(update={"threads": 1})
    padding = towns(args.out, args.method, args.towns, args.first_seed)
    print(f"{args.towns} towns of {sum(map(len, padding))} segments together")
    print("| run | segments | K | found | false | wrong inliers | ms at a place | ms elsewhere |")
    print("|---|---|---|---|---|---|---|---|")
    for protocol in args.protocols:
        prior_map = SegmentMap.load(args.out / f"{PROTOCOLS[protocol][-1]}-{args.method}.segmap")
        cities = [prior_map, *(padded(prior_map, padding, size) for size in args.sizes)]
        run(args.data, protocol, cities, config, args.step)


if __name__ == "__main__":
    main()
