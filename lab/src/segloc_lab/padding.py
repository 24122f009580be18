"""Maps made of others: mirrored, and padded with other places far from them."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from segloc import SegmentMap, geometry
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
    return remade(prior_map, centroids=prior_map.centroids * flip, cloud=cloud, trajectory=path)


def beside_its_mirror(prior_map: SegmentMap) -> SegmentMap:
    """The map with its mirror image ``APART_M`` away: only what tells them apart is found here."""
    both, mirror = prior_map.crop((0.0, 0.0), math.inf), mirrored(prior_map)  # a copy
    T = geometry.yaw_transform(0.0, (APART_M, 0.0, 0.0))
    both.add(
        Descriptors(mirror.vectors, mirror.quality),
        geometry.transform(T, mirror.centroids),
        mirror.sizes,
        session=0,
        stamp=0.0,
        cloud=geometry.transform(T, mirror.cloud + mirror.origin),
    )
    both.add_trajectory(T @ mirror.trajectory)
    return both


def remade(
    prior_map: SegmentMap,
    *,
    vectors: Float32 | None = None,
    centroids: Float64 | None = None,
    cloud: Float64 | None = None,
    trajectory: Float64 | None = None,
) -> SegmentMap:
    """The map with some of its columns replaced; those given are in the map frame."""
    other = SegmentMap.empty(
        prior_map.descriptor,
        prior_map.fingerprint,
        prior_map.dim,
        prior_map.origin,
        cloud_voxel=prior_map.cloud_voxel,
    )
    other.add(
        Descriptors(prior_map.vectors if vectors is None else vectors, prior_map.quality),
        prior_map.centroids if centroids is None else centroids,
        prior_map.sizes,
        session=0,
        stamp=0.0,
        cloud=prior_map.cloud + prior_map.origin if cloud is None else cloud,
    )
    other.add_trajectory(prior_map.trajectory if trajectory is None else trajectory)
    other.metadata.update(prior_map.metadata)
    return other


FAR_M = 20_000.0
"""From the map to the nearest of the other places."""

APART_M = 2_000.0
_A_ROW = 8


def padded(prior_map: SegmentMap, padding: Sequence[SegmentMap], size: int) -> SegmentMap:
    """The map with other places around it, up to ``size`` segments.

    Each map of ``padding`` is placed again and again: turned, with every descriptor moved by noise
    of a fifth of the spread of its dimensions and every centroid by noise of 0.2 m. Its cloud is
    there in the first place only. Where segments are put depends on ``size`` alone: maps of one
    place by several methods, padded with maps of other places by the same methods, are again maps
    of one place.
    """
    larger = prior_map.crop((0.0, 0.0), math.inf)  # a copy
    centre = prior_map.centroids.mean(axis=0)
    turns, shifts, noise = (np.random.default_rng([size, k]) for k in range(3))
    place = 0
    while len(larger) < size:
        other = padding[place % len(padding)]
        count = min(len(other), size - len(larger))
        at = (FAR_M + APART_M * (place % _A_ROW), APART_M * (place // _A_ROW), 0.0)
        turn = turns.uniform(-math.pi, math.pi)
        T = geometry.yaw_transform(turn, tuple((centre + at).tolist()))
        middle = np.append(other.centroids[:, :2].mean(axis=0), 0.0)
        spread = 0.2 * other.vectors.std(axis=0)
        vectors = other.vectors[:count] + noise.normal(0, spread, (count, other.dim))
        centroids = geometry.transform(T, other.centroids[:count] - middle)
        quality = None if other.quality is None else other.quality[:count]
        cloud = np.empty((0, 3))
        if place < len(padding):
            cloud = geometry.transform(T, other.cloud + other.origin - middle)
        larger.add(
            Descriptors(vectors.astype(np.float32), quality),
            centroids + shifts.normal(0, 0.2, centroids.shape),
            other.sizes[:count],
            session=place + 1,
            stamp=0.0,
            cloud=cloud,
        )
        place += 1
    return larger


def padded_with_copies(prior_map: SegmentMap, size: int) -> SegmentMap:
    """The map among mirror images of itself, where nothing of it can be found a second time."""
    return padded(prior_map, [mirrored(prior_map)], size)
