"""What is kept of an answer: readable numbers, and digests of the exact bytes of arrays."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from .doors import Prior, Scan, SegmentMap

Record = dict[str, Any]
"""Fields of one case by name, in values that JSON holds exactly."""
Scans = Scan | list[Scan]


def digest(value: Any) -> str:
    """Digest of arrays, scans and plain values, nested in any way; other objects by their type."""
    hashed = hashlib.sha256()
    _feed(hashed, value)
    return hashed.hexdigest()[:16]


def _feed(hashed: Any, value: Any) -> None:
    if isinstance(value, np.ndarray):
        hashed.update(f"{value.dtype.str}{value.shape}".encode())
        hashed.update(np.ascontiguousarray(value).tobytes())
    elif isinstance(value, Scan):
        _feed(hashed, [value.points, value.times, value.stamp, value.T_odom_sensor])
    elif isinstance(value, dict):
        _feed(hashed, [part for item in value.items() for part in item])
    elif isinstance(value, (list, tuple)):
        hashed.update(f"{len(value)}".encode())
        for part in value:
            _feed(hashed, part)
    elif isinstance(value, (str, bytes, int, float, np.generic, type(None))):
        hashed.update(repr(value).encode())
    else:
        hashed.update(type(value).__name__.encode())


def pose(T: np.ndarray | None) -> list[float] | None:
    """x, y, z [m] and roll, pitch, yaw [deg], to be read and to be compared loosely."""
    if T is None:
        return None
    turn = Rotation.from_matrix(T[:3, :3]).as_euler("xyz", degrees=True)
    return [round(float(each), 4) for each in (*T[:3, 3], *turn)]


def exact(array: np.ndarray | None) -> str | None:
    """Digest of an array, where there is one."""
    return None if array is None else digest(array)


def of_pose(name: str, T: np.ndarray | None, covariance: np.ndarray | None) -> Record:
    """A pose, readable and exact, with its covariance."""
    return {"pose": pose(T), name: exact(T), "covariance": exact(covariance)}


def of_answer(found: Any) -> Record:
    """A localization; times are left out."""
    return {
        "localized": found.localized,
        "reason": None if found.reason is None else found.reason.name,
        **of_pose("T_map_sensor", found.T_map_sensor, found.covariance),
        "confidence": found.confidence,
        "inliers": found.inliers,
        "overlap": found.overlap,
        "seen": found.seen,
        "rmse": found.rmse,
        "places": [[exact(place.T_map_sensor), place.probability] for place in found.places],
        "counts": list(found.counts.values()),
        "attitude": found.attitude,
    }


def of_map(prior_map: SegmentMap) -> Record:
    """The contents of a map; its texts aside."""
    return {
        "segments": len(prior_map),
        "vectors": exact(prior_map.vectors),
        "quality": exact(prior_map.quality),
        "centroids": exact(prior_map.centroids),
        "sizes": exact(prior_map.sizes),
        "cloud": digest([prior_map.cloud, prior_map.origin, prior_map.cloud_voxel]),
        "trajectory": exact(prior_map.trajectory),
    }


@dataclass(frozen=True)
class Query:
    """What is localized: a scan, or several with odometry, perhaps near a place."""

    name: str
    scans: Scans
    near: Prior | None = None


def localized(
    localizer: Any, queries: Iterable[Query], inputs: str
) -> Iterable[tuple[str, Record]]:
    """The answer to each query; ``inputs`` is the digest of what the map is made of."""
    for query in queries:
        scans = query.scans if isinstance(query.scans, list) else [query.scans]
        found = localizer.localize(query.scans, near=query.near)
        yield query.name, {"inputs": digest([inputs, scans]), **of_answer(found)}
