"""Inference of the descriptor networks: 300 segments, neighbour search included."""

from __future__ import annotations

import io
import warnings
from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np

from segloc.descriptors.pointset import DSM_LAYERS, ESM_LAYERS, POINTS, Layer
from segloc.errors import SeglocError
from segloc.system import kernels
from segloc.types import Float32

from . import harness
from .harness import OURS, Bound, Row, optional, row

SEGMENTS, DIM = 300, 16
CHUNKS = (10, 30, 100)


def network(threads: int, repeats: int) -> Row:
    """DSM against PyTorch and ONNX Runtime, which are handed the neighbours for nothing."""
    prepared = prepared_segments(SEGMENTS)
    bound = Bound("its arithmetic", flops=float(sum(layer_flops(DSM_LAYERS)) * SEGMENTS))
    torch = optional("torch")
    if torch is None:
        engine = build(DSM_LAYERS, random_tensors(DSM_LAYERS))
        runs = {OURS: partial(engine.describe, prepared, threads)}
        return row("network", threads, repeats, runs, bound=bound, skipped=("torch", "onnxruntime"))
    model, tensors = _torch_model(torch[0], threads)
    engine = build(DSM_LAYERS, tensors)
    runs = {OURS: partial(engine.describe, prepared, threads)}
    for size in CHUNKS:
        runs[f"PyTorch, {size} at a time"] = _torch_run(torch[0], model, prepared, size)
    found = optional("onnx", "onnxscript", "onnxruntime")
    if found is not None:
        name, size = "ONNX Runtime, 30 at a time", 30
        runs[name] = _onnx_run((torch[0], found[2]), model, prepared, size, threads)
    _check(runs)
    skipped = () if found else ("onnxruntime",)
    return row("network", threads, repeats, runs, bound=bound, skipped=skipped)


def dsm_vs_esm(threads: int, repeats: int) -> Row:
    """The paper's comparison on one engine: DSM's time, ESM as the rival."""
    prepared = prepared_segments(SEGMENTS)
    both: dict[str, Sequence[Layer]] = {"dsm": DSM_LAYERS, "esm": ESM_LAYERS}
    flops = {name: sum(layer_flops(layers)) for name, layers in both.items()}
    runs = {
        name: partial(build(layers, random_tensors(layers)).describe, prepared, threads)
        for name, layers in zip((OURS, "esm"), both.values(), strict=True)
    }
    bound = Bound("its arithmetic", flops=float(flops["dsm"] * SEGMENTS))
    details = {f"{name}, MFLOP a segment": count / 1e6 for name, count in flops.items()}
    return row("dsm_vs_esm", threads, repeats, runs, bound=bound, details=details)


def prepared_segments(count: int) -> Float32:
    """Synthetic segments as the network reads them, (count, 256, 3)."""
    points = harness.segments(count, 400).reshape(-1, 3)
    offsets = np.arange(count + 1, dtype=np.int64) * 400
    return kernels.prepare_segments(points, offsets, POINTS)


def build(layers: Sequence[Layer], tensors: dict[str, Float32]) -> kernels.Network:
    """The native engine for a layer table."""
    rows = [(each.points, each.neighbors, each.dilation, each.channels) for each in layers]
    return kernels.Network(rows, tensors, POINTS)


