"""What a window of scans shows, gathered at once on its lattice by NumPy."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from segloc import geometry
from segloc.frontend.local_cloud import LocalCloudConfig
from segloc.types import Float32, Float64, Pose

ONE = 4096  # parts of a voxel's edge


def _means(points: Float64, edge: float) -> Float64:
    """The mean of every voxel, in the order of the voxels, x fastest."""
    parts = np.rint(points * (ONE / edge)).astype(np.int64)
    cells, inverse, counts = np.unique(
        parts[:, ::-1] >> 12, axis=0, return_inverse=True, return_counts=True
    )
    sums = np.zeros((len(cells), 3), np.int64)
    np.add.at(sums, inverse.reshape(-1), parts & (ONE - 1))
    means: Float64 = (cells[:, ::-1] + sums / (ONE * counts[:, None])) * edge
    return means


def exact_means(points: Float64, edge: float) -> Float64:
    """The same without rounding of the points."""
    cells, inverse, counts = np.unique(
        np.floor(points[:, ::-1] / edge), axis=0, return_inverse=True, return_counts=True
    )
    sums = np.zeros((len(cells), 3))
    np.add.at(sums, inverse.reshape(-1), points)
    means: Float64 = sums / counts[:, None]
    return means


def gathered(
    scans: Sequence[Float32],
    poses: Sequence[Pose],
    reference: int,
    config: LocalCloudConfig,
    voxel_size: float,
) -> Float32:
    """The points of the local cloud around one of the scans."""
    reach = math.sqrt(2.0) * config.radius_m + config.window_m
    placed = []
    for scan, T in zip(scans, poses, strict=True):
        points = scan.astype(np.float64)
        near = points[(points**2).sum(axis=1) <= reach * reach]
        thin = exact_means(near, voxel_size / 2).astype(np.float32)
        placed.append(geometry.transform(T, thin))
    T_local_odom = geometry.inverse(geometry.levelled(poses[reference]))
    local = geometry.transform(T_local_odom, _means(np.concatenate(placed), voxel_size))
    radius = config.radius_m
    inside = (local[:, 0] ** 2 + local[:, 1] ** 2 < radius**2) & (np.abs(local[:, 2]) < radius)
    return local[inside].astype(np.float32)
