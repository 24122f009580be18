"""Points that cannot lie around a sensor: in another unit, in another frame, or none at all."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..types import Float32, Scan

BEYOND_M = 400.0
"""Half of the points are farther than any LiDAR's range: they are in another unit."""
_SLIM_DEG, _THICK = 20.0, 0.4  # seen from the origin: a small, far blob
_FEW = 0.01  # of the points are near the sensor, by chance or as invalid returns


def median_range(points: Float32) -> float:
    """Median distance of (N, 3) points from the origin [m]; 0 of none."""
    return float(np.median(np.linalg.norm(points, axis=1))) if len(points) else 0.0


def is_far_blob(points: Float32) -> bool:
    """Whether points are seen from the origin as something small and far away."""
    cloud = points.astype(np.float64)
    ranges = np.linalg.norm(cloud, axis=1)
    near, far = np.percentile(ranges, [5, 95])
    if near < _THICK * far:
        return False
    directions = cloud / np.maximum(ranges, 1e-9)[:, None]
    middle = directions.mean(axis=0)
    middle /= max(float(np.linalg.norm(middle)), 1e-9)
    return bool(np.percentile(directions @ middle, 10) > np.cos(np.radians(_SLIM_DEG)))


def reach_fault(scans: Sequence[Scan], radius_m: float) -> str:
    """Why hardly a point of some scans lies within a radius of its sensor; "" if enough do."""
    points = np.concatenate([scan.points for scan in scans])
    dropped = sum(scan.dropped for scan in scans)
    if not len(points):
        return f"all {dropped} points are NaN or infinite" if dropped else "the scan is empty"
    near = int(np.count_nonzero(np.hypot(points[:, 0], points[:, 1]) < radius_m))
    if near > _FEW * len(points):
        return ""
    lie = "lies" if near < 2 else "lie"
    found = f"{near or 'none'} of {len(points)} points {lie} within {radius_m:g} m of the sensor"
    middle = median_range(points)
    if is_far_blob(points):
        return (
            f"{found}; all lie to one side, {middle:.0f} m off: are they in world coordinates? "
            "Take them back by T_world_sensor^-1"
        )
    if middle > BEYOND_M:
        said = "are they in millimetres (divide by 1000) or centimetres (by 100)?"
        return f"{found}; half are beyond {middle:.0f} m: {said}"
    return f"{found}; half are beyond {middle:.0f} m"
