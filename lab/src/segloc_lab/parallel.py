"""Tasks of a study, by processes or an executor."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor

from segloc.system.processes import Result, Task, as_finished, single_threaded_pool


def in_parallel(
    work: Callable[[Task], Result],
    tasks: Sequence[Task],
    workers: int,
    executor: Executor | None = None,
) -> Iterator[tuple[int, Result]]:
    """Yield the number and result of each task, by an executor or else by ``workers`` processes.

    As :func:`segloc.system.processes.as_finished`. Processes have one thread each for linear
    algebra. A single worker or task runs in this process.
    """
    if executor is not None or workers == 1 or len(tasks) < 2:
        yield from as_finished(work, tasks, executor)
        return
    with single_threaded_pool(min(workers, len(tasks))) as pool:
        yield from as_finished(work, tasks, pool)
