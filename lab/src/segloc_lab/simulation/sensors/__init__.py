"""LiDARs: which rays they cast, and what returns."""

from __future__ import annotations

from collections.abc import Callable

from .lidar import hdl32e, hdl64e, os0_128, os1_64, os1_128, vlp16
from .linescan import lms151
from .ranging import Lidar
from .rosette import avia, mid360, solid_state

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
"""What makes each sensor; an argument says how many firings a scan has."""
