"""What the benchmarks run on, made from a seed: segments, clouds, matches, descriptors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from segloc import geometry
from segloc.types import Float32, Float64, Int64, Pose, Scan

SENSOR_HEIGHT_M = 1.8


def segments(count: int, points: int = 256, seed: int = 0) -> Float32:
    """Shells of boxes of the sizes of street furniture, cars and walls, (count, points, 3)."""
    rng = np.random.default_rng(seed)
    half = rng.uniform([0.2, 0.2, 0.5], [4.0, 1.0, 2.0], (count, 1, 3))
    shell = rng.uniform(-1, 1, (count, points, 3))
    face = rng.integers(0, 3, (count, points, 1))
    np.put_along_axis(shell, face, np.sign(np.take_along_axis(shell, face, 2)), 2)
    noisy = shell * half + rng.normal(0, 0.02, shell.shape)
    return noisy.astype(np.float32)


def descriptors(count: int, dim: int = 16, seed: int = 0, spread: float = 1.0) -> Float32:
    """Normally distributed vectors, (count, dim)."""
    rng = np.random.default_rng(seed)
    return rng.normal(0, spread, (count, dim)).astype(np.float32)


class Plaza:
    """Boxes of random sizes on uneven ground, dense with points: a scene that needs no simulator.

    Attributes
    ----------
    points : (N, 3) float64
        World frame, metres; the plaza's middle is the origin.
    """

    def __init__(self, seed: int = 0, objects: int = 300, size_m: float = 200.0) -> None:
        rng = np.random.default_rng([seed, 77])
        ground = rng.uniform(-size_m / 2, size_m / 2, (int(size_m**2), 3))
        ground[:, 2] = 0.2 * np.sin(ground[:, 0] / 6) + rng.normal(0, 0.02, len(ground))
        parts = [ground]
        for x, y in rng.uniform(-size_m / 2, size_m / 2, (objects, 2)):
            half = rng.uniform([0.3, 0.3, 0.8], [4.0, 1.0, 2.5])
            shell = segments(1, 700, int(rng.integers(1 << 31)))[0]
            shell *= half / np.abs(shell).max(axis=0)
            turn = geometry.yaw_transform(rng.uniform(0, np.pi), (x, y, half[2]))
            parts.append(geometry.transform(turn, shell))
        self.points: Float64 = np.vstack(parts)

    def scan(self, T_world_sensor: Pose, radius_m: float = 50.0, seed: int = 0) -> Scan:
        """Every point within the radius, with 2 cm of noise; posed."""
        points = geometry.transform(geometry.inverse(T_world_sensor), self.points)
        points = points[np.hypot(points[:, 0], points[:, 1]) < radius_m]
        points += np.random.default_rng(seed).normal(0, 0.02, points.shape)
        return Scan(points, stamp=float(seed), T_odom_sensor=T_world_sensor)


class PlazaWalk:
    """A walk across a plaza; a recording."""

    name = "plaza"

    def __init__(self, plaza: Plaza, steps: int = 12) -> None:
        self._plaza = plaza
        self.indices: Int64 = np.arange(steps, dtype=np.int64)
        self.stamps: Float64 | None = None
        path = [(-20.0 + 4 * k, 0.5 * k, SENSOR_HEIGHT_M) for k in range(steps)]
        self.poses: Float64 = np.stack(
            [geometry.yaw_transform(0.05 * k, t) for k, t in enumerate(path)]
        )

    def __len__(self) -> int:
        return len(self.indices)

    def scan(self, i: int) -> Scan:
        """The scan at position i."""
        return self._plaza.scan(self.poses[i], seed=i)


def local_cloud(points: int = 45_000, seed: int = 0) -> Float32:
    """What stands within 50 m on a plaza, voxelised at 0.2 m, at most so many points, (N, 3)."""
    rng = np.random.default_rng([seed, 78])
    shells = segments(100, 900, seed).astype(np.float64) * [1.0, 2.0, 1.0]
    places = rng.uniform(-50, 50, (len(shells), 1, 3)) * [1, 1, 0] + [0, 0, 2.0]
    cloud = (shells + places).reshape(-1, 3)
    _, first = np.unique(np.floor(cloud / 0.2).astype(np.int64), axis=0, return_index=True)
    return np.ascontiguousarray(cloud[np.sort(first)[:points]], dtype=np.float32)


@dataclass(frozen=True)
class MatchProblem:
    """Centroid matches of which few are true.

    Attributes
    ----------
    query : (P, 3) float64
    mapped : (M, 3) float64
    match_query, match_map : (N,) int64
        Best match first.
    T_map_local : (4, 4) float64
        The truth.
    """

    query: Float64
    mapped: Float64
    match_query: Int64
    match_map: Int64
    T_map_local: Pose

    def found(self, poses: Float64, metres: float = 1.0, degrees: float = 3.0) -> bool:
        """Whether the first of the poses is the true one."""
        if len(poses) == 0:
            return False
        delta = geometry.inverse(self.T_map_local) @ poses[0]
        turned = np.degrees(geometry.rotation_angle(delta))
        return bool(np.linalg.norm(delta[:3, 3]) < metres and turned < degrees)


def match_problem(
    *,
    inliers: float = 0.01,
    informative: bool = True,
    queries: int = 300,
    neighbours: int = 25,
    mapped: int = 50_000,
    seed: int = 0,
) -> MatchProblem:
    """Matches of a query cloud with a map of 1 km by 1 km.

    Parameters
    ----------
    inliers : float
        Share of the matches that are true; at most one a query.
    informative : bool
        Whether true matches tend to stand before false ones.
    """
    rng = np.random.default_rng([seed, 79])
    query = np.column_stack([rng.uniform(-50, 50, (queries, 2)), rng.uniform(0.5, 4, queries)])
    place = np.column_stack([rng.uniform(-500, 500, (mapped, 2)), rng.uniform(0.5, 4, mapped)])
    T = geometry.yaw_transform(rng.uniform(-np.pi, np.pi), (*rng.uniform(-400, 400, 2), 0.3))
    count = queries * neighbours
    match_query = np.repeat(np.arange(queries), neighbours)
    match_map = rng.integers(0, mapped, count)
    true = rng.choice(queries, min(round(inliers * count), queries), replace=False)
    place[true] = geometry.transform(T, query[true]) + rng.normal(0, 0.15, (len(true), 3))
    at = true * neighbours
    match_map[at] = true
    score = rng.normal(0, 1, count)
    if informative:
        score[at] += 1.5
    order = np.argsort(-score)
    return MatchProblem(query, place, match_query[order], match_map[order], T)
