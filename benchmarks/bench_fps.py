"""Farthest-point sampling of small clouds against NumPy and fpsample.

``python benchmarks/bench_fps.py``
"""

from segloc.evaluation.bench.report import main

if __name__ == "__main__":
    main("fps")
