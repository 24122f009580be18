"""Measurements of two days, side by side: what became slower."""

from __future__ import annotations

import json
import statistics
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter, ValidationError

from segloc.errors import SeglocError

from .harness import Row

SLOWER = 1.15
"""Medians of one machine differ by less from run to run."""


@dataclass(frozen=True)
class Change:
    """One benchmark, before and now.

    Attributes
    ----------
    name : str
    threads : int
    before_ms, now_ms : float
    against_rivals : float or None
        How many times as long as before, where the same rivals are the clock: whatever else made
        the machine faster or slower is left out. None where both days have no rival in common.
    """

    name: str
    threads: int
    before_ms: float
    now_ms: float
    against_rivals: float | None

    @property
    def times(self) -> float:
        """How many times as long as before by the clock."""
        return self.now_ms / self.before_ms

    @property
    def is_slower(self) -> bool:
        """Whether it became slower, by the clock and against its rivals."""
        return min(self.times, self.against_rivals or self.times) > SLOWER


def compared(before: Sequence[Row], now: Sequence[Row]) -> list[Change]:
    """The benchmarks that both days have, in today's order."""
    known = {(row.name, row.threads): row for row in before}
    return [
        _change(known[row.name, row.threads], row)
        for row in now
        if (row.name, row.threads) in known
    ]


def _change(before: Row, now: Row) -> Change:
    both = sorted(before.rivals.keys() & now.rivals.keys())
    ratios = [
        (now.ours_ms / now.rivals[name]) / (before.ours_ms / before.rivals[name]) for name in both
    ]
    against = statistics.median(ratios) if ratios else None
    return Change(now.name, now.threads, before.ours_ms, now.ours_ms, against)


def change_rows(changes: Sequence[Change]) -> list[tuple[str, str, str, str, str]]:
    """(what, ms before, ms now, how many times, the same against rivals)."""
    return [
        (
            f"{change.name}, {change.threads} thread{'s' * (change.threads > 1)}",
            f"{change.before_ms:.2f}",
            f"{change.now_ms:.2f}",
            f"{change.times:.2f}",
            "" if change.against_rivals is None else f"{change.against_rivals:.2f}",
        )
        for change in changes
    ]


def read_json(path: Path) -> list[Row]:
    """The rows that ``--json`` wrote.

    Raises
    ------
    SeglocError
        If the file cannot be read, or holds something else.
    """
    try:
        rows: Any = json.loads(path.read_text("utf-8"))
        return TypeAdapter(list[Row]).validate_python(rows)
    except OSError as error:
        raise SeglocError(f"{path}: cannot be read ({error.strerror or error})") from error
    except (ValidationError, ValueError) as error:
        raise SeglocError(f"{path}: not what segloc bench --json writes") from error
