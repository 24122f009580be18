"""A small stand of trees as stems, the map of it, and what is seen of it at a pose."""

from __future__ import annotations

import math

import numpy as np
from scipy.spatial import cKDTree
from segloc_stems import LandmarkMap, Landmarks

from segloc import geometry
from segloc.types import Float64, Pose

SIZE_M = 80.0


def stand(seed: int, stems: int = 400) -> Landmarks:
    """Stems at random on a slope."""
    rng = np.random.default_rng(seed)
    where = rng.uniform(0, SIZE_M, (stems, 2))
    axes = np.column_stack([rng.normal(0, 0.05, (stems, 2)), np.ones(stems)])
    positions = np.column_stack([where, 0.05 * where[:, 0]])
    return Landmarks(positions, axes, rng.uniform(0.1, 0.6, stems))


def plantation(every_m: float = 3.0) -> Landmarks:
    """Equal stems in a square lattice."""
    marks = np.arange(0, SIZE_M, every_m)
    x, y = (grid.ravel() for grid in np.meshgrid(marks, marks))
    return Landmarks(np.column_stack([x, y, 0 * x]), diameters=np.full(len(x), 0.3))


def pose(x: float, y: float, yaw: float, tilt: float = 0.0) -> Pose:
    """T_map_sensor there, turned about its own x axis by ``tilt`` radians."""
    turn = np.array(
        [
            [1, 0, 0],
            [0, math.cos(tilt), -math.sin(tilt)],
            [0, math.sin(tilt), math.cos(tilt)],
        ]
    )
    return geometry.yaw_transform(yaw, (x, y, 0.05 * x + 1.5)) @ geometry.rigid(turn, np.zeros(3))


def seen(
    stems: Landmarks, T: Pose, *, keep: float = 1.0, noise: float = 0.03, seed: int = 0
) -> Landmarks:
    """What of the stems within 20 m is detected at a pose, in the sensor's frame."""
    rng = np.random.default_rng(seed)
    assert stems.diameters is not None
    local = stems.transform(geometry.inverse(T))
    near = (np.hypot(local[:, 0], local[:, 1]) < 20) & (rng.random(len(local)) < keep)
    local = local[near]
    moved = local[:, :3] + rng.normal(0, noise, (len(local), 3))
    return Landmarks(moved, local[:, 3:6], local[:, 6])


def surveyed(stems: Landmarks) -> LandmarkMap:
    """The map that is made along a line through the middle."""
    poses = [pose(x, 40.0, 0.1 * x) for x in np.arange(15.0, 70.0, 5.0)]
    views = [(seen(stems, T, keep=0.9, seed=k), T) for k, T in enumerate(poses)]
    return LandmarkMap.build(views)


def cylinders(
    stems: Landmarks, seed: int = 0, *, tall_m: float = 6.0, noise: float = 0.01
) -> Float64:
    """Points on their bark, the first metres of it, all around, and on the ground of the slope."""
    rng = np.random.default_rng(seed)
    assert stems.diameters is not None
    parts = []
    for foot, axis, diameter in zip(
        stems.positions, stems.directions, stems.diameters, strict=True
    ):
        up, turn = rng.uniform(0, tall_m, 400), rng.uniform(-math.pi, math.pi, 400)
        ring = np.column_stack([np.cos(turn), np.sin(turn), 0 * turn]) * diameter / 2
        parts.append(foot + up[:, None] / axis[2] * axis + ring)
    where = rng.uniform(0, SIZE_M, (40_000, 2))
    parts.append(np.column_stack([where, 0.05 * where[:, 0]]))
    points = np.concatenate(parts)
    return points + rng.normal(0, noise, points.shape)


def visible(points: Float64, stems: Landmarks, T: Pose, radius_m: float = 25.0) -> Float64:
    """Those of the points near a pose that lie on the near side of their stem, sensor frame."""
    tree = cKDTree(stems.positions[:, :2])
    _, stem = tree.query(points[:, :2])
    outwards = points[:, :2] - stems.positions[stem, :2]
    towards = T[:2, 3] - stems.positions[stem, :2]
    ground = points[:, 2] < 0.05 * points[:, 0] + 0.1
    seen_side = ground | ((outwards * towards).sum(axis=1) > 0)
    near = np.hypot(*(points[:, :2] - T[:2, 3]).T) < radius_m
    return geometry.transform(geometry.inverse(T), points[seen_side & near])
