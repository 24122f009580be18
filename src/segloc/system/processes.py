"""Run independent tasks in several processes."""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import BrokenExecutor, Executor, Future, ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from multiprocessing import resource_tracker
from typing import Any, TypeVar

from ..errors import SeglocError, requires

Task = TypeVar("Task")
Result = TypeVar("Result")

_BLAS_THREADS = "OPENBLAS_NUM_THREADS"
_ATTEMPTS = 4
"""Maximum number of starts of a task whose worker is lost."""


class _Pool(ProcessPoolExecutor):
    """Processes that receive Ctrl-C from the terminal only while they work.

    At other times, such as during start-up, it would end them with a long traceback. A process
    inherits the blocked signals of its parent.
    """

    def submit(self, fn: Callable[..., Any], /, *given: Any, **named: Any) -> Future[Any]:
        if os.name == "posix":
            resource_tracker.ensure_running()  # else it is started below, and unblocks the signal
        with _interrupts("SIG_BLOCK"):
            return super().submit(_work, fn, *given, **named)


@contextmanager
def _interrupts(way: str) -> Iterator[None]:
    """Hold interrupts back during the block, or let them through; not on Windows."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(getattr(signal, way), {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


_interrupted = False  # True: queued tasks of this process are not started


def _work(work: Callable[..., Result], *given: Any, **named: Any) -> Result:
    global _interrupted
    try:
        with _interrupts("SIG_UNBLOCK"):
            if _interrupted:
                raise KeyboardInterrupt
            return work(*given, **named)
    except KeyboardInterrupt:
        _interrupted = True
        raise


class ProcessPool(Executor):
    """Fresh processes: forks would inherit the ray caster's stopped threads.

    Parameters
    ----------
    workers : int
    """

    def __init__(self, workers: int) -> None:
        self._workers = workers
        self._pool = self._create()

    def _create(self) -> _Pool:
        return _Pool(self._workers, mp_context=multiprocessing.get_context("spawn"))

    def submit(self, fn: Callable[..., Any], /, *given: Any, **named: Any) -> Future[Any]:
        return self._pool.submit(fn, *given, **named)

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        self._pool.shutdown(wait, cancel_futures=cancel_futures)

    def renew(self) -> None:
        """Start new processes after one was lost, since the pool accepts no more tasks."""
        self._pool.shutdown()
        self._pool = self._create()


@contextmanager
def single_threaded_pool(workers: int) -> Iterator[Executor]:
    """Create processes with one thread each for linear algebra; more would compete."""
    before = os.environ.get(_BLAS_THREADS)
    os.environ[_BLAS_THREADS] = "1"
    try:
        with ProcessPool(workers) as pool:
            yield pool
    finally:
        if before is None:
            del os.environ[_BLAS_THREADS]
        else:
            os.environ[_BLAS_THREADS] = before


def as_finished(
    work: Callable[[Task], Result], tasks: Sequence[Task], executor: Executor | None
) -> Iterator[tuple[int, Result]]:
    """Yield the number and result of each task as it finishes.

    Parameters
    ----------
    work : callable
        Picklable, as are its argument and result; repeatable.
    tasks : sequence
    executor : Executor or None
        Processes, threads, or a cluster. None: this thread, one task after another.

    Raises
    ------
    SeglocError
        If the system killed the process of a task, for example as memory ran out, repeatedly in a
        :class:`ProcessPool`.
    """
    if executor is None:
        yield from enumerate(map(work, tasks))
        return
    left = dict(enumerate(tasks))
    for attempt in range(_ATTEMPTS):
        try:
            for number, result in _once(work, left, executor):
                del left[number]
                yield number, result
            return
        except BrokenExecutor as error:
            if not isinstance(executor, ProcessPool) or attempt + 1 == _ATTEMPTS:
                raise SeglocError(
                    "a worker process was killed, most likely because memory ran out: use fewer "
                    "workers, such as --workers 1; finished tasks are kept"
                ) from error
            executor.renew()


def _once(
    work: Callable[[Task], Result], tasks: dict[int, Task], executor: Executor
) -> Iterator[tuple[int, Result]]:
    """Yield results of tasks; then raise BrokenExecutor if some are lost."""
    futures: dict[Future[Result], int] = {}
    lost: BrokenExecutor | None = None
    try:
        try:
            for number, task in tasks.items():
                futures[executor.submit(work, task)] = number
        except BrokenExecutor as error:
            lost = error
        for future in as_completed(list(futures)):
            try:
                result = future.result()
            except BrokenExecutor as error:
                lost = error
            else:
                yield futures[future], result
    finally:
        for future in futures:
            future.cancel()  # the rest is not needed after a fault
    if lost is not None:
        raise lost


def all_of(
    work: Callable[[Task], Result],
    tasks: Sequence[Task],
    executor: Executor | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> list[Result]:
    """Return the results of all tasks, in order; see :func:`as_finished`.

    ``progress`` is called with (tasks done, total).
    """
    found: dict[int, Result] = {}
    for number, result in as_finished(work, tasks, executor):
        found[number] = result
        if progress:
            progress(len(found), len(tasks))
    return [found[number] for number in range(len(tasks))]


@contextmanager
def cluster(address: str, timeout_s: float = 20.0) -> Iterator[Executor]:
    """Connect to a Dask cluster; tasks of lost workers are repeated.

    Raises
    ------
    MissingDependency
        If Dask is not installed.
    SeglocError
        If no scheduler answers, or a task ended several workers.
    """
    with requires("distributed", "cluster", "a Dask cluster"):
        from distributed import Client, KilledWorker
    try:
        client = Client(address, timeout=timeout_s)
    except (OSError, ValueError, TimeoutError) as error:
        raise SeglocError(f"{address}: no Dask scheduler answers") from error
    with client:
        try:
            yield client.get_executor(pure=False, retries=_ATTEMPTS - 1)
        except KilledWorker as error:
            raise SeglocError(
                f"{address}: a task ended several workers, most likely because memory ran out: "
                "give them more memory, or start fewer per machine"
            ) from error


@contextmanager
def executing(workers: int, address: str | None) -> Iterator[Executor | None]:
    """Create processes, or connect to a cluster; None to work in this process."""
    if address is not None:
        with cluster(address) as executor:
            yield executor
    elif workers > 1:
        with single_threaded_pool(workers) as pool:
            yield pool
    else:
        yield None
