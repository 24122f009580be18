"""How time and memory grow with the map and with the query.

python -m segloc_experiments.bench.growth
"""

from __future__ import annotations

import itertools
import statistics
from dataclasses import asdict, dataclass

import numpy as np
from rich.progress import track

from segloc import SegmentMap, geometry
from segloc.matching import Matcher
from segloc.pose import PoseEstimator
from segloc.stage_times import StageTimes
from segloc.system import processor
from segloc.types import Descriptors, Float32, Float64, Int64, Pose

from ..memory import held_mb
from ..results.store import Cell, Result
from ..script import storing
from ..stages import clock_for
from . import inputs
from .harness import in_process
from .rows import rounded

MAPS = (10_000, 100_000, 1_000_000, 10_000_000)
QUERIES = (30, 300, 3_000)
POINTS = 160
COLUMNS = (
    *("map segments", "query segments", "neighbours", "matching (ms)", "pose (ms)"),
    *("map and index (MB)", "pose found"),
)
SEGMENTS_A_HECTARE = 500
"""Density of a map: all views of an object are kept."""


@dataclass(frozen=True)
class Growth:
    """Cost of matching and of poses for one size of map and of query.

    Attributes
    ----------
    segments, queries : int
        In the map and in the query cloud.
    neighbours : int
        Proposed for each segment of the query.
    matching_ms, pose_ms : float
    map_mb : float
        Memory of the map's segments and of the index in which they are searched, without a cloud.
    found : bool
        Whether the true pose came first.
    """

    segments: int
    queries: int
    neighbours: int
    matching_ms: float
    pose_ms: float
    map_mb: float
    found: bool


def growth(segments: int, queries: int, threads: int = 1, repeats: int = 3) -> Growth:
    """Match and localize synthetic segments of which half are in the map, among their like.

    Matches and poses are found as by a localizer at its first attempt.

    Parameters
    ----------
    segments, queries : int
    threads : int
    repeats : int
        Runs of which the median is taken.
    """
    rng = np.random.default_rng([segments, queries])
    database = inputs.descriptors(segments, seed=segments)
    vectors = inputs.descriptors(queries, seed=queries + 1)
    known = rng.choice(segments, min(queries // 2, segments), replace=False)
    vectors[: len(known)] = database[known] + rng.normal(0, 0.4, (len(known), vectors.shape[1]))
    query, mapped, T = _centroids(rng, segments, queries, known)
    before_mb = held_mb()
    prior_map = _map_of(database, mapped)
    matcher = Matcher(prior_map, threads=threads)
    map_mb = held_mb() - before_mb
    estimator, described = PoseEstimator(threads=threads), Descriptors(vectors)
    matching, pose, found = [], [], False
    for _ in range(repeats):
        watch = StageTimes(clock_for(threads))
        with watch("matching"):
            matches = matcher.match(described)
        with watch("pose"):
            poses = estimator.estimate(query, mapped, matches)
        problem = inputs.MatchProblem(query, mapped, matches.query, matches.map, T)
        found = problem.found(np.array([each.T_map_local for each in poses]))
        matching.append(watch.ms["matching"])
        pose.append(watch.ms["pose"])
    medians = statistics.median(matching), statistics.median(pose)
    return Growth(segments, queries, matcher.schedule[0], *medians, map_mb, found)


def _map_of(vectors: Float32, centroids: Float64) -> SegmentMap:
    sizes = np.full(len(vectors), POINTS, np.int32)
    prior_map = SegmentMap.empty("synthetic", "none", vectors.shape[1])
    prior_map.add(
        Descriptors(vectors), centroids, sizes, session=0, stamp=0.0, cloud=np.empty((0, 3))
    )
    return prior_map


def _centroids(
    rng: np.random.Generator, segments: int, queries: int, known: Int64
) -> tuple[Float64, Float64, Pose]:
    """Of the query, of the map, whose ``known`` rows are the query's first ones, and its pose."""
    side = 100.0 * np.sqrt(segments / SEGMENTS_A_HECTARE)
    radius = 50.0 * max(1.0, np.sqrt(queries / 300))
    flat = rng.uniform(-radius, radius, (queries, 2))
    query = np.column_stack([flat, rng.uniform(0, 4, queries)])
    mapped = np.column_stack([rng.uniform(0, side, (segments, 2)), rng.uniform(0, 4, segments)])
    T = geometry.yaw_transform(1.0, (side / 2, side / 3, 0.5))
    noise = rng.normal(0, 0.15, (len(known), 3))
    mapped[known] = geometry.transform(T, query[: len(known)]) + noise
    return query, mapped, T


def _cells(g: Growth) -> tuple[Cell, ...]:
    figures = map(rounded, (g.matching_ms, g.pose_ms, g.map_mb))
    return (g.segments, g.queries, g.neighbours, *figures, "yes" if g.found else "no")


def main() -> None:
    options = storing(__doc__)
    args = options.parse_args()
    sizes = itertools.product(MAPS, QUERIES)
    found = [in_process(1, growth, *each) for each in track(list(sizes), "Measuring")]
    rows = [_cells(each) for each in found]
    Result.measured(
        "growth",
        "python -m segloc_experiments.bench.growth",
        COLUMNS,
        rows,
        stages=("map", "matching", "pose"),
        note=f"Machine: {processor()}, one thread.",
        counts={"rows": [asdict(each) for each in found]},
    ).tell(args.store)


if __name__ == "__main__":
    main()
