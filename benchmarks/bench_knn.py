"""Exact nearest descriptors against faiss, NumPy and SciPy.

``python benchmarks/bench_knn.py``
"""

from segloc.evaluation.bench.report import main

if __name__ == "__main__":
    main("knn")
