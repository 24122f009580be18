"""Validation of a map's values; checksums only detect damage.

The same rules apply when a map is filled, written and read, so every saved map loads.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..system.checks import MAX_METRES, are_rotations
from ..types import Float32, Float64

Array = NDArray[Any]

MAX_CLOUD_M = 1e6
"""Maximum distance from the cloud's origin [m]; beyond, float32 is coarser than 6 cm."""

CLOUD_VOXELS_M = (1e-3, 1e3)
MAX_VOXELS = 1 << 21
"""Per axis of the cloud: three indices pack into 63 bits."""

MAX_DIM = 1 << 20
_LARGEST = float(np.finfo(np.float64).max)
_MAX_TEXT = 1000  # characters of a name

RANGES: dict[str, tuple[float, float]] = {
    "origin": (-MAX_METRES, MAX_METRES),
    "centroids": (-MAX_METRES, MAX_METRES),
    "stamps": (-_LARGEST, _LARGEST),
    "trajectory": (-MAX_METRES, MAX_METRES),
    "vectors": (-1e15, 1e15),  # squares of distances stay finite
    "quality": (0, 1),
    "cloud": (-MAX_CLOUD_M, MAX_CLOUD_M),
    "sizes": (0, 2**31 - 1),
    "missed": (0, 2**30),
}
"""Values outside their range or not finite are rejected. Session numbers are unlimited."""


Extremes = tuple[float, float]


def _extremes(array: Array) -> Extremes:
    """Return the minimum and maximum; NaN if a number is NaN."""
    with np.errstate(invalid="ignore"):
        return float(array.min()), float(array.max())


def arrays_fault(arrays: Mapping[str, Array], cloud_voxel: float) -> str | None:
    """Return the fault of a map's arrays, with field and row; None if valid."""
    cloud = arrays["cloud"]
    extremes = _extremes(cloud) if cloud.size else (0.0, 0.0)
    for name, array in arrays.items():
        if fault := column_fault(name, array, extremes if name == "cloud" else None):
            return fault
    if extremes[1] - extremes[0] <= cloud_voxel * MAX_VOXELS:
        return None  # no need to measure the span of each axis
    return _span_fault(cloud, cloud_voxel)


def column_fault(name: str, array: Array, extremes: Extremes | None = None) -> str | None:
    """Return the fault of one array, with its first invalid row; None if valid."""
    if name not in RANGES or not array.size:
        return None
    low, high = RANGES[name]
    lowest, highest = extremes or _extremes(array)
    if not (low <= lowest and highest <= high):
        return _outside(name, array)
    return _pose_fault(array) if name == "trajectory" else None


def texts_fault(descriptor: Any, fingerprint: Any, metadata: Mapping[Any, Any]) -> str | None:
    """Return the fault of a map's texts; None if valid."""
    for name, text in (("descriptor", descriptor), ("fingerprint", fingerprint)):
        if not (isinstance(text, str) and len(text) <= _MAX_TEXT and text.isprintable()):
            return f"{name}: not a line of text"
    for key, text in metadata.items():
        if not (_is_text(key) and _is_text(text)):
            return f"metadata: {str(key)[:40]!r} is not text"
    return None


def voxel_fault(cloud_voxel: float) -> str | None:
    """Return the fault of a cloud's voxel size; None if valid."""
    low, high = CLOUD_VOXELS_M
    if low <= cloud_voxel <= high:
        return None
    return f"cloud_voxel must be from {low:g} to {high:g} m, not {cloud_voxel:g}"


def relative_fault(points: Float32) -> str | None:
    """Return the fault of points relative to a cloud's origin; None if valid."""
    if not (fault := column_fault("cloud", points)):
        return None
    if not np.isfinite(points).all():
        return "the cloud has points that are not finite"
    return f"{fault} m from its origin"


def _is_text(value: Any) -> bool:
    try:
        return isinstance(value, str) and value.encode() is not None
    except UnicodeEncodeError:  # half of a surrogate pair
        return False


def _outside(name: str, array: Array) -> str:
    low, high = RANGES[name]
    flat = array.reshape(len(array), -1)
    bad = ~((flat >= low) & (flat <= high))
    row = int(np.argmax(bad.any(axis=1)))
    value = float(flat[row][np.argmax(bad[row])])
    what = f"outside {low:g} to {high:g}" if np.isfinite(value) else "not finite"
    return f"{name}: row {row} has {value:g}: {what}"


def _pose_fault(poses: Float64) -> str | None:
    R = poses[:, :3, :3]
    skewed = ~are_rotations(R)
    skewed |= np.abs(poses[:, 3] - [0, 0, 0, 1]).max(axis=1) > 1e-9
    return f"trajectory: row {int(np.argmax(skewed))} is not a rigid pose" if skewed.any() else None


def _span_fault(cloud: Float32, voxel: float) -> str | None:
    span = float(np.ptp(cloud, axis=0).max())
    if span <= voxel * MAX_VOXELS:
        return None
    return f"cloud: span of {span:g} m exceeds {MAX_VOXELS} voxels of {voxel:g} m"
