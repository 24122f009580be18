"""SegMatch: eigenvalue features, alone or with shape functions (arXiv 1609.07720)."""

from __future__ import annotations

import numpy as np

from .. import _native
from ..types import Descriptors, Float32, Float64, Segments
from .base import AS_PUBLISHED, Descriptor, register
from .random_forest import ForestDescriptor, Layout

# Divisor of each feature: its spread over segments of simulated towns.
EIGEN_SPREAD = np.array([0.230, 0.197, 0.096, 0.0857, 0.096, 0.277, 0.0488], np.float32)

# Divisors of the ETH code: 0.9 of its largest observed values.
ETH_MAXIMA = 0.9 * np.array([28890.9, 95919.2, 124811, 0.278636, 124810, 0.956129, 0.99702])
ETH_POINTING_UP = 0.2

ESF_WEIGHT = 30.0
"""Weight of shape functions, which sum to one, so that they match eigenvalue features."""

ESF_BINS = 64
_MIN_RATIO = 1e-6

_NEIGHBOURS = {"matching": {"neighbours": 200, **AS_PUBLISHED}}


def eigen_features(segments: Segments, threads: int = 0) -> Float64:
    """Compute seven functions of the eigenvalues e1 >= e2 >= e3 of the covariance (section III-B).

    The eigenvalues are normalised by their sum. A segment of one point gives zeros.

    Returns
    -------
    (P, 7) float64
        Linearity, planarity, scattering, omnivariance, anisotropy, eigen-entropy, and change of
        curvature; independent of the size of a segment.
    """
    e = _shares(segments, threads)
    e1, e2, e3 = e.T
    largest = np.where(e1 > 0, e1, 1.0)
    features: Float64 = np.stack(
        [
            (e1 - e2) / largest,
            (e2 - e3) / largest,
            e3 / largest,
            np.cbrt(e1 * e2 * e3),
            (e1 - e3) / largest,
            -(e * _log(e)).sum(axis=1),
            e3,
        ],
        axis=1,
    )
    return features


def eth_features(segments: Segments, threads: int = 0) -> Float64:
    """Compute the features of the ETH code: ascending eigenvalues, divided by fixed maxima.

    The entropy has no minus sign, and only its last term is divided. The eighth number is 1 for a
    segment lower than its width along both axes of the frame, so it depends on rotation. The
    smallest eigenvalue, the divisor of the others, is at least a millionth of their sum.

    Returns
    -------
    (P, 8) float64
    """
    e = np.maximum(_shares(segments, threads)[:, ::-1], _MIN_RATIO)
    e1, e2, e3 = e.T
    terms = e * _log(e)
    features = np.stack(
        [
            (e1 - e2) / e1 / ETH_MAXIMA[0],
            (e2 - e3) / e1 / ETH_MAXIMA[1],
            e3 / e1 / ETH_MAXIMA[2],
            np.cbrt(e1 * e2 * e3) / ETH_MAXIMA[3],
            (e1 - e3) / e1 / ETH_MAXIMA[4],
            terms[:, 0] + terms[:, 1] + terms[:, 2] / ETH_MAXIMA[5],
            e3 / e.sum(axis=1) / ETH_MAXIMA[6],
        ],
        axis=1,
    )
    return np.column_stack([features, ETH_POINTING_UP * _is_low(segments)])


def _shares(segments: Segments, threads: int) -> Float64:
    """Return normalised eigenvalues, descending, (P, 3)."""
    _, values = _native.segment_moments(segments.points, segments.offsets, threads)
    total = values.sum(axis=1, keepdims=True)
    shares = np.zeros_like(values)
    np.divide(values, total, out=shares, where=total > 0)
    return shares


def _log(values: Float64) -> Float64:
    result: Float64 = np.log(np.where(values > 0, values, 1.0))
    return result


def _is_low(segments: Segments) -> np.ndarray:
    low = np.zeros(len(segments), dtype=bool)
    filled = np.flatnonzero(segments.sizes)
    if len(filled):
        starts = segments.offsets[filled]
        points = segments.points
        size = np.maximum.reduceat(points, starts) - np.minimum.reduceat(points, starts)
        low[filled] = (size[:, 2] < size[:, 0]) & (size[:, 2] < size[:, 1])
    return low


@register("segmatch-eigen", preset=_NEIGHBOURS)
class EigenDescriptor(ForestDescriptor):
    """The seven eigenvalue features, each divided by its spread over simulated towns.

    A random forest over 35 functions of a pair (differences, relative differences, values) prunes
    the candidates.
    """

    name = "segmatch-eigen"
    dim = 7
    fingerprint = "segmatch-eigen-1"
    layout = Layout(plain=7, ratios=True)

    def encode(self, segments: Segments) -> Descriptors:
        """Return (P, 7) vectors; see the class."""
        vectors: Float32 = eigen_features(segments, self._threads).astype(np.float32)
        return Descriptors(vectors / EIGEN_SPREAD)


@register("segmatch-eigen-ethz", preset=_NEIGHBOURS)
class EthEigenDescriptor(Descriptor):
    """The eigenvalue features of the ETH code (see :func:`eth_features`); nothing is pruned."""

    name = "segmatch-eigen-ethz"
    dim = 8
    fingerprint = "segmatch-eigen-ethz-1"

    def __init__(self, threads: int = 0) -> None:
        self._threads = threads

    def encode(self, segments: Segments) -> Descriptors:
        """Return (P, 8) vectors; see the class."""
        return Descriptors(eth_features(segments, self._threads).astype(np.float32))


@register("segmatch-esf", preset=_NEIGHBOURS)
class EsfDescriptor(ForestDescriptor):
    """Eigenvalue features and the ensemble of shape functions (Wohlkinger and Vincze, 2011).

    The 640 bins, which sum to one, are multiplied by ``ESF_WEIGHT``. The random forest also uses
    the intersections of the ten histograms of a pair. Random triangles are drawn from sorted points
    with a fixed seed, so the result is repeatable and independent of the order of points.
    """

    name = "segmatch-esf"
    dim = 7 + 10 * ESF_BINS
    fingerprint = "segmatch-esf-1"
    layout = Layout(plain=7, ratios=True, histogram=ESF_BINS)
    triples = 20_000

    def encode(self, segments: Segments) -> Descriptors:
        """Return (P, 647) vectors; see the class."""
        eigen = eigen_features(segments, self._threads).astype(np.float32) / EIGEN_SPREAD
        shape = _native.esf(
            segments.points, segments.offsets, self.triples, seed=0, threads=self._threads
        )
        return Descriptors(np.concatenate([eigen, ESF_WEIGHT * shape], axis=1, dtype=np.float32))
