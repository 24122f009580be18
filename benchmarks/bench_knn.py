"""Exact nearest descriptors of 300 queries, on one thread."""

from __future__ import annotations

import os

for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(variable, "1")

from collections.abc import Callable

import numpy as np
from scipy.spatial import cKDTree
from timing import best_ms, instruction_sets, table

from segloc import _native

CASES = ((300, 5_000, 16, 25), (300, 50_000, 16, 25), (300, 50_000, 7, 25), (300, 50_000, 7, 200))


def matrix(queries: np.ndarray, database: np.ndarray, k: int) -> np.ndarray:
    """The whole distance matrix by a matrix product, then a partial sort."""
    distance = (database**2).sum(axis=1) - 2 * queries @ database.T
    return np.argpartition(distance, k, axis=1)[:, :k]


def rivals(queries: np.ndarray, database: np.ndarray, k: int) -> dict[str, float]:
    tree = cKDTree(database)
    runs: dict[str, tuple[Callable[[], object], int]] = {
        "NumPy product and partition": (lambda: matrix(queries, database, k), 3),
        "SciPy cKDTree (built before)": (lambda: tree.query(queries, k=k), 1),
    }
    try:
        import faiss
    except ImportError:
        print("faiss is not installed: left out")
    else:
        faiss.omp_set_num_threads(1)
        index = faiss.IndexFlatL2(database.shape[1])
        index.add(database)
        runs["faiss Flat (filled before)"] = (lambda: index.search(queries, k), 5)
    return {name: best_ms(run, repeats) for name, (run, repeats) in runs.items()}


def compare(Q: int, M: int, D: int, k: int) -> None:
    rng = np.random.default_rng(0)
    queries = rng.normal(size=(Q, D)).astype(np.float32)
    database = rng.normal(size=(M, D)).astype(np.float32)
    ours = {
        isa: best_ms(lambda isa=isa: _native.knn(queries, database, k, 1, isa), 10)
        for isa in instruction_sets()
    }
    title = f"nearest descriptors, {Q} queries, {M} x {D}, k = {k}, one thread"
    table(title, ours, rivals(queries, database, k))


if __name__ == "__main__":
    for case in CASES:
        compare(*case)
