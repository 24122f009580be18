"""Objects as clouds, and clouds as packed segments."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from segloc import geometry
from segloc.types import Segments


def packed(clouds: Sequence[np.ndarray], height: float = 1.0) -> Segments:
    """One segment a cloud, all at one height above ground [m]."""
    points = np.vstack([np.empty((0, 3)), *clouds]).astype(np.float32)
    offsets = np.cumsum([0, *map(len, clouds)], dtype=np.int64)
    centroids = np.stack([np.asarray(c, np.float64).mean(axis=0) for c in clouds])
    return Segments(points, offsets, centroids, np.full(len(clouds), height, np.float32))


def objects(count: int = 12, seed: int = 0) -> list[np.ndarray]:
    """Leaning boxes' surfaces of various sizes, on a grid of 1/256 m: sums are then exact."""
    rng = np.random.default_rng(seed)
    clouds = []
    for _ in range(count):
        n = int(rng.integers(30, 500))
        shell = rng.uniform(-1, 1, (n, 3))
        shell[np.arange(n), rng.integers(0, 2, n)] = rng.choice([-1, 1], n, p=[0.3, 0.7])
        box = shell * rng.uniform([0.8, 0.2, 0.5], [4, 0.7, 2.5])
        box[:, 1] += 0.15 * box[:, 2]
        placed = geometry.transform(
            geometry.yaw_transform(rng.uniform(0, 6), tuple(rng.uniform(-30, 30, 3))), box
        )
        clouds.append(np.round(placed * 256) / 256)
    return clouds
