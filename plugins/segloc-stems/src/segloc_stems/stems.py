"""Stems of trees, poles and the like, found in clouds."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from segloc import _native, geometry
from segloc.frontend.local_cloud import Accumulator, LocalCloudConfig, Scans
from segloc.frontend.segmentation import SegmentationConfig, heights_above_ground
from segloc.types import Float32, Float64, Int64, LocalCloud

from .config import StemConfig
from .landmarks import Landmarks

_VOXEL_M = 0.1
_MODEL_STD_M = 0.05  # deviation of a stem from a cylinder

# Clusters.
_SLICE_GAP = 10.0
"""Gap between slices, in tolerances: one call clusters all slices separately."""
_MAX_POINTS = 100_000
_MAX_SLICE_STEP = 2
"""Largest step between slices of a stem: one may be empty, between two beams or behind a twig."""
_MAX_WIDTH_RATIO = 2.0
"""Width of a stem relative to its slices: stems are tilted, forked, and have boughs."""

# Fits.
_STEPS = 3
"""Steps of reweighting, which suppresses twigs and undergrowth."""
_MAX_SLOPE = 0.2
"""Largest run over rise of an axis."""
_UPRIGHT_M2 = 0.2
"""Weight of the prior of a vertical axis: that of a point this far along it, squared."""
_NOISE_M = 0.04
"""Noise of ranges and bark: the lower bound of residuals."""
_MAX_RADIUS_M, _MIN_DIAMETER_M = 0.6, 0.05
_MIDDLE = (0.05, 0.95)
"""Quantiles across the line of sight, which exclude twigs and edge returns."""


@dataclass(frozen=True)
class Stems(Landmarks):
    """Landmarks found in a cloud, with their uncertainty.

    Attributes
    ----------
    position_std : (N,) float64
        Standard deviation of the position along x and y [m].
    counts : (N,) int64
        Number of points of each.
    """

    position_std: Float64 | None = None
    counts: Int64 | None = None


class StemFinder:
    """Finds stems in clouds with a vertical z axis.

    Height slices are clustered. Small, isolated clusters above each other form a stem; an axis and
    a circle are fitted to its points.

    Parameters
    ----------
    config : StemConfig, optional
    segmentation : SegmentationConfig, optional
        Definition of ground.
    """

    def __init__(
        self, config: StemConfig | None = None, segmentation: SegmentationConfig | None = None
    ) -> None:
        self._config = config or StemConfig()
        self._segmentation = segmentation or SegmentationConfig()

    def find(
        self, points: Float32, *, seen_from_origin: bool = False, spacing: float = 0.0
    ) -> Stems:
        """Find the stems of a cloud, in its own frame.

        Parameters
        ----------
        points : (N, 3) float32
            Points with their ground.
        seen_from_origin : bool
            True if all points were seen from (0, 0), as in a single scan.
        spacing : float
            Voxel size of the cloud [m].
        """
        heights = heights_above_ground(points, self._segmentation)
        # Neighbours in a voxel grid are up to 1.5 voxels apart.
        tolerance = max(self._config.tolerance, 1.4 * spacing)
        objects = upright(points, heights, tolerance, self._config)
        fits = fit_circles(objects, seen_from_origin)
        axes = np.column_stack([fits.slopes, np.ones(len(objects))])
        std = np.hypot(_MODEL_STD_M, fits.deviations / np.sqrt(np.maximum(objects.counts, 1)))
        return Stems(fits.feet, axes, fits.diameters, position_std=std, counts=objects.counts)


def find_stems(
    scans: Scans | LocalCloud,
    config: StemConfig | None = None,
    local_cloud: LocalCloudConfig | None = None,
) -> Stems:
    """Find the stems in one or several scans, in the frame of the last scan's sensor.

    Parameters
    ----------
    scans : Scan, (N, 3) array, list of Scan, or LocalCloud
        As for :meth:`segloc.Localizer.localize`.
    config : StemConfig, optional
    local_cloud : LocalCloudConfig, optional
        Accumulation of scans, and mount of the sensor.

    Raises
    ------
    InvalidScan
        If several scans have no poses, or the type is wrong.
    """
    cloud = scans if isinstance(scans, LocalCloud) else Accumulator(local_cloud).gather(scans)
    thinned = _native.voxel_grid(cloud.points, _VOXEL_M)
    found = StemFinder(config).find(thinned, seen_from_origin=cloud.num_scans == 1)
    T_sensor_local = geometry.inverse(cloud.T_local_sensor)
    columns = found.transform(T_sensor_local)
    return Stems(
        columns[:, :3],
        columns[:, 3:6],
        columns[:, 6],
        cloud.stamp,
        position_std=found.position_std,
        counts=found.counts,
    )


@dataclass(frozen=True)
class Upright:
    """Points of K upright objects, object by object.

    Attributes
    ----------
    points : (M, 3) float64
    heights : (M,) float64
        Heights above ground [m].
    counts : (K,) int64
        Number of points of each.
    """

    points: Float64
    heights: Float64
    counts: Int64

    def __len__(self) -> int:
        return len(self.counts)

    @property
    def starts(self) -> Int64:
        """Index of the first point of each, (K,) int64."""
        return np.cumsum(self.counts) - self.counts


def upright(points: Float32, heights: Float32, tolerance: float, config: StemConfig) -> Upright:
    """Find the objects of a cloud that are slim and isolated at several heights.

    Parameters
    ----------
    points : (N, 3) float32
        Points in a frame with a vertical z axis.
    heights : (N,) float32
        Heights above ground [m].
    tolerance : float
        Largest gap between points of a cluster [m].
    config : StemConfig
    """
    band = (heights > config.lowest_m) & (heights < config.highest_m)
    points, heights = points[band], heights[band]
    slices = ((heights - config.lowest_m) / config.slice_m).astype(np.int64)
    members, counts = _clusters(points, slices, tolerance)
    slim = _widths(points[members], counts) < config.widest_m
    members, counts = members[np.repeat(slim, counts)], counts[slim]
    chains = _chains(points[members].astype(np.float64), slices[members], counts, config.link_m)
    which = np.repeat(chains, counts)
    order = np.argsort(which, kind="stable")
    members, which = members[order], which[order]
    return _stems(points[members], heights[members], np.bincount(which), config)


def _clusters(points: Float32, slices: Int64, tolerance: float) -> tuple[Int64, Int64]:
    """Return the rows of points, cluster by cluster, and the size of each cluster."""
    lifted = points.copy()
    lifted[:, 2] = slices * (_SLICE_GAP * tolerance)
    members, offsets = _native.euclidean_clusters(lifted, tolerance, 1, _MAX_POINTS)
    return members.astype(np.int64), np.diff(offsets)


def _widths(points: Float32, counts: Int64) -> Float64:
    """Return the horizontal diagonal of each cluster [m]."""
    if not len(counts):
        return np.empty(0)
    starts = np.cumsum(counts) - counts
    xy = points[:, :2].astype(np.float64)
    span = np.maximum.reduceat(xy, starts) - np.minimum.reduceat(xy, starts)
    widths: Float64 = np.hypot(span[:, 0], span[:, 1])
    return widths


def _chains(points: Float64, slices: Int64, counts: Int64, link: float) -> Int64:
    """Return the chain of each cluster; a chain holds clusters above each other."""
    if not len(counts):
        return np.empty(0, np.int64)
    starts = np.cumsum(counts) - counts
    centres = np.add.reduceat(points[:, :2], starts) / counts[:, None]
    pairs = cKDTree(centres).query_pairs(link, output_type="ndarray")
    up = np.abs(slices[starts][pairs[:, 0]] - slices[starts][pairs[:, 1]])
    a, b = pairs[(up >= 1) & (up <= _MAX_SLICE_STEP)].T
    graph = coo_matrix((np.ones(len(a)), (a, b)), shape=(len(counts), len(counts)))
    chains: Int64 = connected_components(graph, directed=False)[1].astype(np.int64)
    return chains


def _stems(points: Float32, heights: Float32, counts: Int64, config: StemConfig) -> Upright:
    """Return the chains with enough points and length, and not too wide."""
    starts = np.cumsum(counts) - counts
    if not len(counts):
        return Upright(np.empty((0, 3)), np.empty(0), counts)
    length = np.maximum.reduceat(heights, starts) - np.minimum.reduceat(heights, starts)
    good = (counts >= config.fewest_points) & (length >= config.least_length_m)
    good &= _widths(points, counts) < _MAX_WIDTH_RATIO * config.widest_m
    kept = np.repeat(good, counts)
    return Upright(points[kept].astype(np.float64), heights[kept].astype(np.float64), counts[good])


@dataclass(frozen=True)
class Fits:
    """Axes and circles of K objects.

    Attributes
    ----------
    feet : (K, 3) float64
        Intersection of each axis and the ground.
    slopes : (K, 2) float64
        Run over rise of each axis along x and y.
    diameters : (K,) float64
        Diameters [m].
    deviations : (K,) float64
        Root mean square distance of points from the circle, after reweighting [m].
    """

    feet: Float64
    slopes: Float64
    diameters: Float64
    deviations: Float64


class _Sums:
    """Sums over the points of each of K objects."""

    def __init__(self, objects: Upright) -> None:
        self.which = np.repeat(np.arange(len(objects)), objects.counts)
        self._count = len(objects)

    def __call__(self, values: Float64) -> Float64:
        sums: Float64 = np.bincount(self.which, values, self._count).astype(np.float64)
        return sums


def fit_circles(objects: Upright, seen_from_origin: bool) -> Fits:
    """Fit an axis and a circle to each object.

    Parameters
    ----------
    objects : Upright
    seen_from_origin : bool
        True if all points were seen from (0, 0), so that only one side of each object is visible:
        its width across the line of sight is then its diameter. Otherwise a circle is fitted.
    """
    sums = _Sums(objects)
    x, y, z = objects.points.T
    middle = sums(z) / np.maximum(objects.counts, 1)
    up = z - middle[sums.which]
    weight = np.ones(len(z))
    for _ in range(_STEPS):
        slopes, level = _axes(sums, weight, x, y, up)
        circle = _one_sided if seen_from_origin else _all_around
        centre, radius = circle(sums, weight, level, objects)
        off = np.hypot(*(level - centre[sums.which]).T) - radius[sums.which]
        total = np.maximum(sums(weight), 1e-9)
        deviation = np.sqrt(sums(weight * off**2) / total)
        scale = np.maximum(deviation, _NOISE_M)[sums.which]
        weight = 1.0 / (1.0 + (off / (1.5 * scale)) ** 2)
    ground = middle - sums(objects.heights) / np.maximum(objects.counts, 1)
    feet = np.column_stack([centre + slopes * (ground - middle)[:, None], ground])
    return Fits(feet, slopes, np.maximum(2 * radius, _MIN_DIAMETER_M), deviation)


def _axes(
    sums: _Sums, weight: Float64, x: Float64, y: Float64, up: Float64
) -> tuple[Float64, Float64]:
    """Return the slopes, and the points projected along them to mid height, (M, 2)."""
    total = np.maximum(sums(weight), 1e-9)
    mean = sums(weight * up) / total
    rise = weight * (up - mean[sums.which])
    spread = sums(rise * up) + total * _UPRIGHT_M2
    slopes = np.stack([sums(rise * x) / spread, sums(rise * y) / spread], axis=1)
    slopes = np.clip(slopes, -_MAX_SLOPE, _MAX_SLOPE)
    return slopes, np.stack([x, y], axis=1) - up[:, None] * slopes[sums.which]


def _all_around(
    sums: _Sums, weight: Float64, level: Float64, objects: Upright
) -> tuple[Float64, Float64]:
    """Fit centres and radii of circles: least squares of (r^2 - radius^2).

    I. Kasa, "A circle fitting procedure and its error analysis", IEEE Trans. Instrum. Meas. 25,
    1976. If the circle is far larger than the extent of the points, the centre is uncertain, and
    their mean replaces it.
    """
    total = np.maximum(sums(weight), 1e-9)
    mean = np.stack([sums(weight * c) / total for c in level.T], axis=1)
    u, v = (level - mean[sums.which]).T
    square = u * u + v * v
    products = [sums(weight * a * b) / total for a, b in ((u, u), (u, v), (v, v))]
    uu, uv, vv = products[0] + 1e-3, products[1], products[2] + 1e-3
    right = [sums(weight * a * square) / (2 * total) for a in (u, v)]
    det = uu * vv - uv * uv
    shift = np.stack([vv * right[0] - uv * right[1], uu * right[1] - uv * right[0]], axis=1)
    shift /= det[:, None]
    spread = np.sqrt(sums(weight * square) / total)
    radius = np.sqrt((shift**2).sum(axis=1) + spread**2)
    uncertain = (radius > _MAX_RADIUS_M) | (radius > 2 * spread + 0.05)
    shift[uncertain], radius[uncertain] = 0.0, spread[uncertain]
    return mean + shift, radius


def _one_sided(
    sums: _Sums, weight: Float64, level: Float64, objects: Upright
) -> tuple[Float64, Float64]:
    """Fit centres and radii of objects seen from (0, 0), by their width and their near side."""
    total = np.maximum(sums(weight), 1e-9)
    mean = np.stack([sums(weight * c) / total for c in level.T], axis=1)
    ahead = mean / np.maximum(np.hypot(*mean.T), 1e-9)[:, None]
    aside = np.stack([-ahead[:, 1], ahead[:, 0]], axis=1)
    off = level - mean[sums.which]
    across = (off * aside[sums.which]).sum(axis=1)
    order = np.lexsort((across, sums.which))
    low, high = (
        across[order][objects.starts + (share * (objects.counts - 1) + 0.5).astype(np.int64)]
        for share in _MIDDLE
    )
    radius = np.minimum(np.maximum((high - low) / 2, _MIN_DIAMETER_M / 2), _MAX_RADIUS_M)
    centre = (low + high) / 2
    sideways = np.minimum(np.abs(across - centre[sums.which]) / radius[sums.which], 1.0)
    depth = (off * ahead[sums.which]).sum(axis=1) + radius[sums.which] * np.sqrt(1 - sideways**2)
    behind = sums(weight * depth) / total
    return mean + centre[:, None] * aside + behind[:, None] * ahead, radius
