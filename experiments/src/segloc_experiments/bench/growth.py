"""How time and memory grow with the map and with the query."""

from __future__ import annotations

import statistics
import time
from dataclasses import dataclass

import numpy as np

from segloc import _native, geometry
from segloc.matching import MatchingConfig

from . import inputs
from .harness import processor_clock

SEGMENTS_A_HECTARE = 500
"""Density of a map: all views of an object are kept."""


@dataclass(frozen=True)
class Growth:
    """Cost of matching and of consensus for one size of map and of query.

    Attributes
    ----------
    segments, queries : int
        In the map and in the live cloud.
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
    from .geometric import consensus

    rng = np.random.default_rng([segments, queries])
    database = inputs.descriptors(segments, seed=segments)
    vectors = inputs.descriptors(queries, seed=queries + 1)
    known = rng.choice(segments, min(queries // 2, segments), replace=False)
    vectors[: len(known)] = database[known] + rng.normal(0, 0.4, (len(known), vectors.shape[1]))
    side = 100.0 * np.sqrt(segments / SEGMENTS_A_HECTARE)
    reach = 50.0 * max(1.0, np.sqrt(queries / 300))
    query = np.column_stack([rng.uniform(-reach, reach, (queries, 2)), rng.uniform(0, 4, queries)])
    prior_map = np.column_stack([rng.uniform(0, side, (segments, 2)), rng.uniform(0, 4, segments)])
    T = geometry.yaw_transform(1.0, (side / 2, side / 3, 0.5))
    prior_map[known] = geometry.transform(T, query[: len(known)]) + rng.normal(
        0, 0.15, (len(known), 3)
    )

    def match() -> inputs.MatchProblem:
        k = MatchingConfig().neighbours
        indices, distances = _native.knn(vectors, database, k, threads)
        rows = np.repeat(np.arange(queries), indices.shape[1])
        order = np.argsort(distances, axis=None, kind="stable")
        return inputs.MatchProblem(query, prior_map, rows[order], indices.reshape(-1)[order], T)

    clock = processor_clock if threads == 1 else time.perf_counter
    matching, pose, found = [], [], False
    for _ in range(repeats):
        start = clock()
        problem = match()
        middle = clock()
        found = problem.found(consensus(problem, threads))
        matching.append(1e3 * (middle - start))
        pose.append(1e3 * (clock() - middle))
    memory = sum(array.nbytes for array in (database, prior_map)) + 16 * segments
    return Growth(
        segments,
        queries,
        statistics.median(matching),
        statistics.median(pose),
        memory / 1e6,
        found,
    )
