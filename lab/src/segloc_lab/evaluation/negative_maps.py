"""Maps in which nothing is to be found, made of real ones: every pose in them is false."""

from __future__ import annotations

import numpy as np

from segloc.map.segment_map import SegmentMap
from segloc.types import Descriptors, Float32, Float64


def mirrored(prior_map: SegmentMap) -> SegmentMap:
    """The map behind a mirror: all shapes and distances are right, the handedness is not.

    No rigid motion brings a place onto its mirror image, so a localizer that finds its own
    recordings in here answers too readily: a street looks much like itself in a mirror.
    """
    flip = np.array([1.0, -1.0, 1.0])
    cloud = (prior_map.cloud + prior_map.origin) * flip
    across = np.diag([*flip, 1.0])
    path = across @ prior_map.trajectory @ across
    return _remade(prior_map, prior_map.centroids * flip, prior_map.vectors, cloud, path)


def shuffled(prior_map: SegmentMap, seed: int = 0) -> SegmentMap:
    """The map with every descriptor at another segment.

    Here a right pose can still be found, where centroids alone suffice.
    """
    vectors = prior_map.vectors[np.random.default_rng(seed).permutation(len(prior_map))]
    cloud = prior_map.cloud + prior_map.origin
    return _remade(prior_map, prior_map.centroids, vectors, cloud, prior_map.trajectory)


def _remade(
    prior_map: SegmentMap,
    centroids: Float64,
    vectors: Float32,
    cloud: Float64,
    trajectory: Float64,
) -> SegmentMap:
    other = SegmentMap.empty(
        prior_map.descriptor,
        prior_map.fingerprint,
        prior_map.dim,
        prior_map.origin,
        cloud_voxel=prior_map.cloud_voxel,
    )
    described = Descriptors(vectors, prior_map.quality)
    other.add(described, centroids, prior_map.sizes, session=0, stamp=0.0, cloud=cloud)
    other.add_trajectory(trajectory)
    return other
