"""The points of a scan that show a finding."""

from __future__ import annotations

import numpy as np

from ...frontend.local_cloud import LocalCloudConfig
from ...frontend.surfaces import Surfaces
from ...types import Bools, Scan
from .finding import Fault, Finding
from .scan_faults import level_points

_WHOLE = {
    Fault.MILLIMETRES,
    Fault.CENTIMETRES,
    Fault.WORLD_COORDINATES,
    Fault.SINGLE_PLANE,
    Fault.ONLY_GROUND,
}
"""Faults of all points of a scan."""
_ON_WRONG_SIDE = {Fault.CAMERA_AXES, Fault.Z_DOWN, Fault.GRAVITY, Fault.TILT}
"""Faults that are told by the side on which the ground lies."""
_THICK_M, _NEAR_M = 0.5, 25.0


def faulty_points(finding: Finding, scan: Scan, config: LocalCloudConfig) -> Bools:
    """Return which points of a scan show a finding, (N,); none of findings on poses or files.

    Parameters
    ----------
    finding : Finding
    scan : Scan
    config : LocalCloudConfig
        Mount of the sensor.
    """
    if finding.fault in _WHOLE:
        return np.ones(len(scan), dtype=bool)
    if finding.box is not None:
        low, high = finding.box
        return np.asarray(((scan.points >= low) & (scan.points <= high)).all(axis=1))
    if finding.wrong and finding.fault in _ON_WRONG_SIDE:
        return _largest_surface(scan, config)
    return np.zeros(len(scan), dtype=bool)


def _largest_surface(scan: Scan, config: LocalCloudConfig) -> Bools:
    """Return which points lie on the largest flat surface across an axis, as the ground does."""
    points = level_points(scan, config)
    surfaces = Surfaces.of(points)
    if surfaces is None:
        return np.zeros(len(scan), dtype=bool)
    shares, metres = surfaces.floors()
    axis, side = (int(k) for k in np.unravel_index(shares.argmax(), shares.shape))
    off = points[:, axis] * (1.0 if side else -1.0)
    near = np.linalg.norm(points, axis=1) < _NEAR_M
    return np.asarray(near & (np.abs(off - metres[axis, side]) < _THICK_M))
