"""How time and memory grow with the map and with the query.

python -m segloc_experiments.bench.growth
"""

from __future__ import annotations

import statistics
from dataclasses import dataclass

import numpy as np

from segloc import _native, geometry
from segloc.matching import MatchingConfig
from segloc.stage_times import StageTimes
from segloc.system import processor
from segloc.types import Float32, Float64, Int64, Pose

from ..script import head, parser, row
from ..stages import clock_for
from . import inputs
from .geometric import consensus
from .harness import in_process

MAPS = (1_000, 10_000, 100_000, 1_000_000)
QUERIES = (30, 300, 3_000)

SEGMENTS_A_HECTARE = 500
"""Density of a map: all views of an object are kept."""


@dataclass(frozen=True)
class Growth:
    """Cost of matching and of consensus for one size of map and of query.

    Attributes
    ----------
    segments, queries : int
        In the map and in the query cloud.
    matching_ms, pose_ms : float
    map_mb : float
        Memory of the map's segments: descriptors, centroids and the rest.
    found : bool
        Whether the true pose came first.
    """

    segments: int
    queries: int
    matching_ms: float
    pose_ms: float
    map_mb: float
    found: bool


def growth(segments: int, queries: int, threads: int = 1, repeats: int = 3) -> Growth:
    """Match and localize synthetic segments of which half are in the map, among their like.

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
    clock = clock_for(threads)
    matching, pose, found = [], [], False
    for _ in range(repeats):
        watch = StageTimes(clock)
        with watch("matching"):
            rows, columns = _matched(vectors, database, threads)
        problem = inputs.MatchProblem(query, mapped, rows, columns, T)
        with watch("pose"):
            found = problem.found(consensus(problem, threads))
        matching.append(watch.ms["matching"])
        pose.append(watch.ms["pose"])
    medians = statistics.median(matching), statistics.median(pose)
    memory = sum(array.nbytes for array in (database, mapped)) + 16 * segments
    return Growth(segments, queries, *medians, memory / 1e6, found)


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


def _matched(vectors: Float32, database: Float32, threads: int) -> tuple[Int64, Int64]:
    """Queries and their nearest neighbours, the nearest first."""
    indices, distances = _native.knn(vectors, database, MatchingConfig().neighbours, threads)
    rows = np.repeat(np.arange(len(vectors)), indices.shape[1])
    order = np.argsort(distances, axis=None, kind="stable")
    return rows[order], indices.reshape(-1)[order]


def main() -> None:
    parser(__doc__).parse_args()
    print(f"{processor()}, one thread\n")
    print(head("map", "query", "matching (ms)", "pose (ms)", "map (MB)", "pose found"))
    for segments in MAPS:
        for queries in QUERIES:
            g = in_process(1, growth, segments, queries)
            figures = (f"{v:.1f}" for v in (g.matching_ms, g.pose_ms, g.map_mb))
            print(row(segments, queries, *figures, "yes" if g.found else "no"), flush=True)


if __name__ == "__main__":
    main()
