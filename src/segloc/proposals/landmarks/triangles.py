"""What a landmark's surroundings say of it: triangles with pairs of its nearest neighbours.

A triangle's key has eight numbers, each divided by its noise: the sides from the landmark to the
nearer and to the farther of the two, the third side with the sign of the turn (so that a mirror
image differs), two differences of height, and three diameters. A query's triangle is matched to
the map's nearest keys, and each such pair of triangles matches their three corners.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.spatial import cKDTree

from ...types import Float64, Int64, Matches
from .config import Effort, LandmarkConfig
from .landmarks import nearest

DIMENSION = 8
_SPREAD = 8.0
"""Both triangles have noise, and it has tails: four times what one with normal noise would have."""


@dataclass(frozen=True)
class Triangles:
    """Triangles of landmarks.

    Attributes
    ----------
    keys : (T, 8) float64
        Compared by Euclidean distance, which is in units of the noise.
    corners : (T, 3) int64
        The landmark itself, the nearer and the farther of the pair.
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
    """The triangles of landmarks with each pair of their nearest neighbours.

    Parameters
    ----------
    positions : (N, 3) float64
        In a frame whose z axis points up, metres.
    diameters : (N,) float64
        Metres.
    neighbours : int
        Of fewer landmarks than that, all are neighbours.
    config : LandmarkConfig
        Says what the noise is.
    chosen : (C,) int64, optional
        Those whose triangles are wanted; all by default.
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
    """Finds the landmarks of a map that stand among others as those of a query do.

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
        # Eight numbers and a bound of the distance: a tree looks at few of the keys.
        self._tree = cKDTree(found.keys) if len(found.keys) else None

    def matches(self, positions: Float64, diameters: Float64) -> Matches:
        """Pairs of a query's landmarks and the map's, those that most triangles speak for first.

        Parameters
        ----------
        positions : (N, 3) float64
            Local frame, whose z axis points up.
        diameters : (N,) float64
        """
        around = np.argsort(np.hypot(positions[:, 0], positions[:, 1]), kind="stable")
        # Of those near the sensor, the neighbours are most likely to be in view, too.
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
        likelihood = np.exp(-(distance[own, rank] ** 2) / _SPREAD)
        return self._summed(query.corners[own].ravel(), corners.ravel(), likelihood)

    def _summed(self, query: Int64, mapped: Int64, likelihood: Float64) -> Matches:
        pairs, which = np.unique(query * self._count + mapped, return_inverse=True)
        score = np.bincount(which, np.repeat(likelihood, 3))
        best = np.argsort(-score, kind="stable")[: self.effort.most_matches]
        scores = score[best].astype(np.float32)
        return Matches(pairs[best] // self._count, pairs[best] % self._count, -scores, scores)
