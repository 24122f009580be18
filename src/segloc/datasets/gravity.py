"""Which way is down, as an IMU beside the sensor has it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from ..types import Float64

HALF_WINDOW_S = 0.4
"""Accelerations this long before and after a scan's stamp are averaged."""
ACCELEROMETER_ERROR_DEG = 15.0
"""A vehicle that brakes by 2.6 m/s2 has its acceleration so far off vertical."""
ORIENTATION_ERROR_DEG = 3.0
_G = 9.80665  # m/s2
_HALF_G = _G / 2  # between accelerations in m/s2 and those in g, which some drivers give
_OFF = 0.05  # share by which the mean may be longer or shorter than gravity; an OS1 was 0.04 off
_RESTLESS = 0.3  # share of gravity: the deviation of single values from the mean
_FEWEST = 5


@dataclass(frozen=True)
class Gravity:
    """Which way is down at one moment."""

    direction: Float64  # (3,) unit vector, down
    error_deg: float  # how far off it may be


class GravitySource(Protocol):
    """Gravity at each scan of a source.

    name: what it comes from: a topic, or a kind of packet
    note: what had to be taken for granted, if anything
    """

    @property
    def name(self) -> str: ...
    @property
    def note(self) -> str: ...

    def at(self, k: int) -> Gravity | None:
        """In the frame of the points of the scan at position k; None where it is not known."""
        ...


def weighed(accelerations: Float64) -> Gravity | None:
    """Gravity from what an accelerometer measures around one moment, in m/s2 or in g.

    None where the mean is no gravity by its length, values scatter, or there are too few: the
    sensor is shaken, or speeds up.

    accelerations: (K, 3) up, at rest
    """
    values = accelerations[np.isfinite(accelerations).all(axis=1)]
    if len(values) < _FEWEST:
        return None
    with np.errstate(over="ignore", invalid="ignore"):
        mean = values.mean(axis=0)
        length = float(np.linalg.norm(mean))
        unit = _G if length > _HALF_G else 1.0
        scatter = float(np.sqrt(((values - mean) ** 2).sum(axis=1).mean()))
    if not (abs(length / unit - 1.0) <= _OFF and scatter <= _RESTLESS * unit):
        return None
    return Gravity(-mean / length, ACCELEROMETER_ERROR_DEG)


@dataclass(frozen=True)
class Accelerometer:
    """Gravity at scans from accelerations in memory; a ``GravitySource``."""

    name: str
    scans: Float64  # (N,) stamps of the scans, seconds
    stamps: Float64  # (K,) of the accelerations, seconds
    accelerations: Float64  # (K, 3) in the frame of the points, m/s2 or g
    note: str = ""

    def at(self, k: int) -> Gravity | None:
        near = np.abs(self.stamps - self.scans[k]) <= HALF_WINDOW_S
        return weighed(self.accelerations[near])
