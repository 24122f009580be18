"""Descriptors whose weights are not shipped, with random ones: for timing, which cares little."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np

from segloc.descriptors import Descriptor, create, segmap
from segloc.descriptors.pointset import DSM_LAYERS, ESM_LAYERS, PointSetDescriptor, save_weights
from segloc.errors import WeightsError
from segloc.types import Float32

from ..bench.network import random_tensors

_LAYERS = {"dsm": DSM_LAYERS, "dsm-fq": DSM_LAYERS, "esm": ESM_LAYERS, "esm-fq": ESM_LAYERS}


def any_descriptor(name: str, threads: int = 0) -> tuple[Descriptor, bool]:
    """A method's descriptor, and whether its weights had to be drawn; the same ones each time.

    Raises
    ------
    WeightsError
        If weights are missing of a method that is no network known here, or are damaged.
    """
    try:
        return create(name, threads), False
    except WeightsError as error:
        if "no such file" not in str(error) or name not in (*_LAYERS, "segmap"):
            raise
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "random.safetensors"
        if name == "segmap":
            segmap.save_weights(path, voxel_tensors(), {})
            return segmap.SegMapDescriptor(path, threads), True
        layers = _LAYERS[name]
        save_weights(path, random_tensors(layers), layers, "pca2d", {})
        return PointSetDescriptor(name, path, threads=threads), True


def voxel_tensors(seed: int = 0) -> dict[str, Float32]:
    """Weights of SegMap's network, of the right shapes and sizes of value."""
    rng = np.random.default_rng(seed)
    shapes = {
        "conv1": (3, 3, 3, 1, 32),
        "conv2": (3, 3, 3, 32, 64),
        "conv3": (3, 3, 3, 64, 64),
        "fc1": (16387, 512),
        "fc2": (512, 64),
    }
    tensors = {}
    for name, shape in shapes.items():
        bound = np.sqrt(6 / np.prod(shape[:-1]))
        tensors[f"{name}.weight"] = rng.uniform(-bound, bound, shape).astype(np.float32)
        tensors[f"{name}.bias"] = np.full(shape[-1], 0.05, np.float32)
    return tensors
