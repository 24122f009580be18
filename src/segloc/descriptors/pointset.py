"""Learned point-set descriptors: layer tables, weight files, and inference.

The network is X-convolutional (Li et al., "PointCNN", NeurIPS 2018). A segment becomes 256 points
in the order of farthest-point sampling, so each layer's points are a prefix of them.
FC4, if the weights have it, prunes matches by the probability that two descriptors show one
object.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, cast, get_args

import numpy as np
from scipy.special import expit

from .. import _native
from ..errors import WeightsError
from ..types import Descriptors, Float32, Float64, Int64, Segments
from .base import Descriptor, Pruner
from .weightfile import digest_of, faults_of_weights, read_weights

Alignment = Literal["none", "pca2d", "pca3d"]
Judge = Literal["none", "pair", "nearest"]

POINTS = 256
"""Points of a prepared segment."""

PREPROCESSING_VERSION = 1
"""Version of `prepare`, increased if its result changes."""

KIND = "network"
"""Kind of weights files."""

DIM = 16
"""Length of a descriptor."""
PREFIX = "pair."
"""Prefix of the names of FC4's tensors: ``pair.0.weight``, ``pair.0.bias`` and so on."""

_AT_ONCE = 65_536


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
    """Centre, align and sample segments for the network.

    Parameters
    ----------
    segments : Segments
    alignment : {"none", "pca2d", "pca3d"}
        "pca2d" aligns the major horizontal axis with x; the half with more points lies at low y.
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
    """A loaded network with the metadata of its file.

    Attributes
    ----------
    network : segloc._native.Network
    alignment : {"none", "pca2d", "pca3d"}
    card : dict
    sha256 : str
        Hash of all that determines the descriptors, without FC4.
    pair_head : PairHead or None
        FC4, if the file has it.
    """

    network: _native.Network
    alignment: Alignment
    card: dict[str, Any]
    sha256: str
    pair_head: PairHead | None


def load_weights(path: Path) -> Weights:
    """Read and check a weights file.

    Raises
    ------
    WeightsError
        If the file is missing, truncated, of another format, does not match its hash, or if a
        tensor is missing, unknown, of the wrong shape or dtype, or not finite.
    """
    file = read_weights(path, KIND)
    with faults_of_weights(path):
        alignment = file.settings["alignment"]
        rows = [Layer(**row) for row in json.loads(file.settings["layers"])]
        points = int(file.settings["points"])
        specs = [(row.points, row.neighbors, row.dilation, row.channels) for row in rows]
        trunk = {k: v for k, v in file.tensors.items() if not k.startswith(PREFIX)}
        pairs = {k: v for k, v in file.tensors.items() if k.startswith(PREFIX)}
        network = _native.Network(specs, trunk, points)
        pair_head = PairHead(pairs, network.dim) if pairs else None
    if alignment not in get_args(Alignment) or points != POINTS:
        raise WeightsError(f"{path}: made for another preparation of the segments")
    sha256 = digest_of(trunk, file.settings)
    return Weights(network, cast(Alignment, alignment), file.card, sha256, pair_head)


class PointSetDescriptor(Descriptor):
    """A learned descriptor.

    Parameters
    ----------
    name : str
    path : Path
        Weights file.
    judge : {"none", "pair", "nearest"}
        Orders matches beside their distance. "pair": FC4's probability that two descriptors show
        one object. "nearest": each descriptor's quality, in [0, 1], the probability that its
        nearest map descriptor is of the same object.
    threads : int
        0 is all cores; results do not depend on it.

    Raises
    ------
    WeightsError
        If the weights are missing or damaged, or lack the FC4 of "pair".
    """

    def __init__(self, name: str, path: Path, *, judge: Judge = "none", threads: int = 0) -> None:
        weights = load_weights(path)
        if judge == "pair" and weights.pair_head is None:
            raise WeightsError(f"{path}: no FC4, which {name} needs; train the weights again")
        self.name = name
        self.dim: int = weights.network.dim
        self.card = weights.card
        self.fingerprint = f"pointset-{PREPROCESSING_VERSION}-{weights.sha256[:16]}"
        self._network = weights.network
        self._alignment = weights.alignment
        self.rates = judge == "nearest"
        self.pruner = weights.pair_head if judge == "pair" else None
        self._threads = threads

    def prepare(self, segments: Segments) -> Float32:
        """Return aligned and sampled segments, (P, 256, 3) float32; see :func:`prepare`."""
        return prepare(segments, self._alignment, self._threads)

    def encode(self, prepared: Float32) -> Descriptors:
        """Describe prepared segments: (P, 16) float32 vectors."""
        vectors, quality = self._network.describe(prepared, self._threads)
        return Descriptors(vectors, quality if self.rates else None)


class PairHead(Pruner):
    """FC4, the branch for feature quality of the paper.

    Its input is the absolute difference of two descriptors, and its square if the first layer has
    twice as many inputs. A ReLU lies between two layers.

    Parameters
    ----------
    tensors : mapping of str to float32 arrays
        ``pair.K.weight`` (inputs, outputs) and ``pair.K.bias`` (outputs,) of one or two layers; the
        last has one output, the log-odds.
    dim : int
        Length of a descriptor.

    Raises
    ------
    ValueError
        If there are other tensors, or their shapes do not fit.
    """

    def __init__(self, tensors: Mapping[str, Float32], dim: int) -> None:
        count = len(tensors) // 2
        names = {f"{PREFIX}{k}.{part}" for k in range(count) for part in ("weight", "bias")}
        if not 1 <= count <= 2 or set(tensors) != names:
            raise ValueError(f"FC4 has the tensors {', '.join(sorted(tensors))}")
        self._layers = [
            (tensors[f"{PREFIX}{k}.weight"], tensors[f"{PREFIX}{k}.bias"]) for k in range(count)
        ]
        inputs = self._layers[0][0].shape[0] if self._layers[0][0].ndim == 2 else 0
        if inputs not in (dim, 2 * dim):
            raise ValueError(f"FC4 has {inputs} inputs for descriptors of {dim}")
        self._squares = inputs == 2 * dim
        for weight, bias in self._layers:
            if weight.ndim != 2 or weight.shape[0] != inputs or bias.shape != weight.shape[1:]:
                raise ValueError("the layers of FC4 do not fit together")
            inputs = weight.shape[1]
        if inputs != 1:
            raise ValueError(f"FC4 has {inputs} outputs, not 1")
        self.fingerprint = f"fc4-{digest_of(tensors, {})[:16]}"

    def probability(
        self, query: Float32, mapped: Float32, rows: Int64, columns: Int64, threads: int = 0
    ) -> Float32:
        """See :meth:`Pruner.probability`."""
        likely = np.empty(len(rows), np.float32)
        for first in range(0, len(rows), _AT_ONCE):
            some = slice(first, first + _AT_ONCE)
            likely[some] = expit(self.logits(query[rows[some]], mapped[columns[some]]))
        return likely

    def logits(self, a: Float32, b: Float32) -> Float64:
        """Return the log-odds that each of (M, dim) pairs shows one object, (M,)."""
        x = np.abs(a.astype(np.float64) - b)
        if self._squares:
            x = np.concatenate([x, np.square(x)], axis=1)
        for number, (weight, bias) in enumerate(self._layers):
            x = np.maximum(x, 0.0) if number else x
            # einsum without BLAS: its sums are independent of the number of threads and rows.
            x = np.einsum("mi,io->mo", x, weight.astype(np.float64)) + bias
        logits: Float64 = x[:, 0]
        return logits
