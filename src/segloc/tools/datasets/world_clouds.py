"""Recognise clouds in a world's frame: they stand still although the sensor moves."""

from __future__ import annotations

import numpy as np

from ... import _native, geometry
from ...errors import SeglocError
from ...types import Float32, Float64, Pose
from .recorded import Found
from .tracks import Track

_APART_M = (2.0, 10.0)  # distance of the sensor between two compared clouds
_PAIRS = 5
_VOXEL_M, _NEAR_M, _SAMPLE, _MIN_POINTS = 0.3, 0.4, 1500, 100
_YAWS = np.linspace(0.0, 2.0 * np.pi, 16, endpoint=False)  # the sensor's mount may be unknown
_MIN_SHARE, _MIN_GAIN = 0.2, 0.08  # of points that agree as they are, and more than moved


def stand_still(found: Found, body: Track) -> bool:
    """Return whether clouds agree as they are, and less if moved as the sensor moved.

    body: of anything that the sensor is fixed to, in any frame
    """
    if found.stamps is None:
        return False
    poses = body.at(found.indices, found.stamps)
    known = np.flatnonzero(np.isfinite(poses[:, 0, 0]))
    shares = []
    for first, second in _pairs(poses[known, :3, 3]):
        i, j = int(known[first]), int(known[second])
        try:
            target, source = _thin(found.source.read(i).points), found.source.read(j).points
        except SeglocError:
            continue  # reported when the scan is read
        source = _thin(source)
        if min(len(target), len(source)) >= _MIN_POINTS:
            shares.append(_shares(target, source, geometry.inverse(poses[i]) @ poses[j]))
    if not shares:
        return False
    still, moved = np.median(shares, axis=0)
    return bool(still > _MIN_SHARE and still > moved + _MIN_GAIN)


def _pairs(positions: Float64) -> list[tuple[int, int]]:
    """Pair positions a little apart, spread along the path."""
    pairs = []
    for first in geometry.spread(len(positions), 4 * _PAIRS):
        off = np.linalg.norm(positions[first + 1 :] - positions[first], axis=1)
        near = np.flatnonzero((off > _APART_M[0]) & (off < _APART_M[1]))
        pairs += [(int(first), int(first) + 1 + int(near[0]))] if len(near) else []
    return [pairs[k] for k in geometry.spread(len(pairs), _PAIRS)]


def _thin(points: Float32) -> Float32:
    return _native.voxel_grid(np.ascontiguousarray(points), _VOXEL_M)


def _shares(target: Float32, source: Float32, T: Pose) -> Float64:
    """Return the shares of points that agree as they are, and moved by T at the best mount."""
    index = _native.PointIndex(target, _NEAR_M)
    sample = source[:: 1 + len(source) // _SAMPLE].copy()
    mounts = [geometry.yaw_transform(yaw, (0.0, 0.0, 0.0)) for yaw in _YAWS]
    moved = [geometry.inverse(mount) @ T @ mount for mount in mounts]
    shares = index.overlap(sample, np.stack([np.eye(4), *moved]), _NEAR_M)
    return np.array([shares[0], shares[1:].max()])
