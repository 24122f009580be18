"""How time and memory grow with the map and with the query.

    python -m segloc_lab.bench.growth --maps WORK/pieces --store docs/results

The maps in WORK are those that ``protocols.large_city`` makes: each of another simulated town. A
query is half of what lies nearest to some place, taken out of the map, which keeps other views of
the same objects. Larger maps than they make together are drawn at random, and marked: there, half
of a query is in the map.
"""

from __future__ import annotations

import itertools
import statistics
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from rich.progress import track

from segloc import SegmentMap, geometry
from segloc.proposals.matching import Matcher
from segloc.proposals.pose import PoseEstimator
from segloc.system.machine import processor
from segloc.system.stage_times import StageTimes
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
    *("map segments", "of", "query segments", "neighbours", "matching (ms)", "pose (ms)"),
    *("map and index (MB)", "pose found"),
)
_MEMORY = "Memory of towns has in it what loading their maps left behind."
DIMENSIONS = 32
"""Of ``profile``."""
SEGMENTS_A_HECTARE = 500
"""Density of a map: all views of an object are kept."""


@dataclass(frozen=True)
class Growth:
    """Cost of matching and of poses for one size of map and of query.

    Attributes
    ----------
    segments, queries : int
        In the map and in the query cloud.
    source : str
        What the segments are of.
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
    source: str
    neighbours: int
    matching_ms: float
    pose_ms: float
    map_mb: float
    found: bool


@dataclass(frozen=True)
class Problem:
    """Descriptors and centroids of a query and of a map, and the query's pose in it."""

    query: Descriptors
    query_centroids: Float64
    vectors: Float32
    centroids: Float64
    T_map_local: Pose
    source: str


def measured(segments: int, queries: int, maps: tuple[Path, ...], repeats: int = 3) -> Growth:
    """One size, of towns if there are enough of them, in a process that does nothing else.

    Queries are matched and posed as a localizer does at its first attempt: medians of runs.
    """
    before_mb, threads = held_mb(), 1
    problem = of_towns(maps, segments, queries) or drawn(segments, queries)
    prior_map = _map_of(problem.vectors, problem.centroids)
    matcher = Matcher(prior_map, threads=threads)
    map_mb = held_mb() - before_mb
    estimator = PoseEstimator(threads=threads)
    query, mapped = problem.query_centroids, problem.centroids
    matching, pose, found = [], [], False
    for _ in range(repeats):
        watch = StageTimes(clock_for(threads))
        with watch("matching"):
            matches = matcher.match(problem.query)
        with watch("pose"):
            poses = estimator.estimate(query, mapped, matches)
        truth = inputs.MatchProblem(query, mapped, matches.query, matches.map, problem.T_map_local)
        found = truth.found(np.array([each.T_map_local for each in poses]))
        matching.append(watch.ms["matching"])
        pose.append(watch.ms["pose"])
    medians = statistics.median(matching), statistics.median(pose)
    sizes = len(mapped), len(query), problem.source
    return Growth(*sizes, matcher.schedule[0], *medians, map_mb, found)


def of_towns(maps: tuple[Path, ...], segments: int, queries: int) -> Problem | None:
    """Segments of simulated towns; None if there are too few."""
    parts: list[SegmentMap] = []
    while sum(map(len, parts)) < segments + queries:
        if len(parts) == len(maps):
            return None
        parts.append(SegmentMap.load(maps[len(parts)]))
    vectors = np.concatenate([part.vectors for part in parts])[: segments + queries]
    centroids = np.concatenate([part.centroids for part in parts])[: segments + queries]
    rng = np.random.default_rng([segments, queries])
    near = np.linalg.norm((centroids - centroids[rng.integers(len(centroids))])[:, :2], axis=1)
    around = np.argpartition(near, 2 * queries)[: 2 * queries]
    asked = rng.choice(around, queries, replace=False)
    rest = np.delete(np.arange(len(centroids)), asked)
    T = geometry.yaw_transform(1.0, centroids[asked].mean(axis=0).tolist())
    query = geometry.transform(geometry.inverse(T), centroids[asked])
    return Problem(Descriptors(vectors[asked]), query, vectors[rest], centroids[rest], T, "towns")


def drawn(segments: int, queries: int) -> Problem:
    """Descriptors and places at random, half of the query's in the map as well, with noise."""
    rng = np.random.default_rng([segments, queries])
    database = inputs.descriptors(segments, DIMENSIONS, seed=segments)
    vectors = inputs.descriptors(queries, DIMENSIONS, seed=queries + 1)
    known = rng.choice(segments, min(queries // 2, segments), replace=False)
    vectors[: len(known)] = database[known] + rng.normal(0, 0.4, (len(known), DIMENSIONS))
    query, mapped, T = _centroids(rng, segments, queries, known)
    return Problem(Descriptors(vectors), query, database, mapped, T, "nothing, drawn at random")


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
    return (g.segments, g.source, g.queries, g.neighbours, *figures, "yes" if g.found else "no")


def main() -> None:
    options = storing(__doc__)
    options.add_argument("--maps", type=Path, help="a folder of maps of different towns")
    args = options.parse_args()
    maps = tuple(sorted(args.maps.glob("*.segmap"))) if args.maps else ()
    sizes = list(itertools.product(MAPS, QUERIES))
    found = [in_process(1, measured, *each, maps) for each in track(sizes, "Measuring")]
    rows = [_cells(each) for each in found]
    Result.measured(
        "growth",
        "python -m segloc_lab.bench.growth --maps WORK/pieces",
        COLUMNS,
        rows,
        stages=("map", "matching", "pose"),
        note=f"Machine: {processor()}, one thread. {_MEMORY}",
        counts={"rows": [asdict(each) for each in found]},
    ).tell(args.store)


if __name__ == "__main__":
    main()
