"""Weights files of trained networks and forests, as the descriptors of segloc read them."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from segloc.descriptors import pointset, random_forest, segmap
from segloc.descriptors.pointset import Alignment, Layer
from segloc.descriptors.random_forest import Layout, Trees
from segloc.descriptors.weightfile import write_weights
from segloc.types import Float32


def write_network(
    path: Path,
    tensors: Mapping[str, Float32],
    layers: Sequence[Layer],
    alignment: Alignment,
    card: Mapping[str, Any],
) -> None:
    """Write a weights file with its layer table, card and hash.

    ``card`` is the origin of the weights: data, command, figures, licence.
    """
    settings = {
        "points": str(pointset.POINTS),
        "layers": json.dumps([asdict(layer) for layer in layers]),
        "alignment": alignment,
    }
    write_weights(path, pointset.KIND, tensors, settings, card)


def write_segmap(path: Path, tensors: Mapping[str, Float32], card: Mapping[str, Any]) -> None:
    """Write a weights file with its card and hash.

    Parameters
    ----------
    path : Path
    tensors : dict of str to array
        Float32: conv1.weight (3, 3, 3, 1, 32), conv2.weight (3, 3, 3, 32, 64), conv3.weight
        (3, 3, 3, 64, 64), fc1.weight (16387, 512), fc2.weight (512, 64), and a bias for each. The
        first dense layer reads the features by x, y, z and channel, then the three scales.
    card : dict
        Origin of the weights: data, command, figures, licence.
    """
    stored: dict[str, NDArray[Any]] = {
        name: np.ascontiguousarray(tensor, np.float32) for name, tensor in tensors.items()
    }
    stored[segmap.QUANTIZED], stored[segmap.SCALE] = _quantized(stored[segmap.QUANTIZED])
    settings = {"preprocessing": str(segmap.PREPROCESSING_VERSION)}
    write_weights(path, segmap.KIND, stored, settings, card)


def _quantized(weight: Float32) -> tuple[NDArray[np.int8], Float32]:
    """Quantize an (inputs, outputs) matrix to int8, with a scale per output."""
    largest = np.abs(weight).max(axis=0)
    scale = np.where(largest > 0, largest / 127, 1).astype(np.float32)
    return np.rint(weight / scale).astype(np.int8), scale


def write_forest(
    path: Path, trees: Trees, layout: Layout, fingerprint: str, card: Mapping[str, Any]
) -> None:
    """Write a forest for descriptors of a fingerprint.

    ``card`` is the origin of the forest: data, command, figures, licence.
    """
    settings = {"descriptor": fingerprint, "layout": json.dumps(asdict(layout), sort_keys=True)}
    write_weights(path, random_forest.KIND, trees.arrays(), settings, card)
