"""Matching of landmarks by triangles with pairs of their nearest neighbours.

The key of a triangle has eight numbers, each divided by its noise: the sides from the landmark to
the nearer and to the farther neighbour, the third side with the sign of the turn (so that a mirror
image differs), two height differences, and three diameters. A triangle of a query is matched to the
nearest keys of the map; each pair of triangles matches its three corners.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.spatial import cKDTree

from segloc.types import Float64, Int64, Matches

from .config import Effort, LandmarkConfig
from .landmarks import nearest

DIMENSION = 8
_KEY_VARIANCE = 8.0
"""Variance of key differences: both triangles have noise with tails, four times the normal one."""


@dataclass(frozen=True)
class Triangles:
    """Triangles of landmarks.

    Attributes
    ----------
    keys : (T, 8) float64
        Keys, in units of the noise; compared by Euclidean distance.
    corners : (T, 3) int64
        The landmark, its nearer and its farther neighbour.
    """

    keys: Float64
    corners: Int64


def triangles_of(
    positions: Float64,
    diameters: Float64,
    neighbours: int,
    config: LandmarkConfig,
    chosen: Int64 | None = None,
) -> Triangles:
    """Build the triangles of landmarks with each pair of their nearest neighbours.

    Parameters
    ----------
    positions : (N, 3) float64
        Positions [m], in a frame with a vertical z axis.
    diameters : (N,) float64
        Diameters [m].
    neighbours : int
        Most neighbours of a landmark.
    config : LandmarkConfig
        Provides the noise.
    chosen : (C,) int64, optional
        Landmarks to build triangles of; all by default.
    """
    count = len(positions)
    near = min(neighbours, count - 1)
    if near < 2:
        return Triangles(np.empty((0, DIMENSION)), np.empty((0, 3), np.int64))
    chosen = np.arange(count) if chosen is None else chosen
    _, around = nearest(cKDTree(positions[:, :2]), positions[chosen, :2], near + 1)
    nearer, farther = np.array(list(combinations(range(1, near + 1), 2))).T
    own = np.repeat(chosen, len(nearer))
    corners = np.stack([own, around[:, nearer].ravel(), around[:, farther].ravel()], axis=1)
    return Triangles(_keys(positions, diameters, corners, config), corners.astype(np.int64))


def _keys(
    positions: Float64, diameters: Float64, corners: Int64, config: LandmarkConfig
) -> Float64:
    own, near, far = (positions[corners[:, k]] for k in range(3))
    (ux, uy, uz), (vx, vy, vz) = (near - own).T, (far - own).T
    third = np.copysign(np.hypot(vx - ux, vy - uy), ux * vy - uy * vx)
    sides = np.stack([np.hypot(ux, uy), np.hypot(vx, vy), third], axis=1)
    heights = np.stack([uz, vz], axis=1)
    parts = (
        sides / config.key_noise_m,
        heights / config.key_noise_height_m,
        diameters[corners] / config.key_noise_diameter_m,
    )
    return np.concatenate(parts, axis=1)


class TriangleIndex:
    """Finds map landmarks with the same arrangement of neighbours as those of a query.

    Parameters
    ----------
    positions : (M, 3) float64
    diameters : (M,) float64
    effort : Effort
    config : LandmarkConfig
    """

    def __init__(
        self, positions: Float64, diameters: Float64, effort: Effort, config: LandmarkConfig
    ) -> None:
        self.effort = effort
        self._config, self._count = config, len(positions)
        found = triangles_of(positions, diameters, effort.neighbours, config)
        self._corners = found.corners
        # With eight numbers and a bound of the distance, a tree visits few keys.
        self._tree = cKDTree(found.keys) if len(found.keys) else None

    def matches(self, positions: Float64, diameters: Float64) -> Matches:
        """Match landmarks of a query to those of the map, by falling support of triangles.

        Parameters
        ----------
        positions : (N, 3) float64
            Local frame, z axis vertical.
        diameters : (N,) float64
        """
        around = np.argsort(np.hypot(positions[:, 0], positions[:, 1]), kind="stable")
        # Landmarks near the sensor are the most likely to have their neighbours in view.
        chosen = np.sort(around[: self.effort.most_landmarks])
        query = triangles_of(positions, diameters, self.effort.neighbours, self._config, chosen)
        if self._tree is None or not len(query.keys):
            none = np.empty(0, np.int64)
            return Matches(none, none, none.astype(np.float32), none.astype(np.float32))
        distance, row = nearest(
            self._tree, query.keys, self.effort.alike, self._config.most_key_noise
        )
        distance = distance.reshape(len(query.keys), -1)
        own, rank = np.nonzero(np.isfinite(distance))
        corners = self._corners[row.reshape(distance.shape)[own, rank]]
        likelihood = np.exp(-(distance[own, rank] ** 2) / _KEY_VARIANCE)
        return self._sum(query.corners[own].ravel(), corners.ravel(), likelihood)

    def _sum(self, query: Int64, mapped: Int64, likelihood: Float64) -> Matches:
        pairs, which = np.unique(query * self._count + mapped, return_inverse=True)
        score = np.bincount(which, np.repeat(likelihood, 3))
        best = np.argsort(-score, kind="stable")[: self.effort.most_matches]
        scores = score[best].astype(np.float32)
        return Matches(pairs[best] // self._count, pairs[best] % self._count, -scores, scores)
