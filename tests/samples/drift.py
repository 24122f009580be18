"""Odometry that drifts by 1 %, and how far sessions that were aligned are off."""

from __future__ import annotations

import numpy as np
from segloc_lab.simulation import OdometryNoise

from segloc import geometry
from segloc.types import Float64, Recording, Reposed

DRIFT = OdometryNoise(drift_m=0.03, drift_deg=0.04, scale=0.01)


def drifted(recording: Recording, truth: Float64, seed: int) -> Reposed:
    """The recording with such odometry, in a frame of its own."""
    rng = np.random.default_rng(seed)
    shift = rng.uniform(-300, 300, 3)
    frame = geometry.yaw_transform(float(rng.uniform(-3, 3)), tuple(shift.tolist()))
    return Reposed(recording, frame @ DRIFT.odometry(truth, rng))


def errors_across(
    a: Float64, b: Float64, true_a: Float64, true_b: Float64, reach_m: float = 6.0
) -> Float64:
    """Errors of poses of b [m], seen from the nearest pose of a, where that is within reach."""
    errors = []
    for found, truth in zip(b, true_b, strict=True):
        apart = np.linalg.norm(true_a[:, :3, 3] - truth[:3, 3], axis=1)
        i = int(apart.argmin())
        if apart[i] < reach_m:
            expected = geometry.inverse(true_a[i]) @ truth
            errors.append(np.linalg.norm((geometry.inverse(a[i]) @ found - expected)[:3, 3]))
    return np.array(errors)
