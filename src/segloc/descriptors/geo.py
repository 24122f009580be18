"""Seven metric numbers per segment: the baseline of learned descriptors."""

from __future__ import annotations

import numpy as np

from ..types import Descriptors, Float32, Float64, Segments
from .base import Descriptor, register

# Typical value and spread of each number over segments of simulated towns.
CENTRE = np.array([1.0, 0.2, 0.6, 0.0, -0.9, -1.8, 1.8], np.float32)
SPREAD = np.array([0.8, 0.8, 0.6, 0.8, 0.8, 0.8, 1.2], np.float32)
MIN_LENGTH_M = 0.05


@register("geo")
class GeoDescriptor(Descriptor):
    """Log extents, log spreads and height above ground, standardised.

    The extents are measured along the horizontal principal axis, across it, and along z; the
    spreads are the square roots of the eigenvalues of the covariance. Unlike the eigenvalue ratios
    of SegMatch they keep the size of a segment, which is more distinctive than its shape.
    """

    name = "geo"
    dim = 7
    fingerprint = "geo-1"

    def __init__(self, threads: int = 0) -> None:
        del threads  # single-threaded

    def encode(self, segments: Segments) -> Descriptors:
        """Return (P, 7) vectors; see the class."""
        if len(segments) == 0:
            return Descriptors(np.empty((0, self.dim), np.float32))
        starts, counts = segments.offsets[:-1], segments.sizes
        points = segments.points.astype(np.float64)
        centred = points - np.repeat(segments.centroids, counts, axis=0)
        covariance = _covariances(centred, starts, counts)
        spreads = np.sqrt(np.maximum(np.linalg.eigvalsh(covariance)[:, ::-1], 0.0))
        lengths = np.concatenate([_extents(centred, covariance, starts, counts), spreads], axis=1)
        values = np.concatenate(
            [np.log(np.maximum(lengths, MIN_LENGTH_M)), segments.heights[:, None]], axis=1
        )
        vectors: Float32 = ((values - CENTRE) / SPREAD).astype(np.float32)
        return Descriptors(vectors)


def _covariances(centred: Float64, starts: np.ndarray, counts: np.ndarray) -> Float64:
    products = centred[:, [0, 0, 0, 1, 1, 2]] * centred[:, [0, 1, 2, 1, 2, 2]]
    sums = np.add.reduceat(products, starts) / counts[:, None]
    covariances: Float64 = sums[:, [0, 1, 2, 1, 3, 4, 2, 4, 5]].reshape(-1, 3, 3)
    return covariances


def _extents(
    centred: Float64, covariance: Float64, starts: np.ndarray, counts: np.ndarray
) -> Float64:
    angle = 0.5 * np.arctan2(2 * covariance[:, 0, 1], covariance[:, 0, 0] - covariance[:, 1, 1])
    c, s = np.repeat(np.cos(angle), counts), np.repeat(np.sin(angle), counts)
    x, y = centred[:, 0], centred[:, 1]
    axes = np.stack([c * x + s * y, c * y - s * x, centred[:, 2]], axis=1)
    extents: Float64 = np.maximum.reduceat(axes, starts) - np.minimum.reduceat(axes, starts)
    return extents
