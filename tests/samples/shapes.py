"""Synthetic objects seen from several sides: a training set that needs no recording."""

from __future__ import annotations

import numpy as np
from segloc_lab.training.dataset import SegmentDataset, packed

from segloc.types import Float32, Float64

_SPACING_M = 0.2


def shapes_dataset(objects: int, views: int, seed: int) -> SegmentDataset:
    """Random compositions of boxes, cylinders and walls with relief.

    Each view is a session: points that face the sensor, at a density that falls with distance, with
    2 cm of noise, turned about z.
    """
    rng = np.random.default_rng(seed)
    parts: list[Float32] = []
    labels: list[int] = []
    sessions: list[int] = []
    for label in range(objects):
        points, normals = _object(rng)
        for session in range(views):
            parts.append(_view(points, normals, rng))
            labels.append(label)
            sessions.append(session)
    places = np.array(labels, np.int64)  # each object is a world of its own
    heights = np.array([part[:, 2].mean() for part in parts], np.float32)
    return SegmentDataset(
        *packed(parts),
        places,
        np.array(sessions, np.int64),
        places,
        np.zeros((len(parts), 3)),
        heights,
    )


def _object(rng: np.random.Generator) -> tuple[Float64, Float64]:
    """Points and normals of one to four primitives that touch."""
    makers = (_box, _cylinder, _wall)
    clouds, normals = [], []
    for _ in range(rng.integers(1, 5)):
        points, normal = makers[rng.integers(len(makers))](rng)
        shift = rng.uniform([-1.5, -1.5, 0.0], [1.5, 1.5, 1.0])
        clouds.append(points + shift)
        normals.append(normal)
    return np.concatenate(clouds), np.concatenate(normals)


def _view(points: Float64, normals: Float64, rng: np.random.Generator) -> Float32:
    distance, angle = rng.uniform(6.0, 30.0), rng.uniform(0.0, 2 * np.pi)
    sensor = np.array([distance * np.cos(angle), distance * np.sin(angle), 1.7])
    ray = points - sensor
    # A drive past shows more than one side: grazing and slightly hidden faces stay.
    facing = np.einsum("ni,ni->n", normals, ray) / np.linalg.norm(ray, axis=1) < 0.35
    keep = facing & (rng.random(len(points)) < min(1.0, 12.0 / distance))
    seen = points[keep] if keep.sum() >= 40 else points
    turn = rng.uniform(0.0, 2 * np.pi)
    c, s = np.cos(turn), np.sin(turn)
    turned = seen @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]).T
    return (turned + 0.02 * rng.standard_normal(turned.shape)).astype(np.float32)


def _faces(size: Float64, rng: np.random.Generator) -> tuple[Float64, Float64]:
    clouds, normals = [], []
    for axis in range(3):
        u, v = (axis + 1) % 3, (axis + 2) % 3
        count = max(4, int(size[u] * size[v] / _SPACING_M**2))
        for side in (-1.0, 1.0):
            face = rng.uniform(-0.5, 0.5, (count, 3)) * size
            face[:, axis] = side * size[axis] / 2
            normal = np.zeros((count, 3))
            normal[:, axis] = side
            clouds.append(face)
            normals.append(normal)
    return np.concatenate(clouds), np.concatenate(normals)


def _box(rng: np.random.Generator) -> tuple[Float64, Float64]:
    points, normals = _faces(rng.uniform([0.5, 0.5, 0.5], [5.0, 2.5, 3.0]), rng)
    points[:, 2] += np.ptp(points[:, 2]) / 2
    return points, normals


def _wall(rng: np.random.Generator) -> tuple[Float64, Float64]:
    """A thin box with bays that stand out and openings."""
    size = rng.uniform([3.0, 0.1, 1.0], [12.0, 0.4, 6.0])
    points, normals = _faces(size, rng)
    for _ in range(rng.integers(0, 4)):
        centre, width = rng.uniform(-0.5, 0.5) * size[0], rng.uniform(0.5, 1.5)
        inside = np.abs(points[:, 0] - centre) < width / 2
        depth = rng.uniform(-0.6, 0.6)
        points[inside, 1] += depth if rng.random() < 0.5 else 0.0
        low = rng.uniform(-0.5, 0.2) * size[2]
        hole = inside & (points[:, 2] > low) & (points[:, 2] < low + 1.2)
        points, normals = points[~hole], normals[~hole]
    points[:, 2] += size[2] / 2
    return points, normals


def _cylinder(rng: np.random.Generator) -> tuple[Float64, Float64]:
    radius, height = rng.uniform(0.1, 1.2), rng.uniform(1.0, 7.0)
    count = max(40, int(2 * np.pi * radius * height / _SPACING_M**2))
    angle = rng.uniform(0.0, 2 * np.pi, count)
    normals = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(count)])
    points = radius * normals + np.column_stack(
        [np.zeros((count, 2)), rng.uniform(0.0, height, count)]
    )
    return points, normals
