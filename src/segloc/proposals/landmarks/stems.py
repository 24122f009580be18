"""Stems of trees, poles and the like, found in clouds."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ... import _native, geometry
from ...frontend.local_cloud import Accumulator, LocalCloudConfig, Scans
from ...frontend.segmentation import SegmentationConfig, heights_above_ground
from ...types import Float32, Float64, Int64, LocalCloud
from .config import StemConfig
from .landmarks import Landmarks
from .stem_clusters import upright
from .stem_fit import fitted

_VOXEL_M = 0.1
_MODEL_M = 0.05
"""By which a stem is no cylinder."""


@dataclass(frozen=True)
class Stems(Landmarks):
    """Landmarks that were found in a cloud, with how well they are known.

    Attributes
    ----------
    position_std : (N,) float64
        Standard deviation of the position along x and along y, metres.
    counts : (N,) int64
        Points of each.
    """

    position_std: Float64 | None = None
    counts: Int64 | None = None


class StemFinder:
    """Finds stems in clouds whose z axis points up.

    Slices of height are cut into clusters. Small ones that lie one above another, with nothing
    beside them, are a stem; an axis and a circle are fitted to its points.

    Parameters
    ----------
    config : StemConfig, optional
    segmentation : SegmentationConfig, optional
        What ground is.
    """

    def __init__(
        self, config: StemConfig | None = None, segmentation: SegmentationConfig | None = None
    ) -> None:
        self._config = config or StemConfig()
        self._segmentation = segmentation or SegmentationConfig()

    def find(
        self, points: Float32, *, seen_from_origin: bool = False, spacing: float = 0.0
    ) -> Stems:
        """The stems of a cloud, in its own frame.

        Parameters
        ----------
        points : (N, 3) float32
            With their ground.
        seen_from_origin : bool
            Whether all points were seen from (0, 0), as those of a single scan are.
        spacing : float
            Of the voxels that the cloud was thinned to, metres.
        """
        heights = heights_above_ground(points, self._segmentation)
        # Neighbours in a grid are up to half as far again apart as its voxels are wide.
        tolerance = max(self._config.tolerance, 1.4 * spacing)
        things = upright(points, heights, tolerance, self._config)
        fits = fitted(things, seen_from_origin)
        axes = np.column_stack([fits.leans, np.ones(len(things))])
        std = np.hypot(_MODEL_M, fits.deviations / np.sqrt(np.maximum(things.counts, 1)))
        return Stems(fits.feet, axes, fits.diameters, position_std=std, counts=things.counts)


def find_stems(
    scans: Scans | LocalCloud,
    config: StemConfig | None = None,
    local_cloud: LocalCloudConfig | None = None,
) -> Stems:
    """The stems that one or several scans show, in the frame of the last scan's sensor.

    Parameters
    ----------
    scans : Scan, (N, 3) array, list of Scan, or LocalCloud
        As :meth:`segloc.Localizer.localize` takes them.
    config : StemConfig, optional
    local_cloud : LocalCloudConfig, optional
        How scans are gathered, and how the sensor is mounted.

    Raises
    ------
    InvalidScan
        If several scans are given without poses, or something else.
    """
    cloud = scans if isinstance(scans, LocalCloud) else Accumulator(local_cloud).gather(scans)
    thinned = _native.voxel_grid(cloud.points, _VOXEL_M)
    found = StemFinder(config).find(thinned, seen_from_origin=cloud.num_scans == 1)
    T_sensor_local = geometry.inverse(cloud.T_local_sensor)
    columns = found.moved(T_sensor_local)
    return Stems(
        columns[:, :3],
        columns[:, 3:6],
        columns[:, 6],
        cloud.stamp,
        position_std=found.position_std,
        counts=found.counts,
    )
