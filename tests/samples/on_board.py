"""A robot that its own sensor sees: a mast behind it, in every scan."""

from __future__ import annotations

from typing import TypeVar

import numpy as np

from segloc import Scan
from segloc.types import Float32, Float64

Points = TypeVar("Points", Float32, Float64)

LOW, HIGH = (-0.6, -0.3, -0.9), (-0.3, 0.3, 0.2)
"""Corners of the mast in the sensor's frame [m]."""
BODY = ((-0.7, -0.4, -1.0), (-0.2, 0.4, 0.3))
"""A box around it."""


def beside(points: Points) -> Points:
    """Leave out what a walk across a plaza passes at less than 1.3 m."""
    return points[np.abs(points).max(axis=1) > 1.3]


def with_mast(points: Float64 | Float32, seed: int = 0, count: int = 1500) -> Float32:
    """Add points of the mast to those of a scan (N, 3)."""
    mast = np.random.default_rng(seed).uniform(LOW, HIGH, (count, 3))
    return np.concatenate([points, mast]).astype(np.float32)


def masted(scan: Scan, seed: int = 0) -> Scan:
    """Add points of the mast to a scan."""
    points = with_mast(scan.points, seed)
    return Scan(points, stamp=scan.stamp, T_odom_sensor=scan.T_odom_sensor)
