"""Detection of points out of a sensor's range: wrong unit, wrong frame, or no points."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..types import Float32, Scan

BEYOND_M = 400.0
"""Median range above which the unit is wrong: beyond the range of any LiDAR."""
_MAX_BLOB_DEG, _MIN_NEAR_TO_FAR = 20.0, 0.4  # of a small, far blob, seen from the origin
_MAX_STRAY = 0.01  # share of points near the sensor by chance or as invalid returns


def median_range(points: Float32) -> float:
    """Return the median distance of (N, 3) points from the origin [m]; 0 without points."""
    return float(np.median(np.linalg.norm(points, axis=1))) if len(points) else 0.0


def is_far_blob(points: Float32) -> bool:
    """Return whether all points lie in a small blob far from the origin."""
    cloud = points.astype(np.float64)
    ranges = np.linalg.norm(cloud, axis=1)
    near, far = np.percentile(ranges, [5, 95])
    if near < _MIN_NEAR_TO_FAR * far:
        return False
    directions = cloud / np.maximum(ranges, 1e-9)[:, None]
    middle = directions.mean(axis=0)
    middle /= max(float(np.linalg.norm(middle)), 1e-9)
    return bool(np.percentile(directions @ middle, 10) > np.cos(np.radians(_MAX_BLOB_DEG)))


def reach_fault(scans: Sequence[Scan], near: int, radius_m: float) -> str:
    """Explain why few points, ``near``, lie within a radius of their sensor; "" if enough do."""
    if near > _MAX_STRAY * sum(len(scan.points) for scan in scans):
        return ""
    points = np.concatenate([scan.points for scan in scans])
    dropped = sum(scan.dropped for scan in scans)
    if not len(points):
        return f"all {dropped} points are NaN or infinite" if dropped else "the scan is empty"
    lie = "lies" if near < 2 else "lie"
    found = f"{near or 'none'} of {len(points)} points {lie} within {radius_m:g} m of the sensor"
    middle = median_range(points)
    if is_far_blob(points):
        return (
            f"{found}; all lie to one side, {middle:.0f} m off: are they in world coordinates? "
            "Transform them by T_world_sensor^-1"
        )
    if middle > BEYOND_M:
        unit = "are they in millimetres (divide by 1000) or centimetres (by 100)?"
        return f"{found}; half are beyond {middle:.0f} m: {unit}"
    return f"{found}; half are beyond {middle:.0f} m"
