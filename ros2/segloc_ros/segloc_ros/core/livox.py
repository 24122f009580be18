"""Livox's CustomMsg, read from its serialised bytes: no Python object per point."""

from __future__ import annotations

import struct

from segloc import DatasetError, Scan
from segloc.robot import scan_of_livox


def is_livox(type_name: str) -> bool:
    """Return whether a message's type is Livox's, of either driver."""
    return type_name.startswith("livox_") and type_name.endswith("/msg/CustomMsg")


def livox_cloud(data: bytes) -> tuple[float, str, Scan]:
    """Return the stamp [s], the frame and the points of a ``CustomMsg`` in CDR, of either driver.

    Raise DatasetError if it is cut off, or its frame is no text.
    """
    order = "<" if data[1:2] == b"\1" else ">"
    try:
        sec, nanosec, length = struct.unpack_from(f"{order}iII", data, 4)
        frame = bytes(data[16 : 16 + length]).rstrip(b"\0").decode()
    except (struct.error, UnicodeDecodeError) as error:
        raise DatasetError(f"not a Livox message: {error}") from error
    return sec + 1e-9 * nanosec, frame, scan_of_livox(bytes(data))
