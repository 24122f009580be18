"""The networks on a GPU, through the training framework, where there are both."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np

from segloc.descriptors.pointset import prepare
from segloc.descriptors.segmap import prepare as voxelised
from segloc.types import Segments

from ...bench.harness import optional

GPU_METHODS = ("segmap", "esm", "dsm")


def gpu_ms(
    queries: Sequence[Segments], methods: Sequence[str], repeats: int, device: str = "cuda"
) -> dict[str, Any]:
    """Milliseconds to prepare the segments of a query and to describe them on a GPU.

    The networks have random weights: time does not depend on what they say. Neighbours are found
    on the CPU and count as preparation; copies to the GPU and back count as description.

    Returns
    -------
    dict
        "device", and in "times" the medians (prepare, describe) by method; empty without a GPU.
    """
    found = optional("torch")
    if found is None or (device == "cuda" and not found[0].cuda.is_available()):
        return {}
    torch = found[0]
    times = {}
    for method in methods:
        inputs, network = _network(torch, method, device)
        samples = []
        for repeat in range(repeats + 1):
            for segments in queries:
                sample = _timed(torch, network, partial(inputs, segments), device)
                if repeat:  # the first round warms up
                    samples.append(sample)
        times[method] = [statistics.median(each[k] for each in samples) for k in (0, 1)]
    name = torch.cuda.get_device_name() if device == "cuda" else device
    return {"device": name, "times": times}


def _timed(
    torch: Any, network: Any, inputs: Callable[[], list[Any]], device: str
) -> tuple[float, float]:
    start = time.perf_counter()
    prepared = inputs()
    middle = time.perf_counter()
    with torch.inference_mode():
        network(*(tensor.to(device) for tensor in prepared)).cpu()
    end = time.perf_counter()
    return 1e3 * (middle - start), 1e3 * (end - middle)


def _network(torch: Any, method: str, device: str) -> tuple[Callable[[Segments], list[Any]], Any]:
    """What makes tensors of segments, and the network that reads them."""
    torch.manual_seed(0)
    if method == "segmap":
        from ...training.segmap import SegMapNetwork

        network = SegMapNetwork(1).eval().to(device)

        def grids(segments: Segments) -> list[Any]:
            shapes = voxelised(segments)
            return [torch.from_numpy(shapes.dense()), torch.from_numpy(shapes.scales)]

        return grids, network.describe
    from ...training.models import LAYERS, DescriptorNetwork, neighbors_of

    layers = LAYERS[method]

    def points(segments: Segments) -> list[Any]:
        prepared = np.ascontiguousarray(prepare(segments, "pca2d", 0))
        return [torch.from_numpy(prepared), *neighbors_of(prepared, layers, 0)]

    return points, DescriptorNetwork(layers).eval().to(device)
