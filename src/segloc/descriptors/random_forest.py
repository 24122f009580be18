"""Random forests over pairs of descriptors, stored as plain arrays."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import _native
from ..errors import WeightsError
from ..types import Float32, Int64
from .base import Descriptor, Pruner
from .weightfile import digest_of, faults_of_weights, read_weights, shipped_weights

KIND = "forest"
_DTYPES = {"roots": np.int32, "feature": np.int32, "threshold": np.float32, "first_child": np.int32}


@dataclass(frozen=True)
class Layout:
    """Features of a pair of descriptors (Dubé et al., "SegMatch", section III-C).

    Attributes
    ----------
    plain : int
        Number of first values of a descriptor, each compared by its absolute difference.
    ratios : bool
        True to add that difference relative to either value, and both values.
    histogram : int
        Bins of each of the histograms that follow, compared by their intersection; 0 without.
    """

    plain: int
    ratios: bool = False
    histogram: int = 0

    @property
    def row(self) -> tuple[int, bool, int]:
        """Arguments of the native functions."""
        return self.plain, self.ratios, self.histogram

    def features(self, dim: int) -> int:
        """Return the number of features of a pair of descriptors of length ``dim``."""
        histograms = (dim - self.plain) // self.histogram if self.histogram else 0
        return (5 if self.ratios else 1) * self.plain + histograms


@dataclass(frozen=True)
class Trees:
    """All trees in one set of arrays.

    Attributes
    ----------
    roots : (T,) int32
        Root nodes.
    feature : (N,) int32
        Feature of a node; 0 for a leaf.
    threshold : (N,) float32
        Largest value that leads to the first child; for a leaf, its result.
    first_child : (N,) int32
        First child; the second is the node after it. -1 for a leaf.
    """

    roots: NDArray[np.int32]
    feature: NDArray[np.int32]
    threshold: Float32
    first_child: NDArray[np.int32]

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return the stored arrays by name."""
        return {name: np.ascontiguousarray(getattr(self, name), t) for name, t in _DTYPES.items()}


class PairForest(Pruner):
    """Probability that a pair of descriptors shows one object: the mean over all trees.

    Parameters
    ----------
    trees : Trees
    layout : Layout
    dim : int
        Length of a descriptor.
    card : dict, optional

    Raises
    ------
    ValueError
        If the arrays are no trees, or use features that do not exist.
    """

    def __init__(
        self, trees: Trees, layout: Layout, dim: int, card: Mapping[str, Any] | None = None
    ) -> None:
        self.layout = layout
        self.card = dict(card or {})
        self.fingerprint = f"forest-{digest_of(trees.arrays(), {})[:16]}"
        self._forest = _native.Forest(**trees.arrays(), features=layout.features(dim))

    def probability(
        self, query: Float32, mapped: Float32, rows: Int64, columns: Int64, threads: int = 0
    ) -> Float32:
        """See :meth:`Pruner.probability`."""
        return self._forest.predict_pairs(query, mapped, rows, columns, self.layout.row, threads)

    @staticmethod
    def load(path: Path, descriptor: Descriptor) -> PairForest:
        """Read and check the forest of a descriptor.

        Raises
        ------
        WeightsError
            If the file is missing, damaged, no forest, or was made for another descriptor.
        """
        file = read_weights(path, KIND, _DTYPES)
        made_for = file.settings.get("descriptor")
        if made_for != descriptor.fingerprint:
            raise WeightsError(f"{path}: made for {made_for}, not for {descriptor.fingerprint}")
        with faults_of_weights(path):
            layout = Layout(**json.loads(file.settings["layout"]))
            return PairForest(Trees(**file.tensors), layout, descriptor.dim, file.card)


class ForestDescriptor(Descriptor):
    """A descriptor whose candidate matches are pruned by a forest.

    Parameters
    ----------
    threads : int
        0 is all cores; results do not depend on it.
    weights : Path, optional
        Forest, by default the shipped one.

    Attributes
    ----------
    layout : Layout
        Features of a pair of descriptors.

    Raises
    ------
    WeightsError
        If ``weights`` is missing or damaged.
    """

    layout: Layout

    def __init__(self, threads: int = 0, weights: Path | None = None) -> None:
        self._threads = threads
        self._forest: Pruner | None = PairForest.load(weights, self) if weights else None

    @property
    def pruner(self) -> Pruner:
        """The forest, read on first access; describing or growing needs none.

        Raises
        ------
        WeightsError
            If the shipped forest is not installed, or is damaged.
        """
        if self._forest is None:
            self._forest = PairForest.load(shipped_forest(self.name), self)
        return self._forest

    @pruner.setter
    def pruner(self, forest: Pruner) -> None:
        self._forest = forest


def shipped_forest(method: str) -> Path:
    """Return the path of the forest of a method; see :func:`shipped_weights`."""
    return shipped_weights(f"{method}-forest.safetensors")
