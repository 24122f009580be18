"""The horizontal field of view of a sensor, estimated from its scans."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from .. import geometry
from ..errors import DatasetError
from ..types import Float32, Recording
from .local_cloud import Accumulator, LocalCloudConfig

FULL_TURN_DEG = 360.0
NARROW_DEG = 180.0
"""Sensors that see less of a turn than this are narrow: opposite headings share no view."""

_SAMPLE = 5  # scans of a recording
_MIN_POINTS = 200  # of a scan that is measured
_BIN_DEG = 5.0
_MIN_FILL = 0.02  # points of an occupied bin, as a share of the mean over the whole turn
_STEEPEST = 1.7  # rise over run, 60 degrees; steeper points have no clear heading


def is_narrow(recordings: Iterable[Recording], config: LocalCloudConfig) -> bool:
    """Whether every recording was taken by a sensor with a narrow field of view."""
    views = [field_of_view_deg(recording, config) for recording in recordings]
    return bool(views) and max(views) < NARROW_DEG


def field_of_view_deg(recording: Recording, config: LocalCloudConfig) -> float:
    """Estimate the horizontal field of view [deg] by the widest of a few scans.

    It is a full turn where the scans cannot be measured: few points, or points in one plane.
    """
    level, views = Accumulator(config).level, []
    for i in geometry.spread(len(recording), _SAMPLE):
        try:
            scan = recording.scan(int(i))
        except DatasetError:
            continue
        if len(scan) >= _MIN_POINTS and not geometry.in_one_plane(scan.points):
            base = np.asarray(scan.points @ geometry.upright(level(scan))[:3, :3].T, np.float32)
            views.append(_occupied_deg(base))
    return max(views, default=FULL_TURN_DEG)


def _occupied_deg(points: Float32) -> float:
    """The part of the turn about z in which points lie [deg]."""
    x, y, z = points.T
    aside = np.abs(z) < _STEEPEST * np.hypot(x, y)
    bins = int(360 / _BIN_DEG)
    headings = np.degrees(np.arctan2(y[aside], x[aside]))
    counts, _ = np.histogram(headings, bins=bins, range=(-180.0, 180.0))
    if not counts.any():
        return FULL_TURN_DEG
    return float(_BIN_DEG * (counts > _MIN_FILL * counts.mean()).sum())
