"""Convert ROS's sensor_msgs/PointCloud2 to scans.

Layout: docs.ros.org, sensor_msgs/PointCloud2 and PointField.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ....errors import DatasetError
from ....system.budget import check_points
from ....types import Float64, Scan
from ...io.point_times import time_field, time_scale, times_of
from ..layout import drop_missing_returns

_TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}


def scan_of_pointcloud2(cloud: Any) -> Scan:
    """Convert a message to points, with times in seconds as stored; drops missing returns.

    ``clocks.StreamTimes`` or ``time_unit`` make them seconds after the stamp.

    cloud: sensor_msgs/PointCloud2

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
    return drop_missing_returns(xyz, _times(columns))


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


def _times(columns: dict[str, NDArray[Any]]) -> Float64 | None:
    names = list(columns)
    if (position := time_field(names)) is None:
        return None
    name = names[position]
    values = columns[name]
    return times_of(values, time_scale(name, integer=values.dtype.kind in "iu"))
