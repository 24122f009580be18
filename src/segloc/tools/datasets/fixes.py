"""GNSS fixes of a bag: antenna positions."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import DatasetError
from ...types import Float64
from .ros.bag_file import fullest_topics, messages_of, open_bag, seconds

_FIX = "sensor_msgs/msg/NavSatFix"
_NO_FIX, _UNKNOWN = -1, 0


@dataclass(frozen=True)
class Fixes:
    """GNSS fixes in order of time."""

    source: str  # topic
    stamps: Float64  # (K,) on the clock of the scans [s]
    degrees: Float64  # (K, 3) longitude, latitude [deg], height above the WGS 84 ellipsoid [m]
    error_m: Float64  # (K,) standard deviation along the worse horizontal axis; NaN if unknown

    def __len__(self) -> int:
        return len(self.stamps)

    @classmethod
    def of(cls, source: str, messages: Iterable[tuple[Any, float]]) -> Fixes:
        """From sensor_msgs/NavSatFix with the times [s] that count for those without a stamp."""
        found = [_row(message, received) for message, received in messages]
        rows = np.array([row for row in found if row], np.float64).reshape(-1, 5)
        rows = rows[rows[:, 0].argsort(kind="stable")]
        return cls(source, rows[:, 0], rows[:, 1:4], rows[:, 4])


def read_fixes(path: str | Path, topic: str | None = None) -> Fixes:
    """Read the ``sensor_msgs/NavSatFix`` messages of a bag that have a fix.

    Parameters
    ----------
    path : path
        A bag.
    topic : str, optional
        Topic; by default the one with the most messages.

    Raises
    ------
    DatasetError
        If the path is not a bag, or has no fixes.
    MissingDependency
        If the package rosbags is not installed.
    """
    from .ros.bags import bag_paths

    paths = bag_paths(Path(path))
    if not paths:
        raise DatasetError(f"{path}: not a bag; GNSS fixes are read from bags")
    with open_bag(paths) as reader:
        topics = fullest_topics(reader, _FIX)
        if not topics or (topic is not None and topic not in topics):
            listed = ", ".join(topics) or "none"
            raise DatasetError(f"{paths[0]}: no NavSatFix topic {topic or ''}; available: {listed}")
        chosen = topic or topics[0]
        messages = ((message, 1e-9 * logged) for message, logged in messages_of(reader, chosen))
        fixes = Fixes.of(chosen, messages)
    if not len(fixes):
        raise DatasetError(f"{path}: {chosen}: no message with a fix")
    return fixes


def _row(message: Any, received: float) -> list[float] | None:
    """Stamp, longitude, latitude, height and error; None without a fix."""
    stamp = seconds(message.header.stamp) or received
    place = [float(message.longitude), float(message.latitude)]
    sane = abs(place[0]) <= 180.0 and abs(place[1]) <= 90.0  # and not NaN
    if message.status.status <= _NO_FIX or not sane or not math.isfinite(stamp):
        return None
    height = float(message.altitude)
    spread = np.asarray(message.position_covariance, np.float64)
    worse = max(spread[0], spread[4])
    known = message.position_covariance_type != _UNKNOWN and 0.0 < worse < math.inf
    error = math.sqrt(worse) if known else math.nan
    return [stamp, *place, height if math.isfinite(height) else 0.0, error]