def layer_widths(layers: Sequence[Layer]) -> list[tuple[int, int, int]]:
    """(lifted channels, channels before, depth multiplier) of every X-conv layer."""
    widths, before = [], 0
    for layer in layers:
        C = layer.channels
        widths.append((before // 4 if before else C // 2, before, -(-C // before) if before else 4))
        before = C
    return widths


def layer_flops(layers: Sequence[Layer]) -> list[int]:
    """Floating-point operations of one segment in every X-conv layer; products and sums."""
    counts = []
    for layer, (lifted, before, depth) in zip(layers, layer_widths(layers), strict=True):
        K, channels = layer.neighbors, lifted + before
        transform = 3 * K**3 + 2 * K**3
        lift = K * (3 * lifted + lifted**2)
        mix = K * K * channels + K * channels * depth + channels * depth * layer.channels
        counts.append(2 * layer.points * (transform + lift + mix))
    return counts


def random_tensors(layers: Sequence[Layer], seed: int = 0) -> dict[str, Float32]:
    """Weights of the right shapes and sizes of value; time does not depend on what they say."""
    rng = np.random.default_rng(seed)
    shapes: dict[str, tuple[int, ...]] = {}
    for index, (layer, (c, i, m)) in enumerate(zip(layers, layer_widths(layers), strict=True)):
        K, o = layer.neighbors, layer.channels
        part = {"lift1.weight": (3, c), "lift2.weight": (c, c), "lift2.bias": (c,)}
        part |= {"lift2.scale": (c,), "lift2.shift": (c,), "x0.weight": (3 * K, K, K)}
        part |= {
            f"{x}.{kind}": (K,) * n
            for x in ("x1", "x2")
            for kind, n in (("weight", 3), ("bias", 2))
        }
        part |= {"depthwise.weight": (K, c + i, m), "pointwise.weight": ((c + i) * m, o)}
        part |= {"pointwise.scale": (o,), "pointwise.shift": (o,)}
        shapes |= {f"layers.{index}.{name}": shape for name, shape in part.items()}
    C = layers[-1].channels
    g = C // 4
    shapes |= {"global1.weight": (3, g), "global2.weight": (g, g)}
    shapes |= {f"global2.{kind}": (g,) for kind in ("bias", "scale", "shift")}
    for name, (inputs_, outputs) in {
        "fc1": (C + g, 256),
        "fc2": (256, 128),
        "fc3": (128, DIM),
        "quality": (DIM, 1),
    }.items():
        shapes |= {f"{name}.weight": (inputs_, outputs), f"{name}.bias": (outputs,)}
    return {
        name: (rng.normal(0, 1, shape) / np.sqrt(shape[0])).astype(np.float32)
        for name, shape in shapes.items()
    }


def _torch_model(torch: Any, threads: int) -> tuple[Any, dict[str, Float32]]:
    from ..training.models import DescriptorNetwork, folded

    torch.manual_seed(0)
    torch.set_num_threads(threads)
    model = DescriptorNetwork(DSM_LAYERS, DIM).eval()
    return model, folded(model)


def _chunks(torch: Any, model: Any, prepared: Float32, size: int) -> list[tuple[Any, ...]]:
    """(points, neighbours of every layer) of every chunk."""
    from ..training.models import neighbors_of

    starts = range(0, len(prepared), size)
    parts = [np.ascontiguousarray(prepared[k : k + size]) for k in starts]
    return [(torch.from_numpy(part), *neighbors_of(part, model.layers)) for part in parts]


def _torch_run(torch: Any, model: Any, prepared: Float32, size: int) -> Any:
    from ..training.models import torch_forms

    chunks = _chunks(torch, model, prepared, size)

    def run() -> Float32:
        with torch_forms(), torch.inference_mode():
            result: Float32 = torch.cat([model(*chunk) for chunk in chunks]).numpy()
        return result

    return run


def _onnx_run(
    modules: tuple[Any, Any], model: Any, prepared: Float32, size: int, threads: int
) -> Any:
    """Export the model to ONNX Runtime, and run it over chunks of the segments."""
    from ..training.models import torch_forms

    torch, runtime = modules
    chunks = _chunks(torch, model, prepared, size)
    names = ["points", *(f"neighbours{k}" for k in range(len(chunks[0]) - 1))]
    file = io.BytesIO()
    with torch_forms(), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        torch.onnx.export(model, chunks[0], file, input_names=names, dynamo=False)
    options = runtime.SessionOptions()
    options.intra_op_num_threads, options.inter_op_num_threads = threads, 1
    session = runtime.InferenceSession(file.getvalue(), options, providers=["CPUExecutionProvider"])
    feeds = [dict(zip(names, (t.numpy() for t in chunk), strict=True)) for chunk in chunks]
    return lambda: np.concatenate([session.run(None, feed)[0] for feed in feeds])


def _check(runs: dict[str, Any]) -> None:
    ours, _ = runs[OURS]()
    for name, run in runs.items():
        if name != OURS and not np.allclose(run(), ours, rtol=1e-2, atol=1e-3):
            raise SeglocError(f"{name} describes the segments otherwise")
