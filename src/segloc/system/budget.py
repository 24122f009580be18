"""Limits on the size of one input: a few kilobytes can declare, or unpack to, any size.

Counts are checked before allocation. The limit is an environment variable, so that it applies to
worker processes, too.
"""

from __future__ import annotations

import os

from ..errors import ConfigError, DatasetError

OPTION = "SEGLOC_MAX_POINTS"
"""Environment variable that sets all of the limits."""
MAX_POINTS = 20_000_000
"""Of a scan: 40 times a turn of the densest sensors."""
BYTES_A_POINT = 50
"""More than a point takes in any format, as text or with all its fields."""
_MESSAGE_SHARE = 4


def most_points() -> int:
    """Return the maximum number of points of a scan, and of rows of a table.

    Raises
    ------
    ConfigError
        If the environment variable is not a positive whole number.
    """
    text = os.environ.get(OPTION, "")
    if not text:
        return MAX_POINTS
    if not (text.isascii() and text.isdigit() and len(text) <= 15 and int(text)):
        raise ConfigError(f"{OPTION} must be a positive whole number, not {text[:40]!r}")
    return int(text)


def most_bytes() -> int:
    """Return the maximum size of a scan, as a file and unpacked [bytes]."""
    return BYTES_A_POINT * most_points()


def most_message_bytes() -> int:
    """Return the maximum size of a message or chunk of a bag, unpacked [bytes]."""
    return most_bytes() // _MESSAGE_SHARE


def check_points(count: int, what: str = "points") -> None:
    """Reject more points, or rows, than a scan may have, by a :class:`DatasetError`."""
    if count > (limit := most_points()):
        raise DatasetError(
            f"{_figure(count)} {what}: more than {limit}; increase {OPTION} to read them"
        )


def check_bytes(count: int, what: str, limit: int | None = None) -> None:
    """Reject more bytes than a scan may have, or than ``limit``, by a :class:`DatasetError`."""
    if count > (limit := most_bytes() if limit is None else limit):
        raise DatasetError(
            f"{what} of {_figure(count)} bytes: more than {limit}; increase {OPTION} (now "
            f"{most_points()}) to read it"
        )


def _figure(count: int) -> str:
    return str(count) if count < 10**18 else f"{count:.3g}" if count < 10**300 else "1e300"
