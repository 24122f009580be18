"""Descriptors of 300 prepared segments, on one thread, against PyTorch and ONNX Runtime."""

from __future__ import annotations

import os

for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(variable, "1")

import sys
import tempfile
from pathlib import Path

import numpy as np
import torch
from timing import best_ms, instruction_sets, table

from segloc import _native
from segloc.descriptors.pointset import Layer
from segloc.training.export import folded
from segloc.training.models import LAYERS, DescriptorNetwork

P = 300


def prepared() -> np.ndarray:
    rng = np.random.default_rng(0)
    points = rng.normal(size=(P * 400, 3)).astype(np.float32) * np.float32([3, 1, 1])
    return _native.prepare_segments(points, np.arange(P + 1, dtype=np.int64) * 400)


def multiplications(layers: tuple[Layer, ...]) -> int:
    """Multiply-adds of one segment."""
    total, inputs = 0, 0
    for layer in layers:
        K, C = layer.neighbors, layer.channels
        lifted, depth = (inputs // 4, -(-C // inputs)) if inputs else (C // 2, 4)
        channels = lifted + inputs
        total += layer.points * (
            5 * K**3 + K * lifted * (3 + lifted) + K * K * channels + depth * channels * (K + C)
        )
        inputs = C
    G = inputs // 4
    total += layers[-1].points * G * (3 + G)
    return total + (inputs + G) * 256 + 256 * 128 + 128 * 16


def sgemm_gflops() -> float:
    """The best matrix product on one core: NumPy's or PyTorch's."""
    a = np.random.default_rng(0).random((1536, 1536), np.float32)
    t = torch.from_numpy(a)
    ms = min(best_ms(lambda: a @ a, 5), best_ms(lambda: t @ t, 5))
    return 2e-6 * 1536**3 / ms


@torch.no_grad()
def eager(model: DescriptorNetwork, segments: np.ndarray, chunk: int) -> float:
    batches = [torch.from_numpy(segments[i : i + chunk]) for i in range(0, P, chunk)]
    return best_ms(lambda: [model(batch) for batch in batches], 2)


@torch.no_grad()
def onnx(model: DescriptorNetwork, segments: np.ndarray, chunk: int) -> float | None:
    """ONNX Runtime on the same network; it is given the neighbours."""
    try:
        import onnx  # noqa: F401 (what torch.onnx writes with)
        import onnxruntime
    except ImportError:
        print("onnx or onnxruntime is not installed: left out")
        return None

    class Given(torch.nn.Module):
        def __init__(self) -> None:
            super().__init__()
            self.model = model

        def forward(self, points: torch.Tensor, *neighbors: torch.Tensor) -> torch.Tensor:
            self.model.neighbors = lambda _: list(neighbors)
            return self.model(points)

    batches = []
    for i in range(0, P, chunk):
        points = torch.from_numpy(segments[i : i + chunk])
        batches.append((points, *model.neighbors(points)))
    names = ["points", *(f"neighbors{i}" for i in range(len(model.layers)))]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "network.onnx"
        torch.onnx.export(Given(), batches[0], path, input_names=names, dynamo=False)
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = 1
        session = onnxruntime.InferenceSession(str(path), options)
    feeds = [
        dict(zip(names, (t.numpy() for t in batch), strict=True))
        for batch in batches
        if len(batch[0]) == chunk
    ]
    return best_ms(lambda: [session.run(None, feed) for feed in feeds], 2)


def main(names: list[str]) -> None:
    torch.set_num_threads(1)
    segments = prepared()
    peak = sgemm_gflops()
    for name in names:
        model = DescriptorNetwork(LAYERS[name]).eval()
        specs = [(x.points, x.neighbors, x.dilation, x.channels) for x in model.layers]
        tensors = folded(model)
        ours, search = {}, {}
        for isa in instruction_sets():
            network = _native.Network(specs, tensors, 256, isa)
            ours[isa] = best_ms(lambda net=network: net.describe(segments, 1), 10)
            sources = 256
            search[isa] = 0.0
            for n, k, d, _ in specs:
                given = (segments, sources, n, k, d, 1, isa)
                search[isa] += best_ms(lambda g=given: _native.dilated_neighbors(*g), 5)
                sources = n
        rivals = {f"PyTorch, chunks of {c}": eager(model, segments, c) for c in (5, 10, 30, P)}
        through_onnx = onnx(model, segments, 30)
        if through_onnx is not None:
            rivals["ONNX Runtime, chunks of 30, neighbours given"] = through_onnx
        table(f"{name}: {P} segments, one thread, with neighbour search", ours, rivals)
        operations = 2e-6 * P * multiplications(model.layers)
        for isa, ms in ours.items():
            without = ms - search[isa]
            print(
                f"  {isa}: neighbour search {search[isa]:.1f} ms; the network alone "
                f"{operations / without:.0f} GFLOP/s = {operations / without / peak:.0%} of sgemm "
                f"({peak:.0f}); all together {operations / ms / peak:.0%}"
            )


if __name__ == "__main__":
    main(sys.argv[1:] or ["dsm", "esm"])
