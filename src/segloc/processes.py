"""Independent work in several processes."""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing import resource_tracker
from typing import Any, TypeVar

from .errors import MissingDependency, SeglocError

Task = TypeVar("Task")
Result = TypeVar("Result")

_BLAS_THREADS = "OPENBLAS_NUM_THREADS"


class _Pool(ProcessPoolExecutor):
    """Processes that Ctrl-C, which a terminal sends them too, reaches only while they work.

    Elsewhere, such as while they start, it would end them in a traceback of many lines. A process
    begins with the signals blocked that are blocked where it is made.
    """

    def submit(self, fn: Callable[..., Any], /, *given: Any, **named: Any) -> Future[Any]:
        if os.name == "posix":
            resource_tracker.ensure_running()  # or it is started below, and unblocks the signal
        with _interrupts("SIG_BLOCK"):
            return super().submit(_work, fn, *given, **named)


@contextmanager
def _interrupts(way: str) -> Iterator[None]:
    """Hold interrupts back until the block is over, or let them through in it; not on Windows."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(getattr(signal, way), {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


_interrupted = False  # then what else is queued for this process is not begun


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


def process_pool(workers: int) -> ProcessPoolExecutor:
    """A pool of fresh processes: forked ones would inherit the ray caster's stopped threads."""
    return _Pool(workers, mp_context=multiprocessing.get_context("spawn"))


@contextmanager
def single_threaded_pool(workers: int) -> Iterator[Executor]:
    """Processes with one thread each for linear algebra: more would wait for each other."""
    before = os.environ.get(_BLAS_THREADS)
    os.environ[_BLAS_THREADS] = "1"
    try:
        with process_pool(workers) as pool:
            yield pool
    finally:
        if before is None:
            del os.environ[_BLAS_THREADS]
        else:
            os.environ[_BLAS_THREADS] = before


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


@contextmanager
def cluster(address: str, timeout_s: float = 20.0) -> Iterator[Executor]:
    """What runs tasks on a Dask cluster; a task whose worker is lost is done again.

    Raises
    ------
    MissingDependency
        If Dask is not installed.
    SeglocError
        If no scheduler answers there.
    """
    try:
        from distributed import Client
    except ImportError as error:
        raise MissingDependency("distributed", "cluster", "a Dask cluster") from error
    try:
        client = Client(address, timeout=timeout_s)
    except (OSError, ValueError, TimeoutError) as error:
        raise SeglocError(f"{address}: no Dask scheduler answers there") from error
    with client:
        yield client.get_executor(pure=False, retries=3)


@contextmanager
def executing(workers: int, address: str | None) -> Iterator[Executor | None]:
    """Several processes, or a cluster; None where this process is to do it."""
    if address is not None:
        with cluster(address) as executor:
            yield executor
    elif workers > 1:
        with single_threaded_pool(workers) as pool:
            yield pool
    else:
        yield None
