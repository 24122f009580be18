"""A small scene that needs nothing."""

from __future__ import annotations

import copy

import numpy as np

from segloc import geometry
from segloc.types import Float64, Scan


class Plaza:
    """A square with boxes of random sizes on uneven ground: enough structure to localize in."""

    def __init__(self, seed: int, objects: int = 60, size: float = 100.0) -> None:
        rng = np.random.default_rng(seed)
        xy = rng.uniform(-size / 2, size / 2, (40_000, 2))
        self.parts = [
            np.column_stack([xy, 0.2 * np.sin(xy[:, 0] / 6) + rng.normal(0, 0.02, 40_000)])
        ]
        for x, y in rng.uniform(-size / 2, size / 2, (objects, 2)):
            half = rng.uniform([0.3, 0.3, 0.8], [3.0, 1.0, 2.5])
            shell = rng.uniform(-1, 1, (1500, 3))
            face = rng.integers(0, 3, 1500)
            shell[np.arange(1500), face] = np.sign(shell[np.arange(1500), face])
            turn = geometry.yaw_transform(rng.uniform(0, np.pi), (x, y, half[2]))
            self.parts.append(geometry.transform(turn, shell * half))
        self.points: Float64 = np.vstack(self.parts)

    def thinned(self, every: int) -> Plaza:
        """A copy that keeps one point in ``every``."""
        return self._with(self.points[::every])

    def cropped(self, radius_m: float) -> Plaza:
        """A copy without the points beyond a distance from the middle."""
        return self._with(self.points[np.hypot(*self.points[:, :2].T) < radius_m])

    def _with(self, points: Float64) -> Plaza:
        made = copy.copy(self)
        made.points = points
        return made

    def scan(self, T_world_sensor: Float64, *, posed: bool = True, seed: int = 0) -> Scan:
        """Every point within 45 m of the sensor, with 1 cm of noise."""
        points = geometry.transform(geometry.inverse(T_world_sensor), self.points)
        points = points[np.linalg.norm(points[:, :2], axis=1) < 45]
        points += np.random.default_rng(seed).normal(0, 0.01, points.shape)
        return Scan(points, stamp=float(seed), T_odom_sensor=T_world_sensor if posed else None)


class PlazaSequence:
    """A walk across a plaza; a ``Sequence``."""

    name = "plaza"

    def __init__(self, plaza: Plaza, steps: int = 15, posed: bool = True) -> None:
        self._plaza = plaza
        self.indices = np.arange(steps, dtype=np.int64)
        self.stamps = self.indices.astype(np.float64)
        way = [(-14.0 + 2 * k, 0.3 * k, 1.8) for k in range(steps)]
        self.poses = np.stack([geometry.yaw_transform(0.1 * k, t) for k, t in enumerate(way)])
        self._posed = posed

    def __len__(self) -> int:
        return len(self.indices)

    def scan(self, i: int) -> Scan:
        return self._plaza.scan(self.poses[i], posed=self._posed, seed=i)

    def select(self, selection: object) -> PlazaSequence:
        raise NotImplementedError


class RingSequence(PlazaSequence):
    """A drive around a plaza on a circle, ``aside`` metres outside of it."""

    def __init__(self, plaza: Plaza, radius: float, length: float, step: float, aside: float = 0.0):
        angles = np.arange(0.0, length, step) / radius
        super().__init__(plaza, len(angles))
        at = (radius + aside) * np.column_stack([np.cos(angles), np.sin(angles)])
        self.poses = np.stack(
            [
                geometry.yaw_transform(angle + np.pi / 2, (x, y, 1.8))
                for angle, (x, y) in zip(angles, at, strict=True)
            ]
        )
