"""Maps made large: other places are put around a map, far from it."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from segloc import SegmentMap, geometry
from segloc.types import Descriptors

from .evaluation.negative_maps import mirrored

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
