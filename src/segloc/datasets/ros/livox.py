"""Livox' own message, CustomMsg of the packages livox_ros_driver and livox_ros_driver2.

Layout: the packages' README: a header, uint64 timebase, uint32 point_num, uint8 lidar_id, three
reserved bytes, and of each point uint32 offset_time (ns), float32 x, y, z, uint8 reflectivity, tag
and line. Points are read from the bytes as one array: there are 24 000 in a message, and objects
of them would take a hundred times as long. It also needs no definition, which older bags lack.
"""

from __future__ import annotations

import struct

import numpy as np

from ...errors import DatasetError
from ...system.budget import check_points
from ...types import Scan

_POINT = 19  # bytes


def to_scan(data: bytes, *, cdr: bool) -> Scan:
    """The points of a message and their times after its stamp; firings without return left out.

    Parameters
    ----------
    data : bytes
        The message as a bag holds it.
    cdr : bool
        Whether that is ROS 2's CDR, behind four bytes that name the byte order; else ROS 1's.

    Raises
    ------
    DatasetError
        If the message has fewer bytes than its sizes promise.
    """
    order = "<" if not cdr or data[1:2] == b"\1" else ">"
    body, header, step = (data[4:], 8, _POINT + 1) if cdr else (data, 12, _POINT)
    try:
        (length,) = struct.unpack_from(f"{order}I", body, header)
        place = header + 4 + length
        if cdr:
            place += -place % 8  # timebase is aligned
        (count,) = struct.unpack_from(f"{order}I", body, place + 16)
    except struct.error as error:
        raise DatasetError(f"cut off: {len(data)} bytes are no message of Livox") from error
    check_points(count)
    first = place + 20
    rows = body[first:] + b"\0" * (step - _POINT)  # the last point is not padded
    if count * step > len(rows):
        raise DatasetError(f"cut off: {count} points in {max(0, len(body) - first)} bytes")
    kinds = [f"{order}{kind}" for kind in ("u4", "f4", "f4", "f4")]
    point = np.dtype(
        {
            "names": ["offset_time", "x", "y", "z"],
            "formats": kinds,
            "offsets": [0, 4, 8, 12],
            "itemsize": step,
        }
    )
    points = np.frombuffer(rows, point, count)
    xyz = np.column_stack([points[axis].astype(np.float32) for axis in "xyz"])
    hit = (xyz != 0).any(axis=1)
    return Scan(xyz[hit], times=points["offset_time"][hit] * 1e-9)
