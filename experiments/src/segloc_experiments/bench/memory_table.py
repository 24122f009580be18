"""Memory of inference and of training, DSM against ESM: ``python benchmarks/bench_memory.py``."""

from segloc.descriptors.pointset import DSM_LAYERS, ESM_LAYERS

from .harness import in_process, optional
from .memory import inference_mb, saved_mb, training_peak_mb

BATCH = 100

if __name__ == "__main__":
    for threads in (1, 2):
        for count in (300, 3000):
            peaks = [
                in_process(1, inference_mb, x, count, threads) for x in (DSM_LAYERS, ESM_LAYERS)
            ]
            print(
                f"describing {count} segments, {threads} thread(s): "
                f"DSM {peaks[0]:.1f} MB, ESM {peaks[1]:.1f} MB over the input"
            )
    if optional("torch") is None:
        print("torch is not installed: training is left out")
    else:
        for name, work in (("saved activations", saved_mb), ("peak memory", training_peak_mb)):
            dsm, esm = (in_process(1, work, layers, BATCH) for layers in (DSM_LAYERS, ESM_LAYERS))
            less = 100 * (1 - dsm / esm)
            print(f"training, batch of {BATCH}, {name}: DSM {dsm:.0f} MB, ESM {esm:.0f} MB", end="")
            print(f", {less:.0f} % less")
