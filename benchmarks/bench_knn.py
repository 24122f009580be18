"""Exact descriptor search against NumPy, SciPy and faiss: ``python benchmarks/bench_knn.py``."""

from segloc.evaluation.bench.report import main

if __name__ == "__main__":
    main("knn")
