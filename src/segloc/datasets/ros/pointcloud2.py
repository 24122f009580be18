"""Convert ROS's sensor_msgs/PointCloud2 to scans.

Layout: docs.ros.org, sensor_msgs/PointCloud2 and PointField. Time fields of drivers: Ouster (t,
ns), Velodyne (time, s), Hesai and RoboSense (timestamp, s since 1970) and Livox (offset_time, ns).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...errors import DatasetError
from ...system.budget import check_points
from ...types import Float64, Scan
from ..layout import returned

_TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
TIMES = ("t", "time", "timestamp", "time_stamp", "offset_time", "time_offset", "timeOffset")
"""Names of fields with point times, in order of precedence."""
_EPOCH_S = 1e8  # larger times are seconds since 1970


def to_scan(cloud: Any, stamp: float) -> Scan:
    """Convert a message to points, with times after ``stamp``; drops missing returns.

    cloud: sensor_msgs/PointCloud2
    stamp: the message's own [s]

    Raise DatasetError if x, y or z is missing, or the message is shorter than its declared size.
    """
    columns = _columns(cloud)
    try:
        with np.errstate(all="ignore"):  # beyond float32: inf, which is dropped
            named = [axis if axis in columns else axis.upper() for axis in "xyz"]
            xyz = np.column_stack([columns[name].astype(np.float32) for name in named])
    except KeyError as error:
        raise DatasetError(
            f"no field {str(error).lower()}; fields: {', '.join(columns) or 'none'}"
        ) from error
    times = _seconds(columns, stamp)
    return returned(xyz, times)


def _columns(cloud: Any) -> dict[str, NDArray[Any]]:
    """Return each single-valued field, (N,); row by row, since rows may be padded."""
    rows, width = int(cloud.height), int(cloud.width)
    check_points(rows * width)
    step, stride = int(cloud.point_step), int(cloud.row_step)
    data = np.frombuffer(cloud.data, dtype=np.uint8)
    packed = rows * width * step
    if stride in (0, packed) or rows == 1 or (packed == len(data) and stride != width * step):
        stride = width * step  # some writers omit it, or write the size of the whole cloud
    needed = (rows - 1) * stride + width * step if rows and width else 0
    if needed > len(data) or stride < width * step:
        raise DatasetError(
            f"{rows} x {width} points need {needed} bytes, but there are {len(data)}"
        )
    order = ">" if cloud.is_bigendian else "<"
    columns: dict[str, NDArray[Any]] = {}
    for field in cloud.fields:
        kind = _TYPES.get(int(field.datatype))
        if kind is None or int(field.count) > 1:
            continue
        dtype = np.dtype(order + kind)
        if int(field.offset) + dtype.itemsize > step:
            raise DatasetError(f"field {field.name} lies outside the {step} bytes of a point")
        if not needed:
            columns[field.name] = np.empty(0, dtype)
            continue
        view: NDArray[Any] = np.ndarray(
            (rows, width), dtype, data.data, int(field.offset), (stride, step)
        )
        columns[field.name] = view.reshape(-1)
    return columns


def _seconds(columns: dict[str, NDArray[Any]], stamp: float) -> Float64 | None:
    name = next((name for name in TIMES if name in columns), None)
    if name is None:
        return None
    raw = columns[name]
    times = raw.astype(np.float64)
    latest = times[np.isfinite(times)].max(initial=0.0)
    if raw.dtype.kind in "iu" or latest > _EPOCH_S * 1e6:
        times, latest = times * 1e-9, latest * 1e-9
    if latest > _EPOCH_S:
        times -= stamp
    return times
