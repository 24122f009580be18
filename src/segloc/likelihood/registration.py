"""Two clouds and an initial guess -> their alignment and overlap."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from .. import _native
from ..system.once import once
from ..types import Float32, Float64, Pose

MIN_POINTS = 20
_REACH_M, _REACH_DEG = 2.0, 5.0
"""Standard deviation where nothing fixes a pose: poses farther apart are other places."""
_MIN_VARIANCE = 1e-6
"""Of clouds that are equal."""
_TOLD_ALONG = 2.0
"""What a pair is thought to tell about a motion along its surface, in 1/m^2: the half of the metre
by which it is uncertain there, and normals that err by 3 degrees."""
_ROUGHLY = {"max_iterations": 6, "max_final": 0}
"""By six iterations right and wrong places are told apart as well as by ten: either way, of 197
right ones in 30 worlds at most one promised less than 90 % of the wrong ones (2026-11-30)."""
COVARIANCE_SCALE = 20.0
"""Errors of neighbouring correspondences are correlated, so the curvature of the cost alone is
overconfident. This factor gives a normalised squared error of about 1 on simulated towns."""


@dataclass(frozen=True)
class ErrorModel:
    """Widens the covariance of an alignment: both blocks are scaled, with lower bounds.

    Attributes
    ----------
    rotation_scale, translation_scale : float
        Factors of the standard deviations.
    tilt_deg, yaw_deg : float
        Least standard deviation about a horizontal axis, and about the vertical one [deg].
    horizontal_m, vertical_m : float
        Least standard deviation along a horizontal axis, and along the vertical one [m].
    """

    rotation_scale: float
    translation_scale: float
    tilt_deg: float
    yaw_deg: float
    horizontal_m: float
    vertical_m: float

    def widened(self, covariance: Float64) -> Float64:
        """Return the widened (6, 6) covariance of rotation [rad], then translation [m], z up."""
        scales = np.repeat([self.rotation_scale, self.translation_scale], 3)
        turns = np.radians([self.tilt_deg, self.tilt_deg, self.yaw_deg])
        least = [*turns, self.horizontal_m, self.horizontal_m, self.vertical_m]
        wide: Float64 = covariance * np.outer(scales, scales) + np.diag(np.square(least))
        return wide


ERRORS = ErrorModel(
    rotation_scale=2.2,
    translation_scale=2.1,
    tilt_deg=0.1,
    yaw_deg=0.073,
    horizontal_m=0.015,
    vertical_m=0.027,
)
"""Fitted 2026-11-26 to 483 errors in 14 simulated worlds (town, warehouse, industrial, park,
offices, meadow, forest; HDL-64E, VLP-16, OS1-64; single and accumulated) by ``python -m
segloc_lab.calibration.covariance --each 4``. Of 475 errors in 13 other worlds 88 % and 97 % of the
rotations, 84 % and 93 % of the positions were within the ellipsoids of 68 % and 95 %; by the
alignment alone 44 % and 66 %, 24 % and 47 %. Judged again 2026-11-27, with covariances that are
open along walls: of 182 errors in 7 other worlds 78 % and 93 %, 85 % and 96 %; by a new fit to as
many worlds 76 % and 84 %, 80 % and 97 %, so that these stay."""


@dataclass(frozen=True)
class Alignment:
    """Alignment of one cloud with another.

    Attributes
    ----------
    T_target_source : (4, 4) float64
    curvature, motion : (6, 6) float64
        Of half the squared error, each in units of its deviation, and of the squared motion of the
        paired points [m^2], by rotation [rad] and translation [m] in the source's frame.
    variance : float
        Of the errors, by what is left of them.
    """

    T_target_source: Pose
    curvature: Float64
    motion: Float64
    variance: float

    def shift_m(self, T_target_source: Pose) -> float:
        """Return the distance from a pose, as that where the alignment began."""
        return math.dist(self.T_target_source[:3, 3], T_target_source[:3, 3])

    @once
    def covariance(self) -> Float64:
        """Covariance of rotation [rad] and translation [m], (6, 6), in the source's frame.

        Of what pairs tell about a motion, as much is taken off as normals that err tell about one
        along a surface. So a pose is as open along a bare wall as an alignment reaches.
        """
        reach = np.repeat([math.radians(_REACH_DEG), _REACH_M], 3)
        root = np.linalg.cholesky(self.motion + 1e-9 * np.trace(self.motion) * np.eye(6))
        turned = np.linalg.solve(root, np.linalg.solve(root, self.curvature).T)
        told, axes = np.linalg.eigh((turned + turned.T) / 2)
        kept = root @ (axes * np.sqrt(np.maximum(told - _TOLD_ALONG, 0.0) / self.variance))
        covariance = np.linalg.inv(kept @ kept.T + np.diag(reach**-2.0))
        return np.asarray((covariance + covariance.T) / 2, np.float64)


@dataclass(frozen=True)
class Target:
    """A target cloud of alignments.

    Attributes
    ----------
    surface : Surface
        From :meth:`Aligner.surface`.
    index : PointIndex
        Index of the points of the overlap.
    unmapped_overlap : float
        Score of a point in unmapped space, without even ground.
    """

    surface: _native.Surface
    index: _native.PointIndex
    unmapped_overlap: float = 0.0

    def overlap(self, sample: Float32, T_target_source: Pose, radius: float) -> float:
        """Return the share of a sample (N, 3) that has a point of the target within a radius."""
        poses = T_target_source[None]
        return float(self.index.overlap(sample, poses, radius, self.unmapped_overlap)[0])

    def overlap_rmse(
        self, sample: Float32, T_target_source: Pose, radius: float
    ) -> tuple[float, float]:
        """Return the same, and the RMSE of the pairs [m], which takes twice as long."""
        return self.index.overlap_rmse(sample, T_target_source, radius, self.unmapped_overlap)


class Aligner:
    """Generalised ICP (A. Segal, D. Haehnel, S. Thrun, RSS 2009) of thinned clouds.

    Parameters
    ----------
    voxel : float
        Voxel size of clouds [m].
    max_correspondence : float
        Maximum correspondence distance [m].
    threads : int
        0 is all cores; results do not depend on it.
    """

    def __init__(self, voxel: float, max_correspondence: float, threads: int = 0) -> None:
        self._voxel, self._threads = voxel, threads
        self._max_correspondence = max_correspondence

    def surface(self, points: Float32, *, target: bool = False) -> _native.Surface:
        """Preprocess a cloud (N, 3) for alignment; reusable. One that is only a target is tiled."""
        thinned = _native.voxel_grid(np.ascontiguousarray(points), self._voxel)
        return _native.Surface(thinned, self._max_correspondence, 2.0 * self._voxel, target)

    def align(
        self,
        target: _native.Surface,
        source: _native.Surface,
        T_target_source: Pose,
        *,
        roughly: bool = False,
    ) -> Alignment | None:
        """Align from an initial guess; None if it is not finite, or the clouds overlap too little.

        ``roughly`` uses some of the source's points, in about a fifth of the time.
        """
        if not np.isfinite(T_target_source).all():
            return None
        T, H, motion, error, inliers, _ = target.align(
            source,
            np.ascontiguousarray(T_target_source),
            threads=self._threads,
            **(_ROUGHLY if roughly else {}),
        )
        degrees = 3 * inliers - 6
        if min(inliers, len(target)) < MIN_POINTS or not np.isfinite(np.append(T, H)).all():
            return None
        variance = COVARIANCE_SCALE * 2.0 * error / degrees
        return Alignment(T, H, motion, max(variance, _MIN_VARIANCE))


def thinned(points: Float32, count: int) -> Float32:
    """Return at most ``count`` of the spatially sorted points, evenly spread."""
    step = max(1, -(-len(points) // count))
    return np.ascontiguousarray(points[::step])
