"""FC4 at inference: how likely two descriptors show one object, by one or two dense layers."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy.special import expit

from ..types import Float32, Float64, Int64
from .base import Pruner
from .weightfile import digest_of

PREFIX = "pair."
"""What the names of its tensors begin with: ``pair.0.weight``, ``pair.0.bias`` and so on."""

_AT_ONCE = 65_536


class PairHead(Pruner):
    """The branch that the paper calls feature quality, FC4.

    It reads the absolute difference of two descriptors, and its square where the first layer has
    twice as many inputs. Between two layers lies a ReLU.

    Parameters
    ----------
    tensors : mapping of str to float32 arrays
        ``pair.K.weight`` (inputs, outputs) and ``pair.K.bias`` (outputs,) of layers 0 and perhaps
        1; the last has one output, the logarithm of the odds.
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
        """The logarithm of the odds that each of (M, dim) pairs shows one object, (M,)."""
        x = np.abs(a.astype(np.float64) - b)
        if self._squares:
            x = np.concatenate([x, np.square(x)], axis=1)
        for number, (weight, bias) in enumerate(self._layers):
            x = np.maximum(x, 0.0) if number else x
            # einsum without BLAS: its sums do not depend on the number of threads or rows.
            x = np.einsum("mi,io->mo", x, weight.astype(np.float64)) + bias
        logits: Float64 = x[:, 0]
        return logits
