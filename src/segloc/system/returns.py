"""Select the points of a scan that are measurements: finite, plausible, and not missing returns.

Drivers write missing returns as points on one fixed spot, or at one fixed range beyond all others.
They are found by structure. Range noise spreads the points of any real surface over more than the
tolerance used here. Simulated surfaces without noise at one exact range from the sensor are flat:
the ring that a beam draws on level ground, or the foot of a perpendicular on a wall.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .checks import MAX_METRES, Float32

RANGE_TOLERANCE_M = 1e-3
"""Half the width of "one range" [m]: the rounding of coordinates written with three decimals."""

MIN_SHARE = 0.05
"""Minimum share of fixed points in a scan to be taken for missing returns."""

_MIN_POINTS = 200  # of a scan
_SAMPLE = 2048  # points used to detect fixed ranges
_MAX_RANGES = 4  # fixed ranges examined per scan
_MAX_BEYOND = 0.01  # share of a scan that may lie beyond the range of missing returns
_MIN_THICKNESS = 0.02  # of points at that range about their plane, as a share of the range


def measured_points(points: Float32) -> tuple[NDArray[np.bool_] | None, int, int, int]:
    """Find the points (N, 3) of a scan that are measurements.

    Returns
    -------
    kept : (N,) bool or None
        None: all points.
    dropped : int
        Points with a coordinate that is not finite or beyond ``MAX_METRES``.
    blank : int
        Those of them with a NaN: missing returns of an organised cloud.
    missing : int
        Points that stand for missing returns.
    """
    if not len(points):
        return None, 0, 0, 0
    kept, dropped, blank = None, 0, 0
    if not np.abs(points).max() <= MAX_METRES:  # also for NaN
        kept = np.asarray((np.abs(points) <= MAX_METRES).all(axis=1))
        blank = int(np.isnan(points[~kept]).any(axis=1).sum())
        points, dropped = points[kept], int(len(kept) - kept.sum())
    if (missing := missing_returns(points)) is None:
        return kept, dropped, blank, 0
    if kept is None:
        kept = ~missing
    else:
        kept[kept] = ~missing
    return kept, dropped, blank, int(missing.sum())


def missing_returns(points: Float32) -> NDArray[np.bool_] | None:
    """Find the points (N, 3) that stand for missing returns.

    Returns
    -------
    (N,) bool, or None if there are none
        True for points on one spot, and for points at the largest range in directions that no
        plane explains, if they are at least ``MIN_SHARE`` of the scan.
    """
    if len(points) < _MIN_POINTS:
        return None
    step = (1 + len(points) // _SAMPLE) | 1  # odd: even steps hit few of a sensor's beams
    ranges = _dense_ranges(np.sort(_ranges(points[::step])))
    if not ranges:
        return None
    missing = np.zeros(len(points), dtype=np.bool_)
    reach = _ranges(points)
    for metres in ranges:
        there = np.flatnonzero(np.abs(reach - metres) <= RANGE_TOLERANCE_M)
        farthest = np.mean(reach > metres + RANGE_TOLERANCE_M) <= _MAX_BEYOND
        fixed = _at_fixed_range(points[there], metres, int(MIN_SHARE * len(points)), bool(farthest))
        missing[there[fixed]] = True
    return missing if missing.any() else None


def _ranges(points: Float32) -> NDArray[np.float64]:
    cloud = points.astype(np.float64)
    return np.asarray(np.sqrt(np.einsum("ij,ij->i", cloud, cloud)), dtype=np.float64)


def _dense_ranges(ascending: NDArray[np.float64]) -> list[float]:
    """Return ranges [m] with at least ``MIN_SHARE`` of the given ones within the tolerance."""
    count = max(2, int(MIN_SHARE * len(ascending)))
    width = 2 * RANGE_TOLERANCE_M
    dense = ascending[: 1 - count][ascending[count - 1 :] - ascending[: 1 - count] <= width]
    found: list[float] = []
    while len(dense) and len(found) < _MAX_RANGES:
        first, stop = np.searchsorted(ascending, [dense[0], dense[0] + width])
        found.append(float(ascending[first:stop].mean()))
        dense = dense[dense > dense[0] + width]
    return found


def _at_fixed_range(
    points: Float32, metres: float, fewest: int, farthest: bool
) -> NDArray[np.bool_]:
    """Return which points at one range are no surface: all, those on one spot, or none.

    All are if they are ``farthest``, almost nothing lies beyond them, and they are no ring.
    """
    if len(points) < fewest:
        return np.zeros(len(points), dtype=np.bool_)
    x, y, z = points.T
    few = points[:: 1 + len(points) // _SAMPLE] + np.float32(0)  # -0 becomes 0
    _, first, counts = np.unique(few.view("V12"), return_index=True, return_counts=True)
    spot = few[first[counts.argmax()]]
    on_spot: NDArray[np.bool_] = (x == spot[0]) & (y == spot[1]) & (z == spot[2])
    if on_spot.sum() < fewest:
        on_spot[:] = False
    rest = points[~on_spot] if farthest else points[:0]
    few_left = rest[:: (1 + len(rest) // _SAMPLE) | 1].astype(np.float64)
    if farthest and len(rest) >= fewest and _is_spread(few_left, metres):
        on_spot[:] = True
    return on_spot


def _is_spread(points: NDArray[np.float64], metres: float) -> bool:
    """Return whether points at one range lie on a sphere rather than on a plane."""
    middle = points.mean(axis=0)
    values, _ = np.linalg.eigh(np.cov((points - middle).T))
    thickness = float(np.sqrt(max(values[0], 0.0)))
    return thickness > _MIN_THICKNESS * metres
