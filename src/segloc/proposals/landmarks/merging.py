"""Detections of one thing from several poses, made one."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from ...types import Float64, Int64
from .neighbours import nearest

_SQUEEZED = np.array([1.0, 1.0, 0.2])
"""Where a stem leaves the ground is known worse than where it stands."""


class Merger:
    """Means of detections that lie close together, view by view.

    Parameters
    ----------
    radius : float
        Detections within it of a mean are of the same thing, metres; five times as far along z.
    """

    def __init__(self, radius: float) -> None:
        self._radius = radius
        self._means = np.empty((0, 7))
        self._views = np.empty(0, np.int64)

    def add(self, columns: Float64) -> None:
        """Add the landmarks of one view: each mean takes one of them, the nearest.

        Parameters
        ----------
        columns : (N, 7) float64
            Positions, axes and diameters, map frame.
        """
        rows, known = self._nearest(columns)
        self._views[known] += 1
        self._means[known] += (columns[rows] - self._means[known]) / self._views[known, None]
        new = np.ones(len(columns), bool)
        new[rows] = False
        self._means = np.concatenate([self._means, columns[new]])
        self._views = np.concatenate([self._views, np.ones(int(new.sum()), np.int64)])

    def merged(self) -> tuple[Float64, Int64]:
        """Means, (M, 7), and numbers of views, (M,), after means that have met were joined.

        The one that was seen most often takes all within the radius.
        """
        means, views = self._means.copy(), self._views.copy()
        alive = np.ones(len(views), bool)
        for keeper, others in self._neighbours():
            if not alive[keeper]:
                continue
            taken = [other for other in others if alive[other]]
            alive[taken] = False
            group = [keeper, *taken]
            means[keeper] = np.average(self._means[group], axis=0, weights=self._views[group])
            views[keeper] = self._views[group].sum()
        return _normalised(means[alive]), views[alive]

    def _nearest(self, columns: Float64) -> tuple[Int64, Int64]:
        """Which of the landmarks are known, and as which mean; one each, the nearest."""
        if not len(self._means) or not len(columns):
            return np.empty(0, np.int64), np.empty(0, np.int64)
        tree = cKDTree(self._means[:, :3] * _SQUEEZED)
        distance, mean = nearest(tree, columns[:, :3] * _SQUEEZED, within=self._radius)
        rows = np.flatnonzero(np.isfinite(distance))
        rows = rows[np.argsort(distance[rows], kind="stable")]
        found, first = np.unique(mean[rows], return_index=True)
        return rows[first], found.astype(np.int64)

    def _neighbours(self) -> list[tuple[int, list[int]]]:
        """Means that have others within the radius, the one most often seen first."""
        if not len(self._means):
            return []
        tree = cKDTree(self._means[:, :3] * _SQUEEZED)
        around: dict[int, list[int]] = {}
        for a, b in sorted(tree.query_pairs(self._radius)):
            around.setdefault(a, []).append(b)
            around.setdefault(b, []).append(a)
        order = sorted(around, key=lambda k: (-self._views[k], k))
        return [(k, around[k]) for k in order]


def _normalised(means: Float64) -> Float64:
    length = np.linalg.norm(means[:, 3:6], axis=1, keepdims=True)
    means[:, 3:6] /= np.maximum(length, 1e-9)
    return means
