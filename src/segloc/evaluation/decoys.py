"""Maps in which nothing is to be found, made of real ones: every pose in them is false."""

from __future__ import annotations

import numpy as np

from ..map import SegmentMap
from ..types import Descriptors, Float32, Float64


def mirrored(site: SegmentMap) -> SegmentMap:
    """The map behind a mirror: all shapes and distances are right, the handedness is not.

    No rigid motion brings a place onto its mirror image, so a localizer that finds its own
    recordings in here answers too readily: a street looks much like itself in a mirror.
    """
    flip = np.array([1.0, -1.0, 1.0])
    cloud = (site.cloud + site.origin) * flip
    return _remade(site, site.centroids * flip, site.vectors, cloud)


def shuffled(site: SegmentMap, seed: int = 0) -> SegmentMap:
    """The map with every descriptor at another segment.

    Here a right pose can still be found, where centroids alone suffice.
    """
    order = np.random.default_rng(seed).permutation(len(site))
    return _remade(site, site.centroids, site.vectors[order], site.cloud + site.origin)


def _remade(site: SegmentMap, centroids: Float64, vectors: Float32, cloud: Float64) -> SegmentMap:
    other = SegmentMap.empty(
        site.descriptor, site.fingerprint, site.dim, site.origin, cloud_voxel=site.cloud_voxel
    )
    described = Descriptors(vectors, site.quality)
    other.add(described, centroids, site.sizes, session=0, stamp=0.0, cloud=cloud)
    return other
