"""LiDARs: which rays they cast, and what returns."""

from __future__ import annotations

from collections.abc import Callable

from .lidar import (
    avia,
    hdl32e,
    hdl64e,
    lms151,
    mid360,
    os0_128,
    os1_64,
    os1_128,
    solid_state,
    vlp16,
)
from .ranging import Lidar

SENSORS: dict[str, Callable[..., Lidar]] = {
    "hdl64e": hdl64e,
    "hdl32e": hdl32e,
    "vlp16": vlp16,
    "os0-128": os0_128,
    "os1-64": os1_64,
    "os1-128": os1_128,
    "avia": avia,
    "mid360": mid360,
    "solid-state": solid_state,
    "lms151": lms151,
}
"""Factories of sensors; an argument sets the number of firings per scan."""
