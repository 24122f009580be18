"""Memory of this process, as Linux counts it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

_STATUS, _RESET = Path("/proc/self/status"), Path("/proc/self/clear_refs")
_RESET_PEAK = "5"


def highest_mb() -> float:
    """The most that the process has held so far, megabytes."""
    return _status_kb("VmHWM") / 1024


def held_mb() -> float:
    """What the process holds now, megabytes."""
    return _status_kb("VmRSS") / 1024


def rise_mb(work: Callable[[], object]) -> float:
    """By how many megabytes the process's memory rises while it works, at its highest."""
    _RESET.write_text(_RESET_PEAK)
    before = held_mb()
    work()
    return highest_mb() - before


def _status_kb(field: str) -> int:
    for line in _STATUS.read_text().splitlines():
        if line.startswith(field + ":"):
            return int(line.split()[1])
    raise OSError(f"{_STATUS} has no {field}")
