"""SegMap: a convolutional network over the occupancy grid of a segment (arXiv 1909.12837).

Weights are a safetensors file with the tensors listed in cpp/voxel_network.h, channels last, with
batch norms folded into the next linear map. The first dense layer holds 98 % of the parameters and
is stored as int8 with a scale per output: 9 MB instead of 34.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import _native
from ..errors import WeightsError
from ..types import Descriptors, Float32, Int64, Segments
from .base import AS_PUBLISHED, Descriptor, register
from .weightfile import faults_of_weights, read_weights, shipped_weights

GRID = (32, 32, 16)

PREPROCESSING_VERSION = 1
"""Version of `prepare`, increased if its result changes."""

KIND = "voxel network"
QUANTIZED = "fc1.weight"
SCALE = "fc1.weight.scale"


@dataclass(frozen=True)
class VoxelShapes:
    """Occupancy grids of P segments.

    Attributes
    ----------
    voxels : (V,) int32
        Numbers of the occupied voxels, one segment after another; (x, y, z) is number
        (x * 32 + y) * 16 + z.
    offsets : (P + 1,) int64
        Segment i is ``voxels[offsets[i]:offsets[i + 1]]``.
    scales : (P, 3) float32
        Size of the grid [m].
    """

    voxels: NDArray[np.int32]
    offsets: Int64
    scales: Float32

    def __len__(self) -> int:
        return len(self.scales)

    def dense(self) -> Float32:
        """Return dense grids, (P, 32, 32, 16) float32 of zeros and ones, for training."""
        grids = np.zeros((len(self), GRID[0] * GRID[1] * GRID[2]), np.float32)
        grids[np.repeat(np.arange(len(self)), np.diff(self.offsets)), self.voxels] = 1.0
        return grids.reshape(len(self), *GRID)


def prepare(segments: Segments, threads: int = 0) -> VoxelShapes:
    """Align segments as for DSM, scale each axis to the grid and centre on the mean.

    An axis is not stretched beyond 0.1 m per voxel. Independent of the
    order of a segment's points.
    """
    return VoxelShapes(*_native.voxel_shapes(segments.points, segments.offsets, threads))


def load_weights(path: Path) -> tuple[_native.VoxelNetwork, dict[str, Any], str]:
    """Load the network, the card and the hash of a weights file.

    Raises
    ------
    WeightsError
        If the file is missing, truncated, of another format, does not match its hash, or if a
        tensor is missing, unknown, of the wrong shape or dtype, or not finite.
    """
    file = read_weights(path, KIND, {QUANTIZED: np.int8})
    if file.settings.get("preprocessing") != str(PREPROCESSING_VERSION):
        raise WeightsError(f"{path}: made for another preparation of the segments")
    with faults_of_weights(path):
        tensors = dict(file.tensors)
        tensors[QUANTIZED] = tensors[QUANTIZED] * tensors.pop(SCALE)
        return _native.VoxelNetwork(tensors), file.card, file.sha256


class SegMapDescriptor(Descriptor):
    """The 64-number learned descriptor of SegMap.

    Parameters
    ----------
    path : Path
        Weights file.
    threads : int
        0 is all cores; results do not depend on it.

    Raises
    ------
    WeightsError
        If the weights are missing or damaged.
    """

    name = "segmap"

    def __init__(self, path: Path, threads: int = 0) -> None:
        self._network, self.card, digest = load_weights(path)
        self.dim = self._network.dim
        self.fingerprint = f"segmap-{PREPROCESSING_VERSION}-{digest[:16]}"
        self._threads = threads

    def prepare(self, segments: Segments) -> VoxelShapes:
        """Return occupancy grids; see :func:`prepare`."""
        return prepare(segments, self._threads)

    def encode(self, prepared: VoxelShapes) -> Descriptors:
        """Describe prepared segments: (P, 64) float32 vectors."""
        return Descriptors(
            self._network.describe(
                prepared.voxels, prepared.offsets, prepared.scales, self._threads
            )
        )


@register("segmap", preset={"matching": AS_PUBLISHED})
def segmap(threads: int = 0, weights: Path | None = None) -> SegMapDescriptor:
    """Create the descriptor with the shipped weights, or others."""
    return SegMapDescriptor(weights or shipped_weights("segmap.safetensors"), threads)
