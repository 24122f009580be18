"""What every recording offers, and how parts of one are named."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ..errors import ConfigError
from ..types import Int64, Recording

_RANGE = re.compile(r"(\d{0,18})(:?)(\d{0,18})", re.ASCII)


class Sequence(Recording, Protocol):
    """A recording that parts can be taken of."""

    def select(self, selection: Selection) -> Sequence:
        """The scans whose indices are in the selection, in the same order."""
        ...


@dataclass(frozen=True)
class Selection:
    """Ranges of indices, both ends included; None is an open end."""

    ranges: tuple[tuple[int, int | None], ...]

    def mask(self, indices: Int64) -> NDArray[np.bool_]:
        """Which of the indices are selected, (N,) bool."""
        chosen = np.zeros(len(indices), dtype=bool)
        for first, last in self.ranges:
            chosen |= (indices >= first) & (True if last is None else indices <= last)
        return chosen

    def __str__(self) -> str:
        return ",".join(f"{a}:{'' if b is None else b}" for a, b in self.ranges)


def parse_select(text: str) -> Selection:
    """A selection like ``100:947,1001:1100``: inclusive ranges, open ends, single numbers.

    Raises
    ------
    ConfigError
        If a part is not ``7``, ``100:947``, ``100:`` or ``:50``, or ends before it starts.
    """
    return Selection(tuple(_parse_range(part.strip(), text) for part in text.split(",")))


def _parse_range(part: str, text: str) -> tuple[int, int | None]:
    found = _RANGE.fullmatch(part)
    if found is None or not (found[1] or found[3]):
        raise ConfigError(f"selection {text[:80]!r}: {part[:40]!r} is no number and no range")
    first = int(found[1] or 0)
    last = first if not found[2] else int(found[3]) if found[3] else None
    if last is not None and last < first:
        raise ConfigError(f"selection {text[:80]!r}: {part} ends before it starts")
    return first, last
