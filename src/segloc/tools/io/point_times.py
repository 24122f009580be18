"""Names and units of the fields that hold point times, in files, bags and messages.

Drivers: Ouster (t, ns), Velodyne (time, s), Hesai and RoboSense (timestamp, s since 1970), Livox
(offset_time or timestamp, ns), Autoware (time_stamp, ns), Aeva (time_offset_ns).
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...types import Float64

_STEMS = (
    "t", "offsettime", "timeoffset", "pointtimeoffset", "pointtime", "relativetime", "reltime",
    "deltatime", "timedelta", "time", "timestamp", "stamp", "ts", "gpstime",
)  # fmt: skip
"""Names without case, underscores and unit, in order of precedence: relative times first."""
_UNITS = {
    **dict.fromkeys(("ns", "nsec", "nsecs", "nanosec", "nanoseconds"), 1e-9),
    **dict.fromkeys(("us", "usec", "usecs", "microsec", "microseconds"), 1e-6),
    **dict.fromkeys(("ms", "msec", "msecs", "millisec", "milliseconds"), 1e-3),
    **dict.fromkeys(("s", "sec", "secs", "seconds"), 1.0),
}
_PREFIXES = ("scalar",)  # CloudCompare's
_WORD = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+")
_TELLING = re.compile(r"time|stamp|[nu]sec|(?:^|_)[nu]s$|^dt$", re.IGNORECASE)
_MAX_NAME = 64
_NANOSECONDS = 1e14  # larger fractional times are nanoseconds since 1970


def time_field(names: Sequence[str]) -> int | None:
    """Return the position of the field with point times; None if there is none."""
    ranks = {
        k: _STEMS.index(parts[0]) for k, name in enumerate(names) if (parts := _split_known(name))
    }
    return min(ranks, key=lambda k: (ranks[k], k)) if ranks else None


def unread_times(names: Iterable[str]) -> str:
    """Return a line on fields that look like point times but are not read; "" if none."""
    names = list(names)
    unread = [name for name in names if _TELLING.search(name[:_MAX_NAME])]
    if not unread or time_field(names) is not None:
        return ""
    return (
        f"field {', '.join(map(repr, unread[:3]))} may hold point times, but is not read: name it "
        "t, time or timestamp (names: reference/recordings.md)"
    )


def time_scale(name: str, *, integer: bool) -> float:
    """Return the unit [s] of a field: as its name says, else ns for integers and s for others."""
    known = _split_known(name)
    unit = known[1] if known else None
    return unit if unit is not None else 1e-9 if integer else 1.0


def times_of(values: NDArray[Any], scale: float) -> Float64:
    """Convert values (N,) of a time field to seconds; nanoseconds since 1970 are recognised."""
    times = np.asarray(values, dtype=np.float64)
    if scale == 1.0 and times[np.isfinite(times)].max(initial=0.0) > _NANOSECONDS:
        scale = 1e-9
    return times if scale == 1.0 else times * scale


def _split_known(name: str) -> tuple[str, float | None] | None:
    """Split a known name into its stem and its unit [s], if named; None for another name."""
    words = [word.lower() for word in _WORD.findall(name[:_MAX_NAME])]
    words = words[words[:1] == list(_PREFIXES) :]
    unit = _UNITS.get(words[-1]) if len(words) > 1 else None
    stem = "".join(words if unit is None else words[:-1])
    return (stem, unit) if stem in _STEMS else None
