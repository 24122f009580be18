"""Learned point-set descriptors: layer tables, weight files, and inference.

The network is X-convolutional (Li et al., "PointCNN", NeurIPS 2018). A segment becomes 256 points
in the order of farthest-point sampling, so each layer's points are a prefix of them.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal, cast, get_args

import numpy as np
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save_file

from .. import _native
from ..errors import WeightsError
from ..types import Descriptors, Float32, Segments
from .base import Descriptor

Alignment = Literal["none", "pca2d", "pca3d"]

POINTS = 256
"""Points of a prepared segment."""

PREPROCESSING_VERSION = 1
"""Counts changes of `prepare` that change its result."""

_FORMAT = "segloc network"
_FORMAT_VERSION = "1"


@dataclass(frozen=True)
class Layer:
    """One X-conv layer: N representative points, K neighbours, dilation D, C channels."""

    points: int
    neighbors: int
    dilation: int
    channels: int


DSM_LAYERS = (
    Layer(160, 8, 1, 32),
    Layer(96, 10, 2, 64),
    Layer(16, 12, 3, 128),
    Layer(4, 16, 1, 256),
)
ESM_LAYERS = (
    Layer(256, 8, 1, 32),
    Layer(256, 12, 3, 64),
    Layer(120, 16, 3, 128),
    Layer(120, 16, 5, 256),
)


def prepare(segments: Segments, alignment: Alignment = "pca2d", threads: int = 0) -> Float32:
    """Centre, align and sample segments: what the network reads.

    Parameters
    ----------
    segments : Segments
    alignment : {"none", "pca2d", "pca3d"}
        "pca2d" turns the major horizontal axis to x; the half with more points lies at low y.
    threads : int
        0 is all cores.

    Returns
    -------
    (P, 256, 3) float32
        Metres, in the order of farthest-point sampling over the whole segment. Smaller segments
        repeat their points. Independent of the order of a segment's points.
    """
    return _native.prepare_segments(segments.points, segments.offsets, POINTS, alignment, threads)


@dataclass(frozen=True)
class Weights:
    """A network that is ready to run, and what its file says of it."""

    network: _native.Network
    alignment: Alignment
    card: dict[str, Any]
    sha256: str


def save_weights(
    path: Path,
    tensors: Mapping[str, Float32],
    layers: Sequence[Layer],
    alignment: Alignment,
    card: Mapping[str, Any],
) -> None:
    """Write a weights file with its layer table, card and hash.

    ``card`` says where the weights come from: data, command, figures, licence.
    """
    table = json.dumps([asdict(layer) for layer in layers])
    metadata = {
        "format": _FORMAT,
        "version": _FORMAT_VERSION,
        "points": str(POINTS),
        "layers": table,
        "alignment": alignment,
        "card": json.dumps(dict(card), sort_keys=True),
        "sha256": _tensor_hash(tensors, table, alignment),
    }
    contiguous = {name: np.ascontiguousarray(tensor) for name, tensor in tensors.items()}
    path.parent.mkdir(parents=True, exist_ok=True)
    save_file(contiguous, path, metadata)


def load_weights(path: Path) -> Weights:
    """Read and check a weights file.

    Raises
    ------
    WeightsError
        If the file is missing, truncated, of another format, does not match its hash, or if a
        tensor is missing, unknown, of the wrong shape or dtype, or not finite.
    """
    metadata, tensors = read_tensors(path)
    if metadata.get("format") != _FORMAT or metadata.get("version") != _FORMAT_VERSION:
        raise WeightsError(f"{path}: not a network of format version {_FORMAT_VERSION}")
    for name, tensor in tensors.items():
        if tensor.dtype != np.float32:
            raise WeightsError(f"{path}: tensor '{name}' is {tensor.dtype}, expected float32")
        if not np.isfinite(tensor).all():
            raise WeightsError(f"{path}: tensor '{name}' has values that are not finite")
    try:
        table, alignment = metadata["layers"], metadata["alignment"]
        rows = [Layer(**row) for row in json.loads(table)]
        points, card = int(metadata["points"]), json.loads(metadata["card"])
        specs = [(row.points, row.neighbors, row.dilation, row.channels) for row in rows]
        network = _native.Network(specs, tensors, points)
    except KeyError as error:
        raise WeightsError(f"{path}: the metadata has no {error}") from error
    except (TypeError, ValueError) as error:
        raise WeightsError(f"{path}: {error}") from error
    if alignment not in get_args(Alignment) or points != POINTS:
        raise WeightsError(f"{path}: made for another preparation of the segments")
    digest = _tensor_hash(tensors, table, alignment)
    if digest != metadata.get("sha256"):
        raise WeightsError(f"{path}: the tensors do not match their hash")
    return Weights(network, cast(Alignment, alignment), card, digest)


def read_tensors(path: Path) -> tuple[dict[str, str], dict[str, Any]]:
    """Metadata and arrays of a safetensors file.

    Raises
    ------
    WeightsError
        If the file is missing or damaged.
    """
    try:
        with safe_open(path, framework="np") as file:
            names = list(file.keys())
            return file.metadata() or {}, {name: file.get_tensor(name) for name in names}
    except FileNotFoundError as error:
        raise WeightsError(f"{path}: no such file") from error
    except (OSError, SafetensorError) as error:
        raise WeightsError(f"{path}: {error}") from error


def _tensor_hash(tensors: Mapping[str, Float32], table: str, alignment: str) -> str:
    digest = hashlib.sha256(f"{table} {alignment}".encode())
    for name in sorted(tensors):
        tensor = np.ascontiguousarray(tensors[name], dtype="<f4")
        digest.update(f"{name} {tensor.shape} ".encode())
        digest.update(tensor.tobytes())
    return digest.hexdigest()


class PointSetDescriptor(Descriptor):
    """A learned descriptor.

    Parameters
    ----------
    name : str
    path : Path
        Weights file.
    with_quality : bool
        Also return each descriptor's quality, in [0, 1]: the network's estimate of how likely the
        nearest map descriptor is to be of the same object.
    threads : int
        0 is all cores; results do not depend on it.

    Raises
    ------
    WeightsError
        If the weights are missing or damaged.
    """

    def __init__(self, name: str, path: Path, with_quality: bool = False, threads: int = 0) -> None:
        weights = load_weights(path)
        self.name = name
        self.dim: int = weights.network.dim
        self.card = weights.card
        self.fingerprint = f"pointset-{PREPROCESSING_VERSION}-{weights.sha256[:16]}"
        self._network = weights.network
        self._alignment = weights.alignment
        self._with_quality = with_quality
        self._threads = threads

    def prepare(self, segments: Segments) -> Float32:
        """Aligned and sampled segments, (P, 256, 3) float32; see :func:`prepare`."""
        return prepare(segments, self._alignment, self._threads)

    def encode(self, prepared: Float32) -> Descriptors:
        """Describe prepared segments: (P, 16) float32 vectors."""
        vectors, quality = self._network.describe(prepared, self._threads)
        return Descriptors(vectors, quality if self._with_quality else None)


def shipped_weights(file: str) -> Path:
    """Path of a weights file that comes with the package."""
    return Path(__file__).resolve().parent.parent / "weights" / file
