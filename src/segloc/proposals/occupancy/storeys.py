"""A map of several storeys, storey by storey: seen from above they would lie on each other."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from ...types import Float32, Float64
from .ground import cells_of, nearest_of

_CELL_M = 4.0  # where the path passes twice through one of these,
_HIGHER_M = 2.0  # so much higher,
_SHARE = 0.2  # in so many of all that it passes through, there are storeys
_LEVEL_M = 1.0  # a path on one storey keeps within so much,
_FEWEST = 0.05  # and is so long a part of the whole
_UNDER_M, _STEP_M, _DEEP = 1.2, 0.1, 40  # where its floor is looked for: so near, so many steps
_BELOW_M = 0.1  # what lies so far below a floor belongs to it


def storeys(cloud: Float32, path: Float64) -> Iterator[tuple[Float32, Float64]]:
    """The cloud and the path of each storey; as they are where the path is on one level.

    Parameters
    ----------
    cloud : (N, 3) float32
    path : (V, 3) float64
        Along which the cloud was recorded, in the same frame.
    """
    levels = _levels(path[:, 2]) if len(cloud) and is_storeyed(path) else np.empty(0)
    if len(levels) < 2:
        yield cloud, path
        return
    nearest = np.abs(path[:, 2, None] - levels).argmin(axis=1)
    paths = [path[nearest == k] for k in range(len(levels))]
    edges = [
        level - _drop(cloud, part) - _BELOW_M for level, part in zip(levels, paths, strict=True)
    ]
    for low, high, part in zip(edges, [*edges[1:], np.inf], paths, strict=True):
        inside = (cloud[:, 2] > low) & (cloud[:, 2] < high)
        yield np.ascontiguousarray(cloud[inside]), part


def _drop(cloud: Float32, path: Float64) -> float:
    """How far below a path its floor is: the first flat thing there, above the ceiling below."""
    gap, station = nearest_of(path[:, :2], cloud[:, :2])
    drop = (path[station, 2] - cloud[:, 2])[gap < _UNDER_M]
    counts, edges = np.histogram(drop, bins=_DEEP, range=(0.0, _STEP_M * _DEEP))
    return float(edges[np.argmax(counts >= 0.5 * counts.max()) + 1])


def is_storeyed(path: Float64) -> bool:
    """Whether a path comes back well above itself, not just here and there as at a bridge.

    Parameters
    ----------
    path : (V, 3) float64
    """
    if not len(path) or np.ptp(path[:, 2]) < _HIGHER_M:
        return False
    _, which = np.unique(cells_of(path[:, :2], _CELL_M), axis=0, return_inverse=True)
    which = which.reshape(-1)
    low, high = np.full(which.max() + 1, np.inf), np.full(which.max() + 1, -np.inf)
    np.minimum.at(low, which, path[:, 2])
    np.maximum.at(high, which, path[:, 2])
    return bool((high - low > _HIGHER_M).mean() >= _SHARE)


def _levels(heights: NDArray[np.float64]) -> Float64:
    """Heights at which much of the path is, rising."""
    left, levels = np.sort(heights), list[float]()
    fewest = max(1.0, _FEWEST * len(heights))
    while len(left):
        ends = np.searchsorted(left, left + _LEVEL_M, side="right")
        counts = ends - np.arange(len(left))
        first = int(counts.argmax())
        if counts[first] < fewest:
            break
        level = float(np.median(left[first : ends[first]]))
        levels.append(level)
        left = left[np.abs(left - level) >= _HIGHER_M]
    return np.sort(np.array(levels))
