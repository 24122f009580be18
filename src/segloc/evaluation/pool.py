"""Independent parts of a study, several at a time."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import as_completed
from concurrent.futures.process import BrokenProcessPool
from typing import TypeVar

from ..errors import SeglocError
from ..training.collect import single_threaded_pool

Task = TypeVar("Task")
Result = TypeVar("Result")


def in_parallel(
    work: Callable[[Task], Result], tasks: Sequence[Task], workers: int
) -> Iterator[Result]:
    """Results as they are finished.

    Parameters
    ----------
    work : callable
        Can be pickled, and so can what it takes and returns.
    tasks : sequence
    workers : int
        Processes, with one thread each for linear algebra. With one, or one task, everything runs
        in this process.

    Raises
    ------
    SeglocError
        If the system ended a process, as it does when memory runs out.
    """
    if workers == 1 or len(tasks) < 2:
        yield from map(work, tasks)
        return
    with single_threaded_pool(min(workers, len(tasks))) as pool:
        futures = [pool.submit(work, task) for task in tasks]
        try:
            for future in as_completed(futures):
                yield future.result()
        except BrokenProcessPool as error:
            raise SeglocError(
                "a worker process was ended, most likely because memory ran out: try --workers 1; "
                "what is finished is kept"
            ) from error
        finally:
            for future in futures:
                future.cancel()  # after a fault the rest would be done in vain
