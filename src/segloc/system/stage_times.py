"""Time the stages of a query."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

Clock = Callable[[], float]
"""Returns seconds: ``time.perf_counter`` (wall) or ``time.process_time`` (processor)."""


class StageTimes:
    """Accumulate the milliseconds spent in named blocks.

    Parameters
    ----------
    clock : callable
        Returns seconds.
    """

    def __init__(self, clock: Clock = time.perf_counter) -> None:
        self.ms: dict[str, float] = {}
        self._clock = clock

    @contextmanager
    def __call__(self, stage: str) -> Iterator[None]:
        start = self._clock()
        yield
        self.ms[stage] = self.ms.get(stage, 0.0) + 1e3 * (self._clock() - start)

    def beyond(self, deadline_ms: float | None) -> bool:
        """Return whether all stages together reached the deadline."""
        return deadline_ms is not None and sum(self.ms.values()) >= deadline_ms

    def with_total(self) -> dict[str, float]:
        """Return the times of all stages, and their sum as "total"."""
        return {**self.ms, "total": sum(self.ms.values())}
