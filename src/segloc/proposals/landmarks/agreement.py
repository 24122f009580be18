"""How many landmarks of a query lie on landmarks of the map at a pose, and where most do."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from ... import geometry
from ...types import Candidate, Float64, Int64, Pose
from .config import LandmarkConfig
from .landmark_map import LandmarkMap
from .landmarks import nearest

_COARSE = 2.0
"""Times the tolerance: within it lie the landmarks of a pose that is not refined yet."""
_HOPELESS = 0.5
"""Of the support of the first: with less, taken coarsely, a candidate is not refined."""
_TIGHTENING = (2.0, 1.4, 1.0)
"""Times the tolerance, from one step of the refinement to the next."""
_FEWEST = 3
_FEWEST_TILTED = 8
"""Landmarks from which roll and pitch are fitted, too; below, the median axis says more."""
_LEVER_M = 10.0
"""So far along its axis from its foot is the point by which a landmark's lean is fitted: with 5 cm
at the foot, as good as an axis known to 0.3 degrees. Chosen on the first half of the revisits of a
real forest."""
_SHIFT_M = 8.0
"""How far a pose is moved, along each axis, in search of a rival nearby."""
_ENOUGH = 48
"""Landmarks, those nearest to the sensor, that tell where a rival may be."""


@dataclass(frozen=True)
class Agreement:
    """How well a query lies on the map at a pose.

    Attributes
    ----------
    T_map_local : (4, 4) float64
    inliers : int
        Landmarks of the query that lie on one of the map, each on another one.
    support : float
        The sum over them of 1 - (distance / tolerance)^2: what lies there by chance lies at the
        rim, and counts half.
    rmse : float
        Root mean square of their horizontal distances, metres.
    """

    T_map_local: Pose
    inliers: int
    support: float
    rmse: float


class MapLandmarks:
    """The landmarks of a map, ready to be compared with those of queries.

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
        """The most promising candidates refined, the best supported first.

        Those that have far less support than the first are not refined: a pose that is moved by a
        metre does not gain that much.

        Parameters
        ----------
        query : (N, 7) float64
            Positions, axes and diameters in the local frame.
        candidates : sequence of Candidate
        """
        rough = self._coarse(query, candidates)
        order = np.argsort(-rough, kind="stable")[: self._config.max_refined]
        refined = [self.refined(query, candidates[order[0]].T_map_local)]
        for k in order[1:]:
            if rough[k] >= _HOPELESS * refined[0].support:
                refined.append(self.refined(query, candidates[k].T_map_local))
        return sorted(refined, key=lambda found: -found.support)

    def refined(self, query: Float64, T_map_local: Pose) -> Agreement:
        """The pose near a given one at which (N, 7) landmarks lie best on those of the map."""
        T = T_map_local
        for step in _TIGHTENING:
            rows, mapped, _ = self._pairs(query, T, step * self._config.tolerance)
            if len(rows) < _FEWEST:
                break
            T = self._fitted(query[rows], mapped)
        return self._at(query, T)

    def shifted(self, query: Float64, found: Agreement) -> Agreement | None:
        """The best pose with the same heading a few metres away: what rows of a plantation make.

        None where too few landmarks would lie on the map there.
        """
        T_map_local = found.T_map_local
        inner = np.argsort(np.hypot(query[:, 0], query[:, 1]), kind="stable")[:_ENOUGH]
        x, y = geometry.transform(T_map_local, query[inner, :3])[:, :2].T
        u, v = self._positions[:, :2].T
        near = (u > x.min() - _SHIFT_M) & (u < x.max() + _SHIFT_M)
        near &= (v > y.min() - _SHIFT_M) & (v < y.max() + _SHIFT_M)
        along, across = u[near, None] - x, v[near, None] - y
        elsewhere = (np.abs(along) < _SHIFT_M) & (np.abs(across) < _SHIFT_M)
        elsewhere &= along**2 + across**2 > (_COARSE * self._config.tolerance) ** 2
        shift, count = _densest(along[elsewhere], across[elsewhere], self._config.tolerance)
        if count * len(query) < _HOPELESS * found.support * len(inner):
            return None
        T = T_map_local.copy()
        T[:2, 3] += shift
        return self.refined(query, T)

    def _coarse(self, query: Float64, candidates: Sequence[Candidate]) -> Float64:
        """Support of each candidate where it stands; here a map's landmark may count twice."""
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
        _, first = np.unique(mapped[order], return_index=True)  # each with the nearest
        distances = distances[order[first]]
        rmse = float(np.sqrt(np.mean(distances**2))) if len(distances) else 0.0
        support = float((1 - (distances / tolerance) ** 2).sum())
        return Agreement(T_map_local, len(distances), support, rmse)

    def _fitted(self, query: Float64, mapped: Int64) -> Pose:
        """The pose at which pairs lie on each other, with their feet and, if many, their tips."""
        feet = query[:, :3]
        if len(query) < _FEWEST_TILTED:
            return _level(feet, self._positions[mapped])
        source = np.concatenate([feet, feet + _LEVER_M * query[:, 3:6]])
        target = np.concatenate([self._positions[mapped], self._tips[mapped]])
        # A foot is known better than a tip: the axes say how the sensor is tilted, no more.
        T = _rigid(source, target)
        T[:3, 3] = self._positions[mapped].mean(axis=0) - T[:3, :3] @ feet.mean(axis=0)
        return T

    def _pairs(self, query: Float64, T: Pose, radius: float) -> tuple[Int64, Int64, Float64]:
        """Landmarks of the query with the nearest of the map, and their distances."""
        moved = geometry.transform(T, query[:, :3])
        distances, mapped = nearest(self._tree, moved[:, :2], within=radius)
        rows = np.flatnonzero(np.isfinite(distances))
        height = np.abs(moved[rows, 2] - self._positions[mapped[rows], 2])
        rows = rows[height < self._config.height_tolerance]
        return rows, mapped[rows], distances[rows]


def _rigid(source: Float64, target: Float64) -> Pose:
    """The rigid transform that takes (N, 3) points to others with the least squares."""
    middles = source.mean(axis=0), target.mean(axis=0)
    products = (target - middles[1]).T @ (source - middles[0])
    R = geometry.orthonormal(geometry.rigid(products, np.zeros(3)))[:3, :3]
    return geometry.rigid(R, middles[1] - R @ middles[0])


def _level(source: Float64, target: Float64) -> Pose:
    """The same with a turn about z alone."""
    middles = source.mean(axis=0), target.mean(axis=0)
    (ax, ay, _), (bx, by, _) = (source - middles[0]).T, (target - middles[1]).T
    yaw = np.arctan2(float((ax * by - ay * bx).sum()), float((ax * bx + ay * by).sum()))
    R = geometry.yaw_transform(yaw)[:3, :3]
    return geometry.rigid(R, middles[1] - R @ middles[0])


def _densest(along: Float64, across: Float64, cell: float) -> tuple[Float64, int]:
    """Where most of so many shifts lie within two by two cells, and how many."""
    size = 2 * int(np.ceil(_SHIFT_M / cell)) + 1
    column, line = (((d + _SHIFT_M) / cell).astype(np.int64) for d in (along, across))
    counts = np.bincount(column * size + line, minlength=size * size)
    counts = counts.reshape(size, size)
    windows = counts[1:, 1:] + counts[:-1, 1:] + counts[1:, :-1] + counts[:-1, :-1]
    best = np.unravel_index(np.argmax(windows), windows.shape)
    densest: Float64 = (np.array(best) + 1.0) * cell - _SHIFT_M
    return densest, int(windows[best])
