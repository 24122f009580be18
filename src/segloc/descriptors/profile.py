"""Profile: metric shape profiles of a segment, condensed by a small network.

The networks of the paper learn shape from raw coordinates. Here a native kernel measures the size
of a segment and the distribution of its points, in metres and above ground. Three dense layers
learn which of these numbers persist between visits.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np

from .. import _native
from ..errors import WeightsError
from ..types import Descriptors, Float32, Segments
from .base import Descriptor, register
from .pointset import prepare
from .weightfile import faults_of_weights, read_weights, shipped_weights

KIND = "profile network"
PROFILE_VERSION = 1
"""Version of the profile, increased if its numbers change."""

PROFILE_SIZE = 175

LIMIT = 6.0
"""Range to which standardised numbers are clipped, so that no outlier dominates."""


class PreparedSegments(NamedTuple):
    """Aligned and sampled segments with their heights.

    Attributes
    ----------
    points : (P, 256, 3) float32
    heights : (P,) float32
        Heights of the centroids above ground [m].
    """

    points: Float32
    heights: Float32


def profiles(prepared: PreparedSegments, threads: int = 0) -> Float32:
    """Compute the network's inputs, (P, 175) float32.

    In this order: logarithms of the extents and of the standard deviations along x, y, z (6; x is
    the major horizontal axis); nine order statistics each of the height above ground, and of the
    logarithms of the horizontal distance to the centroid, of abs(x) and of abs(y) (36); of the
    distances between points, seventeen in space and seventeen in the plane, as logarithms, and
    nine of the differences in height (43); of six slices over the height, the share of points,
    mean x and y with and without sign, and logarithms of the spreads in x and y (42); of eight
    slices along x, the share of points, mean y and z, spread of y and z, and the highest z (48).
    """
    return _native.shape_profiles(prepared.points, prepared.heights, threads)


class ProfileDescriptor(Descriptor):
    """A learned description of metric shape.

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

    name = "profile"

    rates = True

    def __init__(self, path: Path, threads: int = 0) -> None:
        weights = read_weights(path, KIND)
        if weights.settings.get("profile") != str(PROFILE_VERSION):
            raise WeightsError(f"{path}: made for another profile than version {PROFILE_VERSION}")
        with faults_of_weights(path):
            self._network = _native.Perceptron(weights.tensors, LIMIT)
        if self._network.inputs != PROFILE_SIZE:
            raise WeightsError(
                f"{path}: has {self._network.inputs} inputs, needs {PROFILE_SIZE}; "
                "train the weights again"
            )
        self.dim = self._network.outputs - 1
        self.card = weights.card
        self.fingerprint = f"profile-{PROFILE_VERSION}-{weights.sha256[:16]}"
        self._threads = threads

    def prepare(self, segments: Segments) -> PreparedSegments:
        """Align and sample segments."""
        heights = np.ascontiguousarray(segments.heights, dtype=np.float32)
        return PreparedSegments(prepare(segments, "pca2d", self._threads), heights)

    def encode(self, prepared: PreparedSegments) -> Descriptors:
        """Return (P, dim) vectors, and the probability that their nearest neighbour is correct."""
        if len(prepared.heights) == 0:
            return Descriptors(np.empty((0, self.dim), np.float32), np.empty(0, np.float32))
        output = self._network.run(profiles(prepared, self._threads), self._threads)
        quality = 1.0 / (1.0 + np.exp(-output[:, -1]))
        return Descriptors(np.ascontiguousarray(output[:, :-1]), quality.astype(np.float32))


@register("profile")
def profile(threads: int = 0, weights: Path | None = None) -> ProfileDescriptor:
    """Create the default descriptor."""
    return ProfileDescriptor(weights or shipped_weights("profile.safetensors"), threads)
