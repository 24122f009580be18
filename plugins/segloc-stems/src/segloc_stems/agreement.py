"""Number of query landmarks that lie on map landmarks at a pose, and refinement of the pose."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from segloc import geometry
from segloc.types import Candidate, Float64, Int64, Pose

from .config import LandmarkConfig
from .landmark_map import LandmarkMap
from .landmarks import nearest

_COARSE = 2.0
"""Tolerance of an unrefined pose, in tolerances."""
_MIN_RELATIVE_SUPPORT = 0.5
"""Coarse support of a candidate to be refined, relative to the support of the first."""
_TOLERANCE_STEPS = (2.0, 1.4, 1.0)
"""Tolerance of each step of the refinement, in tolerances."""
_STOREYS = 4  # map landmarks above each other
_MIN_PAIRS = 3
_MIN_PAIRS_TILT = 8
"""Fewest pairs to fit roll and pitch; with fewer, the median axis is more accurate."""
_LEVER_M = 10.0
"""Height along the axis of the second point of a landmark, which fits the tilt. With an error of
5 cm at the foot, it corresponds to an axis known to 0.3 degrees. Set on the first half of the
revisits of a real forest."""
_SHIFT_M = 8.0
"""Largest shift along each axis in the search for a runner-up nearby."""
_SHIFT_LANDMARKS = 48
"""Landmarks, those nearest to the sensor, of that search."""


@dataclass(frozen=True)
class Agreement:
    """Fit of a query to a map of landmarks at a pose.

    Attributes
    ----------
    T_map_local : (4, 4) float64
    inliers : int
        Landmarks of the query that lie on distinct landmarks of the map.
    support : float
        Their sum of 1 - (distance / tolerance)^2; an inlier by chance counts half on average.
    rmse : float
        Root mean square of their horizontal distances [m].
    """

    T_map_local: Pose
    inliers: int
    support: float
    rmse: float


class MapLandmarks:
    """Search structure of the landmarks of a map.

    Parameters
    ----------
    prior_map : LandmarkMap
    config : LandmarkConfig
    """

    def __init__(self, prior_map: LandmarkMap, config: LandmarkConfig) -> None:
        self._positions, self._config = prior_map.positions, config
        self._tips = prior_map.positions + _LEVER_M * prior_map.axes
        self._tree = cKDTree(prior_map.positions[:, :2])

    def best(self, query: Float64, candidates: Sequence[Candidate]) -> list[Agreement]:
        """Refine the most promising candidates, and return them by falling support.

        Candidates with far less support than the first are not refined: refinement by a metre does
        not gain that much.

        Parameters
        ----------
        query : (N, 7) float64
            Positions, axes and diameters, local frame.
        candidates : sequence of Candidate
        """
        rough = self._coarse(query, candidates)
        order = np.argsort(-rough, kind="stable")[: self._config.max_refined]
        refined = [self.refine(query, candidates[order[0]].T_map_local)]
        for k in order[1:]:
            if rough[k] >= _MIN_RELATIVE_SUPPORT * refined[0].support:
                refined.append(self.refine(query, candidates[k].T_map_local))
        return sorted(refined, key=lambda found: -found.support)

    def refine(self, query: Float64, T_map_local: Pose) -> Agreement:
        """Refine a pose so that (N, 7) landmarks fit those of the map."""
        T = T_map_local
        for step in _TOLERANCE_STEPS:
            rows, mapped, _ = self._pairs(query, T, step * self._config.tolerance)
            if len(rows) < _MIN_PAIRS:
                break
            T = self._fit(query[rows], mapped)
        return self._at(query, T)

    def shift(self, query: Float64, found: Agreement) -> Agreement | None:
        """Return the best pose a few metres away with the same heading, as in a plantation.

        None if too few landmarks lie on the map there.
        """
        T_map_local = found.T_map_local
        inner = np.argsort(np.hypot(query[:, 0], query[:, 1]), kind="stable")[:_SHIFT_LANDMARKS]
        x, y = geometry.transform(T_map_local, query[inner, :3])[:, :2].T
        u, v = self._positions[:, :2].T
        near = (u > x.min() - _SHIFT_M) & (u < x.max() + _SHIFT_M)
        near &= (v > y.min() - _SHIFT_M) & (v < y.max() + _SHIFT_M)
        along, across = u[near, None] - x, v[near, None] - y
        elsewhere = (np.abs(along) < _SHIFT_M) & (np.abs(across) < _SHIFT_M)
        elsewhere &= along**2 + across**2 > (_COARSE * self._config.tolerance) ** 2
        shift, count = _densest(along[elsewhere], across[elsewhere], self._config.tolerance)
        if count * len(query) < _MIN_RELATIVE_SUPPORT * found.support * len(inner):
            return None
        T = T_map_local.copy()
        T[:2, 3] += shift
        return self.refine(query, T)

    def _coarse(self, query: Float64, candidates: Sequence[Candidate]) -> Float64:
        """Return the support of each unrefined candidate; a map landmark may count twice."""
        tolerance = _COARSE * self._config.tolerance
        positions = query[:, :3]
        moved = np.array([geometry.transform(c.T_map_local, positions)[:, :2] for c in candidates])
        distances, _ = nearest(self._tree, moved, within=tolerance)
        support: Float64 = np.maximum(1 - (distances / tolerance) ** 2, 0.0).sum(axis=1)
        return support

    def _at(self, query: Float64, T_map_local: Pose) -> Agreement:
        tolerance = self._config.tolerance
        _, mapped, distances = self._pairs(query, T_map_local, tolerance)
        order = np.argsort(distances, kind="stable")
        _, first = np.unique(mapped[order], return_index=True)  # the nearest of each
        distances = distances[order[first]]
        rmse = float(np.sqrt(np.mean(distances**2))) if len(distances) else 0.0
        support = float((1 - (distances / tolerance) ** 2).sum())
        return Agreement(T_map_local, len(distances), support, rmse)

    def _fit(self, query: Float64, mapped: Int64) -> Pose:
        """Fit the pose to pairs by their feet and, if there are enough, their axes."""
        feet = query[:, :3]
        if len(query) < _MIN_PAIRS_TILT:
            return _level(feet, self._positions[mapped])
        source = np.concatenate([feet, feet + _LEVER_M * query[:, 3:6]])
        target = np.concatenate([self._positions[mapped], self._tips[mapped]])
        # Feet are more accurate than tips: the axes fix the tilt only.
        T = _rigid(source, target)
        T[:3, 3] = self._positions[mapped].mean(axis=0) - T[:3, :3] @ feet.mean(axis=0)
        return T

    def _pairs(self, query: Float64, T: Pose, radius: float) -> tuple[Int64, Int64, Float64]:
        """Return query landmarks, their nearest map landmarks at their height, and the distances.

        Those of other storeys may be nearer, seen from above.
        """
        moved = geometry.transform(T, query[:, :3])
        each, count = np.arange(len(moved)), min(_STOREYS, len(self._positions))
        gaps, near = nearest(self._tree, moved[:, :2], count, radius)
        gaps, near = gaps.reshape(-1, count), near.reshape(-1, count)
        there = self._positions[np.minimum(near, len(self._positions) - 1), 2]
        level = np.abs(moved[:, 2, None] - there) < self._config.height_tolerance
        best = np.where(level, gaps, np.inf).argmin(axis=1)
        mapped, distances = near[each, best], gaps[each, best]
        rows = np.flatnonzero(level[each, best] & np.isfinite(distances))
        return rows, mapped[rows], distances[rows]


def _rigid(source: Float64, target: Float64) -> Pose:
    """Return the least-squares rigid transform between (N, 3) points."""
    middles = source.mean(axis=0), target.mean(axis=0)
    products = (target - middles[1]).T @ (source - middles[0])
    R = geometry.orthonormal(geometry.rigid(products, np.zeros(3)))[:3, :3]
    return geometry.rigid(R, middles[1] - R @ middles[0])


def _level(source: Float64, target: Float64) -> Pose:
    """Return the least-squares transform with a rotation about z alone."""
    middles = source.mean(axis=0), target.mean(axis=0)
    (ax, ay, _), (bx, by, _) = (source - middles[0]).T, (target - middles[1]).T
    yaw = np.arctan2(float((ax * by - ay * bx).sum()), float((ax * bx + ay * by).sum()))
    R = geometry.yaw_transform(yaw)[:3, :3]
    return geometry.rigid(R, middles[1] - R @ middles[0])


def _densest(along: Float64, across: Float64, cell: float) -> tuple[Float64, int]:
    """Return the centre of the two by two cells with most shifts, and their number."""
    size = 2 * int(np.ceil(_SHIFT_M / cell)) + 1
    column, line = (((d + _SHIFT_M) / cell).astype(np.int64) for d in (along, across))
    counts = np.bincount(column * size + line, minlength=size * size)
    counts = counts.reshape(size, size)
    windows = counts[1:, 1:] + counts[:-1, 1:] + counts[1:, :-1] + counts[:-1, :-1]
    best = np.unravel_index(np.argmax(windows), windows.shape)
    densest: Float64 = (np.array(best) + 1.0) * cell - _SHIFT_M
    return densest, int(windows[best])
