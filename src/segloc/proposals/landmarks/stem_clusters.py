"""Points above ground -> upright things: small clusters of slices, one above another."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from ... import _native
from ...types import Float32, Float64, Int64
from .config import StemConfig

_APART = 10.0
"""Times the tolerance, from one slice to the next: so they are clustered at once, each alone."""
_MOST_POINTS = 100_000
_SLICES_ON = 2
"""A slice in which nothing is seen, between two beams or behind a twig, does not end a stem."""

_CROOKED = 2.0
"""Times the width of a slice that a stem may take as a whole: it leans, forks and has boughs."""


@dataclass(frozen=True)
class Upright:
    """The points of K upright things, one thing after another.

    Attributes
    ----------
    points : (M, 3) float64
    heights : (M,) float64
        Over ground, metres.
    counts : (K,) int64
        Points of each.
    """

    points: Float64
    heights: Float64
    counts: Int64

    def __len__(self) -> int:
        return len(self.counts)

    @property
    def starts(self) -> Int64:
        """Where the points of each begin, (K,) int64."""
        return np.cumsum(self.counts) - self.counts


def upright(points: Float32, heights: Float32, tolerance: float, config: StemConfig) -> Upright:
    """The things of a cloud that go on upwards, and stand alone at several heights.

    Parameters
    ----------
    points : (N, 3) float32
        In a frame whose z axis points up.
    heights : (N,) float32
        Over ground, metres.
    tolerance : float
        Points of a slice closer than this belong together, metres.
    config : StemConfig
    """
    band = (heights > config.lowest_m) & (heights < config.highest_m)
    points, heights = points[band], heights[band]
    slices = ((heights - config.lowest_m) / config.slice_m).astype(np.int64)
    members, counts = _clusters(points, slices, tolerance)
    slim = np.flatnonzero(_widths(points[members], counts) < config.widest_m)
    kept = np.isin(np.repeat(np.arange(len(counts)), counts), slim)
    members, counts = members[kept], counts[slim]
    chains = _chains(points[members].astype(np.float64), slices[members], counts, config.link_m)
    which = np.repeat(chains, counts)
    order = np.argsort(which, kind="stable")
    members, which = members[order], which[order]
    return _long_ones(points[members], heights[members], np.bincount(which), config)


def _clusters(points: Float32, slices: Int64, tolerance: float) -> tuple[Int64, Int64]:
    """Rows of the points of each cluster of each slice, and how many each has."""
    lifted = points.copy()
    lifted[:, 2] = slices * (_APART * tolerance)
    members, offsets = _native.euclidean_clusters(lifted, tolerance, 1, _MOST_POINTS)
    return members.astype(np.int64), np.diff(offsets)


def _widths(points: Float32, counts: Int64) -> Float64:
    """The horizontal diagonal of each cluster, metres."""
    if not len(counts):
        return np.empty(0)
    starts = np.cumsum(counts) - counts
    xy = points[:, :2].astype(np.float64)
    span = np.maximum.reduceat(xy, starts) - np.minimum.reduceat(xy, starts)
    widths: Float64 = np.hypot(span[:, 0], span[:, 1])
    return widths


def _chains(points: Float64, slices: Int64, counts: Int64, link: float) -> Int64:
    """Which chain of clusters, one above another, each cluster belongs to."""
    if not len(counts):
        return np.empty(0, np.int64)
    starts = np.cumsum(counts) - counts
    centres = np.add.reduceat(points[:, :2], starts) / counts[:, None]
    pairs = cKDTree(centres).query_pairs(link, output_type="ndarray")
    up = np.abs(slices[starts][pairs[:, 0]] - slices[starts][pairs[:, 1]])
    a, b = pairs[(up >= 1) & (up <= _SLICES_ON)].T
    graph = coo_matrix((np.ones(len(a)), (a, b)), shape=(len(counts), len(counts)))
    chains: Int64 = connected_components(graph, directed=False)[1].astype(np.int64)
    return chains


def _long_ones(points: Float32, heights: Float32, counts: Int64, config: StemConfig) -> Upright:
    """Those of enough points and length, and of no great width as a whole."""
    starts = np.cumsum(counts) - counts
    if not len(counts):
        return Upright(np.empty((0, 3)), np.empty(0), counts)
    length = np.maximum.reduceat(heights, starts) - np.minimum.reduceat(heights, starts)
    good = (counts >= config.fewest_points) & (length >= config.least_length_m)
    good &= _widths(points, counts) < _CROOKED * config.widest_m
    kept = np.repeat(good, counts)
    return Upright(points[kept].astype(np.float64), heights[kept].astype(np.float64), counts[good])
