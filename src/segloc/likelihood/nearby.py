"""Poses around a candidate at which the clouds fit similarly.

Corridors and rows of pillars repeat every few metres, and halls are similar from the other end.
Clouds separate such places better than segments.
"""

from __future__ import annotations

import math

import numpy as np

from .. import _native, geometry
from ..geometry import Separation
from ..types import Float32, Pose

_RISE_M, _STOREYS_M, _STOREYS_SAMPLE = 0.4, 10.0, 1000
"""Step of the search for storeys, radius of the map points that bound it, and their number."""
_STOREY_FITS = 0.8
"""Least relative fit of a rival on another storey."""
_BESIDE_M, _STEP_M, _RANGE_M, MOST_BESIDE = 15.0, 0.5, 30.0, 4
"""Largest shift along x and y, step of the shifts, range of the compared points, most rivals."""
_TURNS_DEG = (0.0, 90.0, 180.0, 270.0)
"""Turns at which built places are similar."""


class NearbySearch:
    """Compares the clouds at shifted and rotated poses of a candidate.

    Parameters
    ----------
    index : PointIndex
        Index of the map's cloud.
    separation : Separation
        Separation of distinct places.
    """

    def __init__(self, index: _native.PointIndex, separation: Separation) -> None:
        self._index, self._separation = index, separation
        self._headings = [math.radians(d) for d in _TURNS_DEG]

    def around(self, points: Float32, T: Pose) -> list[Pose]:
        """Return the best poses at other places around T.

        T is the transform of (N, 3) points to the map's cloud.
        """
        counts, used = self._index.correlate(
            points, T, self._headings, _STEP_M, _BESIDE_M, _RANGE_M
        )
        share = counts / np.maximum(4.0 * used, 1.0)[:, None, None]
        shifts = (np.arange(share.shape[1]) - share.shape[1] // 2) * _STEP_M
        h, i, j = 0, len(shifts) // 2, len(shifts) // 2  # the pose itself
        found: list[Pose] = []
        while True:
            close = np.hypot(shifts[:, None] - shifts[i], shifts - shifts[j])
            share[h, close < self._separation.metres] = -1.0
            h, i, j = (int(k) for k in np.unravel_index(int(share.argmax()), share.shape))
            if len(found) == MOST_BESIDE or share[h, i, j] <= 0.0:
                return found
            moved = T @ geometry.yaw_transform(self._headings[h])
            moved[:2, 3] += shifts[j], shifts[i]
            found.append(moved)

    def storeys(self, points: Float32, T: Pose, radius: float) -> list[Pose]:
        """Return poses above and below T at which the clouds fit nearly as well.

        Parameters
        ----------
        points : (N, 3) float32
        T : (4, 4) float64
            Transforms them to the frame of the map's cloud.
        radius : float
            Largest distance of a fitting point from the map [m].
        """
        x, y, z = (float(v) for v in T[:3, 3])
        near = self._index.sample(x, y, _STOREYS_M, _STOREYS_SAMPLE)
        if not len(near) or np.ptp(near[:, 2]) < self._separation.height:
            return []
        steps = np.arange(near[:, 2].min() - z, near[:, 2].max() - z, _RISE_M)
        poses = np.repeat(T[None], len(steps) + 1, axis=0)
        poses[1:, 2, 3] += steps
        share = self._index.overlap(points, poses, radius)
        here, share = share[0], np.where(np.abs(steps) > self._separation.height, share[1:], 0.0)
        found = []
        while len(share) and share.max() > 0.0 and share.max() >= _STOREY_FITS * here:
            best = int(share.argmax())
            found.append(poses[best + 1])
            share[np.abs(steps - steps[best]) < self._separation.height] = 0.0
        return found
