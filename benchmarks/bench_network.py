"""The descriptor network against PyTorch and ONNX Runtime, and DSM against ESM.

``python benchmarks/bench_network.py``
"""

from segloc.evaluation.bench.report import main

if __name__ == "__main__":
    main("network", "dsm_vs_esm")
