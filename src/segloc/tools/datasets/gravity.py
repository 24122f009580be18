"""Gravity direction from an IMU beside the sensor."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from ...types import Float64

GRAVITY_HALF_WINDOW_S = 0.4
"""Accelerations within this time of a scan's stamp are averaged."""
ACCELEROMETER_ERROR_DEG = 15.0
"""Error of a vehicle that brakes at 2.6 m/s2."""
ORIENTATION_ERROR_DEG = 3.0
_G = 9.80665  # m/s2
_HALF_G = _G / 2  # separates accelerations in m/s2 from those in g
_LENGTH_TOLERANCE = 0.05  # relative error of the mean's length; an OS1 was 0.04 off
_MAX_SCATTER = 0.3  # deviation of single values from the mean, as a share of gravity
_MIN_SAMPLES = 5


@dataclass(frozen=True)
class Gravity:
    """Gravity direction at one moment."""

    direction: Float64  # (3,) unit vector, down
    error_deg: float  # bound of the error


class GravitySource(Protocol):
    """Gravity at each scan of a source.

    name: topic or kind of packet
    note: assumption made, if any
    """

    @property
    def name(self) -> str: ...
    @property
    def note(self) -> str: ...

    def at(self, k: int) -> Gravity | None:
        """Gravity in the frame of the points of scan k; None if unknown."""
        ...


def gravity_of(accelerations: Float64) -> Gravity | None:
    """Estimate gravity from accelerometer samples around one moment, in m/s2 or g.

    Return None if the sensor is shaken or accelerates: the mean has the wrong length, samples
    scatter, or there are too few.

    accelerations: (K, 3), pointing up at rest
    """
    values = accelerations[np.isfinite(accelerations).all(axis=1)]
    if len(values) < _MIN_SAMPLES:
        return None
    with np.errstate(over="ignore", invalid="ignore"):
        mean = values.mean(axis=0)
        length = float(np.linalg.norm(mean))
        unit = _G if length > _HALF_G else 1.0
        scatter = float(np.sqrt(((values - mean) ** 2).sum(axis=1).mean()))
    if not (abs(length / unit - 1.0) <= _LENGTH_TOLERANCE and scatter <= _MAX_SCATTER * unit):
        return None
    return Gravity(-mean / length, ACCELEROMETER_ERROR_DEG)


@dataclass(frozen=True)
class Accelerometer:
    """Gravity at scans from accelerations in memory; a ``GravitySource``."""

    name: str
    scans: Float64  # (N,) stamps of the scans [s]
    stamps: Float64  # (K,) stamps of the accelerations [s]
    accelerations: Float64  # (K, 3) in the frame of the points, m/s2 or g
    note: str = ""

    def at(self, k: int) -> Gravity | None:
        near = np.abs(self.stamps - self.scans[k]) <= GRAVITY_HALF_WINDOW_S
        return gravity_of(self.accelerations[near])
