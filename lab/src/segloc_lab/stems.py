"""Simulated stands of trees, as stems: maps of them, and what a detector sees at a pose."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from segloc import geometry
from segloc.proposals.landmarks import LandmarkMap, LandmarkMapper, Landmarks
from segloc.types import Float64, Pose

LEAN_RAD = math.radians(4.0)


@dataclass(frozen=True)
class Detector:
    """What is seen of the stems around a pose.

    Attributes
    ----------
    radius_m : float
    keep : float
        Share of the stems that are found.
    noise_m : float
        Standard deviation of positions along each axis; diameters have a third of it.
    invented : float
        Share of detections where no stem is.
    """

    radius_m: float = 25.0
    keep: float = 0.85
    noise_m: float = 0.08
    invented: float = 0.1

    def seen(self, stems: Landmarks, T_map_sensor: Pose, rng: np.random.Generator) -> Landmarks:
        """Detections in the sensor's frame."""
        assert stems.diameters is not None
        local = geometry.transform(geometry.inverse(T_map_sensor), stems.positions)
        near = np.hypot(local[:, 0], local[:, 1]) < self.radius_m
        near &= rng.random(len(local)) < self.keep
        count = int(near.sum())
        positions = local[near] + rng.normal(0, self.noise_m, (count, 3))
        wrong = rng.random(count) < self.invented
        positions[wrong, :2] = rng.uniform(-self.radius_m, self.radius_m, (wrong.sum(), 2))
        axes = stems.directions[near] @ T_map_sensor[:3, :3]
        diameters = stems.diameters[near] + rng.normal(0, self.noise_m / 3, count)
        return Landmarks(positions, axes, np.maximum(diameters, 0.03))


def wild(rng: np.random.Generator, size_m: float, a_hectare: float) -> Landmarks:
    """Stems that stand at random, at least 0.8 m apart, on rolling ground."""
    count = rng.poisson(a_hectare * (size_m / 100) ** 2)
    where = rng.uniform(0, size_m, (count, 2))
    crowded = {b for _, b in cKDTree(where).query_pairs(0.8)}
    return _grown(np.delete(where, sorted(crowded), axis=0), rng)


def planted(
    rng: np.random.Generator, size_m: float, rows_m: float, trees_m: float, jitter_m: float = 0.15
) -> Landmarks:
    """Stems in rows, a tenth of them gone."""
    x, y = np.meshgrid(np.arange(0, size_m, rows_m), np.arange(0, size_m, trees_m))
    where = np.stack([x.ravel(), y.ravel()], axis=1)
    where = where[rng.random(len(where)) < 0.9]
    return _grown(where + rng.normal(0, jitter_m, where.shape), rng)


def surveyed(
    stems: Landmarks, path: Float64, detector: Detector, rng: np.random.Generator
) -> LandmarkMap:
    """The map that a detector makes of them along a path of (V, 2) points."""
    mapper = LandmarkMapper()
    for x, y in path:
        T = pose_at(x, y, rng)
        mapper.add(detector.seen(stems, T, rng), T)
    return mapper.map()


def mirrored(prior_map: LandmarkMap) -> LandmarkMap:
    """The mirror image of a map: as likely a place, and none of its queries is in it."""
    flip = np.array([-1.0, 1.0, 1.0])
    return replace(prior_map, positions=prior_map.positions * flip, axes=prior_map.axes * flip)


def pose_at(x: float, y: float, rng: np.random.Generator, tilt_deg: float = 5.0) -> Pose:
    """T_map_sensor 1.5 m above the ground there, any heading, a little off level."""
    T = geometry.yaw_transform(rng.uniform(-math.pi, math.pi), (x, y, height(x, y) + 1.5))
    pitch, roll = rng.normal(0, math.radians(tilt_deg), 2)
    cp, sp, cr, sr = math.cos(pitch), math.sin(pitch), math.cos(roll), math.sin(roll)
    tilt = np.array([[cp, sp * sr, sp * cr], [0, cr, -sr], [-sp, cp * sr, cp * cr]])
    return T @ geometry.rigid(tilt, np.zeros(3))


def height(x: float, y: float) -> float:
    """Of the ground, metres."""
    return 2.0 * math.sin(x / 23.0) + 1.5 * math.cos(y / 31.0)


def _grown(where: Float64, rng: np.random.Generator) -> Landmarks:
    ground = np.array([height(x, y) for x, y in where])
    lean = rng.normal(0, LEAN_RAD, (len(where), 2))
    axes = np.column_stack([lean, np.ones(len(where))])
    diameters = np.clip(rng.lognormal(math.log(0.25), 0.4, len(where)), 0.06, 1.2)
    return Landmarks(np.column_stack([where, ground]), axes, diameters)
