"""A rough pose -> where the clouds fit best: generalised ICP against prepared tiles of the map."""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
import small_gicp

from . import geometry
from ._native import PointIndex
from .segmentation import Segmentation
from .types import Float32, Float64, Pose

if TYPE_CHECKING:
    from .verification import VerificationConfig

MIN_ICP_POINTS = 20
COVARIANCE_SCALE = 20.0
"""Neighbouring correspondences err together, so the curvature of the cost alone claims far too
much. With this factor the normalised squared error is about 1 on simulated towns."""


class Refiner:
    """Aligns live clouds with a map's cloud.

    Parameters
    ----------
    cloud : (N, 3) float32
        The map's voxelised cloud.
    index : PointIndex
        Of the same points.
    config : VerificationConfig
        Its fields that begin with ``icp``, and ``separation``: a pose that moves farther than this
        has run away.
    """

    def __init__(self, cloud: Float32, index: PointIndex, config: VerificationConfig) -> None:
        self._cloud = cloud
        self._index = index
        self._config = config
        self._tile = lru_cache(maxsize=config.icp_tiles)(self._prepared_tile)

    def refine(self, T: Pose, scene: Segmentation) -> tuple[Pose, Float64 | None]:
        """Align a live cloud with the map around a candidate pose.

        Parameters
        ----------
        T : (4, 4) float64
            Takes the live cloud to the map's cloud.
        scene : Segmentation

        Returns
        -------
        (4, 4) float64
            Unchanged where there is too little to align, or the alignment runs away.
        (6, 6) float64 or None
            Covariance of rotation and translation; None where it is unchanged.
        """
        config = self._config
        tile = self._tile(
            round(float(T[0, 3]) / config.icp_tile), round(float(T[1, 3]) / config.icp_tile)
        )
        surface = scene.surface
        near = (surface[:, :2] ** 2).sum(axis=1) < config.icp_radius**2
        if tile is None or near.sum() < MIN_ICP_POINTS:
            return T, None
        target, tree = tile
        source, _ = small_gicp.preprocess_points(surface[near].astype(np.float64), config.icp_voxel)
        result = small_gicp.align(
            target, source, tree, T, "GICP", max_correspondence_distance=config.icp_reach
        )
        refined = np.array(result.T_target_source)
        moved = geometry.inverse(T) @ refined
        if not np.isfinite(refined).all() or np.linalg.norm(moved[:3, 3]) > config.separation:
            return T, None
        return geometry.orthonormal(refined), _covariance(result)

    def _prepared_tile(self, x: int, y: int) -> tuple[Any, Any] | None:
        """The map around a tile's centre, thinned and with its normals, and its search tree.

        Preparing it costs far more than the alignment does; successive queries of one robot share
        it. Which tile is used depends on the candidate alone, so the answer does not depend on
        what was asked before.
        """
        config = self._config
        near = self._index.within(
            x * config.icp_tile, y * config.icp_tile, config.icp_radius + config.icp_tile
        )
        if len(near) < MIN_ICP_POINTS:
            return None
        prepared: tuple[Any, Any] = small_gicp.preprocess_points(
            self._cloud[near].astype(np.float64), config.icp_voxel
        )
        return prepared


def _covariance(result: small_gicp.RegistrationResult) -> Float64 | None:
    """Covariance of (rotation, translation) from the curvature of the ICP cost."""
    degrees = 3 * result.num_inliers - 6
    H = np.array(result.H)
    if degrees <= 0 or not np.isfinite(H).all() or np.linalg.cond(H) > 1e12:
        return None
    inverse = np.linalg.inv(H) * (COVARIANCE_SCALE * 2.0 * result.error / degrees)
    covariance: Float64 = (inverse + inverse.T) / 2
    return covariance
