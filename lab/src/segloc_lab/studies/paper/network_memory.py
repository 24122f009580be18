"""Memory of describing segments, and memory and time of training on one batch (Linux)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from segloc.descriptors.pointset import Layer

from ...bench.harness import interleaved, optional
from ...bench.network import DIM, build, prepared_segments, random_tensors
from ...memory import rise_mb

_DISTINCT = 300


def inference_mb(layers: Sequence[Layer], segments: int = 300, threads: int = 1) -> float:
    """Peak of describing prepared segments, beyond the segments themselves and the weights."""
    prepared = np.tile(prepared_segments(_DISTINCT), (-(-segments // _DISTINCT), 1, 1))[:segments]
    engine = build(layers, random_tensors(layers))
    return rise_mb(lambda: engine.describe(prepared, threads))


def saved_mb(layers: Sequence[Layer], batch: int = 100) -> float:
    """Activations that PyTorch keeps for the backward pass of a batch, each storage once."""
    torch, model, points = _training(layers, batch)
    sizes: dict[int, int] = {}
    kept: list[Any] = []

    def pack(tensor: Any) -> Any:
        storage = tensor.untyped_storage()
        sizes[storage.data_ptr()] = storage.nbytes()
        kept.append(tensor)  # alive, so that no address is used twice
        return tensor

    with torch.autograd.graph.saved_tensors_hooks(pack, lambda tensor: tensor):
        model(points).square().sum().backward()
    weights = {p.untyped_storage().data_ptr() for p in model.parameters()}
    return sum(size for address, size in sizes.items() if address not in weights) / 1e6


def training_peak_mb(layers: Sequence[Layer], batch: int = 100) -> float:
    """Peak of one forward and backward pass, by the memory of the process."""
    _, model, points = _training(layers, batch)
    return rise_mb(lambda: model(points).square().sum().backward())


def step_ms(layers: Sequence[Layer], batch: int = 100, repeats: int = 3) -> float:
    """Milliseconds of one forward and backward pass on one thread, the median."""
    torch, model, points = _training(layers, batch)
    torch.set_num_threads(1)
    work = {"step": lambda: model(points).square().sum().backward()}
    return interleaved(work, 1, repeats)["step"]


def has_gpu() -> bool:
    """Whether PyTorch finds a CUDA device."""
    found = optional("torch")
    return found is not None and bool(found[0].cuda.is_available())


def training_gpu_mb(layers: Sequence[Layer], batch: int = 100) -> float:
    """Peak of the tensors on a CUDA device in one forward and backward pass, beyond the model."""
    from ...training.models import neighbors_of

    torch, model, points = _training(layers, batch)
    neighbors = [index.cuda() for index in neighbors_of(points.numpy(), layers)]
    model, points = model.cuda(), points.cuda()
    torch.cuda.reset_peak_memory_stats()
    before = torch.cuda.memory_allocated()
    model(points, *neighbors).square().sum().backward()
    return float(torch.cuda.max_memory_allocated() - before) / 1e6


def _training(layers: Sequence[Layer], batch: int) -> tuple[Any, Any, Any]:
    from ...training.models import DescriptorNetwork

    found = optional("torch")
    assert found is not None
    torch = found[0]
    torch.manual_seed(0)
    model = DescriptorNetwork(layers, DIM).train()
    return torch, model, torch.from_numpy(prepared_segments(batch))
