"""Clustering of a local cloud, descriptor search, and candidate poses."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from segloc import geometry
from segloc.errors import SeglocError
from segloc.likelihood import Aligner
from segloc.proposals import MatchingConfig, PoseConfig
from segloc.system import kernels
from segloc.types import Float32, Float64, Int64, Pose

from . import harness
from .harness import OURS, Bound, MatchProblem, Row, optional, row

VOXEL_M, CORRESPONDENCE_M, RADIUS_M = 0.8, 1.5, 45.0
TOLERANCE_M = 0.1


def icp(threads: int, repeats: int) -> Row:
    """From a first guess half a metre off, and from raw clouds: both are thinned, and normals are
    found, in every run.
    """
    plaza = harness.Plaza()
    truth = geometry.yaw_transform(0.4, (3.0, -2.0, 1.5))
    query = _structure(plaza, truth, seed=1)
    mapped = np.concatenate(
        [_placed(plaza, x, y) for x in (-20.0, 0.0, 20.0) for y in (-20.0, 20.0)]
    )
    mapped = mapped[np.hypot(*(mapped[:, :2] - truth[:2, 3]).T) < RADIUS_M]
    guess = truth @ geometry.yaw_transform(0.03, (0.4, -0.3, 0.1))
    runs: dict[str, Any] = {OURS: lambda: ours(mapped, query, guess, threads)}
    rival = optional("small_gicp")
    if rival is not None:
        runs["small_gicp"] = lambda: prepared_and_aligned(rival[0], mapped, query, guess, threads)
    errors = {
        f"{name}, metres off": float(np.linalg.norm((geometry.inverse(truth) @ run())[:3, 3]))
        for name, run in runs.items()
    }
    if max(errors.values()) > TOLERANCE_M:
        raise SeglocError(f"a cloud was not aligned: {errors}")
    skipped = () if rival else ("small_gicp",)
    bound = Bound("reading both clouds", bytes=float(mapped.nbytes + query.nbytes))
    return row("icp", threads, repeats, runs, bound=bound, details=errors, skipped=skipped)


def ours(mapped: Float32, query: Float32, guess: Pose, threads: int) -> Pose:
    aligner = Aligner(VOXEL_M, CORRESPONDENCE_M, threads)
    aligned = aligner.align(aligner.surface(mapped), aligner.surface(query), guess)
    if aligned is None:
        raise SeglocError("a cloud was not aligned")
    return aligned.T_target_source


def prepared_and_aligned(
    small_gicp: Any, mapped: Float32, query: Float32, guess: Pose, threads: int
) -> Float64:
    target, tree = small_gicp.preprocess_points(
        mapped.astype(np.float64), VOXEL_M, num_threads=threads
    )
    source, _ = small_gicp.preprocess_points(query.astype(np.float64), VOXEL_M, num_threads=threads)
    result = small_gicp.align(
        target,
        source,
        tree,
        guess,
        "GICP",
        max_correspondence_distance=CORRESPONDENCE_M,
        num_threads=threads,
    )
    return np.array(result.T_target_source)


def _structure(plaza: harness.Plaza, T_world_sensor: Pose, seed: int) -> Float32:
    return np.ascontiguousarray(plaza.scan(T_world_sensor, seed=seed).points)


def _placed(plaza: harness.Plaza, x: float, y: float) -> Float32:
    """What is seen from a place, in the world."""
    T = geometry.yaw_transform(0.0, (x, y, 1.5))
    return geometry.transform(T, _structure(plaza, T, seed=100 + int(x + y))).astype(np.float32)


SAMPLE, POSES, NEAR_M = 1000, 24, 0.4
"""Points of a query that are compared with the map at each of some poses."""


def overlap(threads: int, repeats: int) -> Row:
    """Distances of 1000 points to the nearest of the map at 24 poses, cut at 0.4 m."""
    plaza = harness.Plaza()
    rng = np.random.default_rng(0)
    truth = geometry.yaw_transform(0.4, (3.0, -2.0, 1.5))
    points = rng.permutation(_structure(plaza, truth, seed=1))[:SAMPLE].copy()
    mapped = kernels.voxel_grid(plaza.points.astype(np.float32), 0.2)
    shifts = rng.normal(0, 1.0, (POSES, 2))
    poses = np.stack([geometry.yaw_transform(0.4, (3 + x, -2 + y, 1.5)) for x, y in shifts])
    index, tree = kernels.PointIndex(mapped, NEAR_M), cKDTree(mapped)

    def by_tree() -> Float64:
        moved = np.stack([geometry.transform(T, points) for T in poses])
        gaps, _ = tree.query(moved, distance_upper_bound=NEAR_M, workers=threads)
        return np.asarray(np.isfinite(gaps).mean(axis=1))

    runs: dict[str, Any] = {
        OURS: lambda: index.overlap(points, poses, NEAR_M),
        "SciPy, k-d tree": by_tree,
    }
    bound = Bound("reading the points once a pose", bytes=float(points.nbytes * POSES))
    return row("overlap", threads, repeats, runs, bound=bound)


CLUSTER_RADIUS_M = 0.5
QUERIES, DATABASE, DIM = 300, 50_000, 16
VOTE_PRODUCTS = 6
"""Products of one match that votes for a translation at one yaw."""

YAW_STEP_M = 1.6
"""How far a step of yaw moves a segment at the root mean square distance, in the consensus."""


def clustering(threads: int, repeats: int) -> Row:
    """Exact Euclidean clusters; every rival must find the same partition. One thread always."""
    points = harness.local_cloud()
    runs: dict[str, Any] = {
        OURS: lambda: _labels(kernels.euclidean_clusters(points, CLUSTER_RADIUS_M, 1, len(points))),
        "SciPy, k-d tree and components": lambda: tree_components(points, CLUSTER_RADIUS_M),
    }
    sklearn = optional("sklearn.cluster")
    if sklearn is not None:
        dbscan = sklearn[0].DBSCAN(eps=CLUSTER_RADIUS_M, min_samples=1, n_jobs=threads)
        runs["scikit-learn DBSCAN"] = lambda: dbscan.fit_predict(points)
    reference = runs[OURS]()
    for name, run in runs.items():
        if not same_partition(reference, run()):
            raise SeglocError(f"{name} finds other clusters")
    runs[OURS] = partial(kernels.euclidean_clusters, points, CLUSTER_RADIUS_M, 1, len(points))
    skipped = () if sklearn else ("scikit-learn",)
    details = {"points": float(len(points)), "clusters": float(reference.max() + 1)}
    bound = Bound("reading its points", bytes=float(points.nbytes))
    return row("clustering", threads, repeats, runs, bound=bound, details=details, skipped=skipped)


def tree_components(points: Float32, radius: float) -> Int64:
    """Cluster of every point by SciPy."""
    pairs = cKDTree(points).query_pairs(radius, output_type="ndarray")
    links = (np.ones(len(pairs), np.int8), (pairs[:, 0], pairs[:, 1]))
    graph = coo_array(links, shape=(len(points), len(points)))
    return np.asarray(connected_components(graph, directed=False)[1], dtype=np.int64)


def _labels(clusters: tuple[np.ndarray, Int64]) -> Int64:
    members, offsets = clusters
    labels = np.empty(len(members), np.int64)
    labels[members] = np.repeat(np.arange(len(offsets) - 1), np.diff(offsets))
    return labels


def same_partition(a: np.ndarray, b: np.ndarray) -> bool:
    """Whether two labellings part the points alike."""
    pairs = np.unique(np.stack([a, b]), axis=1).shape[1]
    return bool(pairs == len(np.unique(a)) == len(np.unique(b)))


def knn(threads: int, repeats: int) -> Row:
    """The 25 nearest of 50 000 descriptors for each of 300, exactly."""
    k = MatchingConfig().neighbours
    database = harness.descriptors(DATABASE, DIM)
    queries = database[:QUERIES] + harness.descriptors(QUERIES, DIM, seed=1, spread=0.3)
    tree, index = cKDTree(database), kernels.DescriptorIndex(database, 1, threads)
    runs: dict[str, Any] = {
        OURS: lambda: index.search(queries, k, 1, threads)[0],
        "NumPy, product and partition": partial(product_and_partition, queries, database, k),
        "SciPy, k-d tree": lambda: tree.query(queries, k, workers=threads)[1],
    }
    faiss = optional("faiss")
    if faiss is not None:
        faiss[0].omp_set_num_threads(threads)
        flat = faiss[0].IndexFlatL2(DIM)
        flat.add(database)
        runs["faiss IndexFlatL2"] = lambda: flat.search(queries, k)[1]
    reference = np.sort(runs[OURS](), axis=1)
    for name, run in runs.items():
        if (np.sort(run(), axis=1) == reference).mean() < 0.9999:  # rounding may swap the last
            raise SeglocError(f"{name} finds other neighbours")
    bound = Bound("all products", flops=2.0 * QUERIES * DATABASE * DIM)
    skipped = () if faiss else ("faiss-cpu",)
    note = "blocks of the map that are too far are skipped, so it may take less than the bound"
    return row("knn", threads, repeats, runs, bound=bound, skipped=skipped, note=note)


def product_and_partition(queries: Float32, database: Float32, k: int) -> Int64:
    """Nearest neighbours by NumPy: one matrix product, then a partial sort a row."""
    squared = (database**2).sum(axis=1) - 2.0 * (queries @ database.T)
    nearest = np.argpartition(squared, k, axis=1)[:, :k]
    order = np.take_along_axis(squared, nearest, axis=1).argsort(axis=1)
    found: Int64 = np.take_along_axis(nearest, order, axis=1)
    return found


def pose(threads: int, repeats: int) -> Row:
    """The pose that 75 of 7500 matches agree on, in a map of a square kilometre."""
    problem = harness.match_problem()
    runs: dict[str, Any] = {
        OURS: partial(consensus, problem, threads),
        "segloc, PROSAC": partial(prosac, problem),
    }
    kiss = optional("kiss_matcher")
    if kiss is not None:
        runs["kiss-matcher prune_and_solve"] = partial(prune_and_solve, kiss[0], problem)
    details = {f"{name}, found": float(problem.found(run())) for name, run in runs.items()}
    if not details[f"{OURS}, found"]:
        raise SeglocError("the consensus missed the true pose")
    bound = Bound("the products of its votes", flops=2.0 * _votes(problem) * VOTE_PRODUCTS)
    return row(
        "pose",
        threads,
        repeats,
        runs,
        bound=bound,
        details=details,
        skipped=() if kiss else ("kiss-matcher",),
        note="a vote adds to a cell somewhere in memory, which takes longer than its products",
    )


def consensus(problem: MatchProblem, threads: int) -> Float64:
    """Poses by consensus with the defaults of the configuration."""
    names = {"inlier_tolerance", "height_tolerance", "distinct_radius", "max_refined"}
    return kernels.consensus(*_matched(problem), threads=threads, **_options(names))[0]


def prosac(problem: MatchProblem) -> Float64:
    """Poses by PROSAC with the defaults of the configuration."""
    names = {"edge_tolerance", "inlier_tolerance", "min_edge", "chance", "max_draws"}
    options = _options(names)
    return kernels.prosac(*_matched(problem), ordered=True, seed=0, **options)[0]


def _matched(problem: MatchProblem) -> tuple[Float64, Float64, Int64, Int64]:
    return problem.query, problem.mapped, problem.match_query, problem.match_map


def _options(names: set[str]) -> dict[str, Any]:
    """Defaults of the configuration, as the kernels take them."""
    config = PoseConfig()
    return {
        **config.model_dump(include=names),
        "separation": config.separation.metres,
        "separation_deg": config.separation.degrees,
        "max_hypotheses": config.max_candidates,
    }


def prune_and_solve(kiss: Any, problem: MatchProblem) -> Float64:
    """The pose by kiss-matcher's graph pruning and robust solver."""
    matcher = kiss.KISSMatcher(kiss.KISSMatcherConfig(0.3))
    source = list(problem.query[problem.match_query])
    target = list(problem.mapped[problem.match_map])
    solution = matcher.prune_and_solve(source, target)
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = solution.rotation, solution.translation
    return T[None]


def _votes(problem: MatchProblem) -> float:
    """Matches times steps of yaw: how often a translation is voted for."""
    voters = problem.query[problem.match_query, :2]
    radius = float(np.sqrt(((voters - voters.mean(axis=0)) ** 2).sum(axis=1).mean()))
    return len(voters) * float(np.ceil(2.0 * np.pi * radius / YAW_STEP_M))
