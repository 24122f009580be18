"""Views that fix no place: a wall, a wall and its floor, a piece of corridor, a corner, a floor.

Sizes, distances and heights of the sensor differ from view to view.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from segloc import geometry
from segloc.types import Float32, Float64

POINTS_PER_M2 = 150.0
NOISE_M = 0.01
Random = np.random.Generator


def wall(rng: Random, distance: float, width: float, height: float, floor: float) -> Float64:
    """A wall across the x axis, standing on a floor at z = ``floor``."""
    count = int(POINTS_PER_M2 * width * height)
    y, z = rng.uniform(-width / 2, width / 2, count), rng.uniform(0.0, height, count) + floor
    return np.asarray(np.column_stack([np.full(count, distance), y, z]))


def ground(rng: Random, radius: float, floor: float) -> Float64:
    """A level floor around the sensor."""
    xy = rng.uniform(-radius, radius, (int(POINTS_PER_M2 * radius**2), 2))
    return np.column_stack([xy, np.full(len(xy), floor)])


def turned(points: Float64, degrees: float) -> Float64:
    """Turn points about the vertical."""
    T = geometry.yaw_transform(np.radians(degrees))
    return np.asarray(points @ T[:3, :3].T)


def bare_wall(rng: Random) -> Float64:
    """A wall of 7 to 10 m, 1 to 3 m away."""
    return wall(rng, rng.uniform(1, 3), rng.uniform(7, 10), rng.uniform(2, 3), -rng.uniform(0.5, 2))


def wall_and_floor(rng: Random) -> Float64:
    """A wall and the floor before it."""
    height, distance = rng.uniform(0.5, 2), rng.uniform(1, 3)
    floor = ground(rng, 5.0, -height)
    return np.concatenate(
        [
            wall(rng, distance, rng.uniform(7, 10), rng.uniform(2, 3), -height),
            floor[floor[:, 0] < distance],
        ]
    )


def corridor(rng: Random) -> Float64:
    """Two parallel walls and the floor between them."""
    height, width, length = rng.uniform(0.5, 2), rng.uniform(1.5, 3), rng.uniform(8, 20)
    side = wall(rng, width / 2, length, 2.5, -height)
    floor = ground(rng, length / 2, -height)
    return np.concatenate([side, turned(side, 180.0), floor[np.abs(floor[:, 0]) < width / 2]])


def corner(rng: Random) -> Float64:
    """Two walls that meet, and the floor."""
    height, (a, b) = rng.uniform(0.5, 2), rng.uniform(1, 4, 2)
    one, other = wall(rng, a, 10.0, 2.5, -height), turned(wall(rng, b, 10.0, 2.5, -height), 90.0)
    floor = ground(rng, 5.0, -height)
    points = np.concatenate([one, other, floor])
    inner = (points[:, 0] < a + 0.01) & (points[:, 1] < b + 0.01)
    return np.asarray(points[inner])


def bare_floor(rng: Random) -> Float64:
    """A floor alone."""
    return ground(rng, rng.uniform(3, 8), -rng.uniform(0.5, 2))


VIEWS: dict[str, Callable[[Random], Float64]] = {
    "wall": bare_wall,
    "wall and floor": wall_and_floor,
    "corridor": corridor,
    "corner": corner,
    "floor": bare_floor,
}


def view(name: str, seed: int) -> Float32:
    """Make a view, turned at random."""
    rng = np.random.default_rng([seed, list(VIEWS).index(name)])
    points = turned(VIEWS[name](rng), rng.uniform(0, 360))
    return (points + rng.normal(0, NOISE_M, points.shape)).astype(np.float32)
