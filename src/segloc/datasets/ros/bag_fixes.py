"""GNSS fixes of a bag, from sensor_msgs/NavSatFix."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import DatasetError
from ...types import Float64
from .bag_file import opened
from .bag_headers import seconds
from .bag_tf import fullest_topics

_FIX = "sensor_msgs/msg/NavSatFix"
_NO_FIX, _UNKNOWN = -1, 0


def rows_of(paths: tuple[Path, ...], topic: str | None) -> tuple[str, Float64]:
    """The topic, and (K, 5) stamps, longitudes, latitudes, heights and errors.

    Raises
    ------
    DatasetError
        If there is no such topic.
    """
    with opened(paths) as reader:
        topics = fullest_topics(reader, _FIX)
        if not topics or (topic is not None and topic not in topics):
            listed = ", ".join(topics) or "none"
            raise DatasetError(
                f"{paths[0]}: no topic of GNSS fixes {topic or ''}: there is {listed}"
            )
        chosen = topic or topics[0]
        wanted = [item for item in reader.connections if item.topic == chosen]
        rows = []
        for item, logged, data in reader.messages(wanted):
            message: Any = reader.deserialize(data, item.msgtype)
            stamp = seconds(message.header.stamp) or logged * 1e-9
            if (row := _row(message, stamp)) is not None:
                rows.append(row)
    return chosen, np.array(rows, np.float64).reshape(-1, 5)


def _row(message: Any, stamp: float) -> list[float] | None:
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
