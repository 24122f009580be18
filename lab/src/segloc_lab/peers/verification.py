"""A candidate pose, refined by GICP and scored by overlap: what the peers' poses are judged by."""

from __future__ import annotations

from typing import Any

import numpy as np
import small_gicp
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from segloc import _native

from .exchange import Clouds

RADIUS_M = 50.0
"""How far from the sensor clouds are compared."""

ICP_VOXEL_M, COARSE_M, FINE_M = 0.5, 4.0, 1.0
OVERLAP_M, ABOVE_GROUND_M, SAMPLE = 0.4, 0.4, 2000


def near(points: NDArray[np.float32], radius_m: float = RADIUS_M) -> NDArray[np.float32]:
    """The points near the sensor, which is at the origin."""
    return np.ascontiguousarray(points[(points[:, :2] ** 2).sum(axis=1) < radius_m**2])


def standing(points: NDArray[np.float32]) -> NDArray[np.float32]:
    """The points above ground."""
    thin = _native.voxel_grid(points, 0.2)
    return thin[_native.heights_above_ground(thin, 1.0, 0.2, 0.3) > ABOVE_GROUND_M]


class Query:
    """A query's cloud, prepared once for all of its candidates."""

    def __init__(self, points: NDArray[np.float32]) -> None:
        close = near(points)
        above = standing(close)
        self.above = above[:: max(1, -(-len(above) // SAMPLE))].astype(np.float64)
        self.cloud, _ = small_gicp.preprocess_points(close.astype(np.float64), ICP_VOXEL_M)


class Places:
    """The map around each of its views, joined from all views near by.

    Joining them favours the peers: a view of one scan alone covers little of what a query sees.
    """

    def __init__(self, views: Clouds) -> None:
        points = np.concatenate([near(views[i]) @ R.T + t for i, R, t in parts(views)])
        self.origin = points.mean(axis=0)
        cloud = _native.voxel_grid((points - self.origin).astype(np.float32), 0.3)
        self._cloud, self._tree = cloud, cKDTree(cloud)
        self._plan = cKDTree(cloud[:, :2])
        self._at = views.poses[:, :2, 3] - self.origin[:2]
        self._targets: dict[int, Any] = {}

    def target(self, view: int) -> Any:
        """The cloud to align with, with its normals and its search tree."""
        if view not in self._targets:
            close = self._plan.query_ball_point(self._at[view], RADIUS_M + 10.0)
            self._targets[view] = small_gicp.preprocess_points(
                self._cloud[close].astype(np.float64), ICP_VOXEL_M
            )
        return self._targets[view]

    def refined(
        self, query: Query, T_map_query: NDArray[np.float64], view: int
    ) -> tuple[NDArray[np.float64], float]:
        """A pose after GICP, wide and then narrow, and the share of the query that fits there."""
        T = T_map_query.copy()
        T[:3, 3] -= self.origin
        target, tree = self.target(view)
        for limit in (COARSE_M, FINE_M):
            result = small_gicp.align(
                target, query.cloud, tree, T, "GICP", max_correspondence_distance=limit
            )
            T = np.array(result.T_target_source)
        moved = query.above @ T[:3, :3].T + T[:3, 3]
        gaps, _ = self._tree.query(moved, distance_upper_bound=OVERLAP_M)
        T[:3, 3] += self.origin
        return T, float(np.isfinite(gaps).mean()) if len(moved) else 0.0


def parts(views: Clouds) -> list[tuple[int, NDArray[np.float64], NDArray[np.float64]]]:
    return [(i, T[:3, :3], T[:3, 3]) for i, T in enumerate(views.poses)]
