"""How much one input may hold. A few kilobytes can claim, or unpack to, more than any machine has.

Counts are checked before anything is allocated for them. The limit comes from the environment, so
that it holds in worker processes, too.
"""

from __future__ import annotations

import os

from ..errors import ConfigError, DatasetError

OPTION = "SEGLOC_MAX_POINTS"
"""The environment variable that moves all of the limits."""
MOST_POINTS = 20_000_000
"""Of a scan: 40 times what the densest sensors measure in a turn."""
BYTES_A_POINT = 50
"""More than any format takes for one, as text or with all its fields."""
_MESSAGE_SHARE = 4


def most_points() -> int:
    """The most points of a scan, and rows of a table.

    Raises
    ------
    ConfigError
        If the environment variable is not a positive whole number.
    """
    text = os.environ.get(OPTION, "")
    if not text:
        return MOST_POINTS
    if not (text.isascii() and text.isdigit() and len(text) <= 15 and int(text)):
        raise ConfigError(f"{OPTION} must be a positive whole number, not {text[:40]!r}")
    return int(text)


def most_bytes() -> int:
    """The most bytes of a scan, as a file and unpacked."""
    return BYTES_A_POINT * most_points()


def most_message_bytes() -> int:
    """The most bytes of a message or chunk of a bag, unpacked."""
    return most_bytes() // _MESSAGE_SHARE


def check_points(count: int, what: str = "points") -> None:
    """Refuse more points, or rows, than a scan may have.

    Raises
    ------
    DatasetError
    """
    if count > (limit := most_points()):
        raise DatasetError(
            f"{_figure(count)} {what}: more than {limit}; set {OPTION} higher to read them"
        )


def check_bytes(count: int, what: str, limit: int | None = None) -> None:
    """Refuse more bytes than a scan may have, or than ``limit``.

    Raises
    ------
    DatasetError
    """
    if count > (limit := most_bytes() if limit is None else limit):
        raise DatasetError(
            f"{what} of {_figure(count)} bytes: more than {limit}; set {OPTION} (now "
            f"{most_points()}) higher to read it"
        )


def _figure(count: int) -> str:
    return str(count) if count < 10**18 else f"{count:.3g}" if count < 10**300 else "1e300"
