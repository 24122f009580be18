"""Who does tasks: threads, processes, and a cluster of two workers of which one is killed."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import contextmanager
from typing import Any

import pytest

from samples.plaza import Plaza, PlazaSequence
from segloc import geometry
from segloc.system.processes import ProcessPool, cluster, single_threaded_pool

Progress = Callable[[int, int], None]


def nothing(done: int, total: int) -> None:
    """A progress that nobody looks at."""


@contextmanager
def threads() -> Iterator[tuple[Executor, Progress]]:
    """Two threads of this process."""
    with ThreadPoolExecutor(2) as executor:
        yield executor, nothing


@contextmanager
def processes() -> Iterator[tuple[Executor, Progress]]:
    """Two processes, one of which is killed when the first task is done."""
    with single_threaded_pool(2) as pool:
        assert isinstance(pool, ProcessPool)
        yield pool, _killing(lambda: list(pool._pool._processes))


@contextmanager
def dask() -> Iterator[tuple[Executor, Progress]]:
    """Dask's cluster of two workers, one of which is killed when the first task is done.

    Its dashboard takes any port that is free: others may test at the same time.
    """
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, dashboard_address=":0"
    ) as local:
        pids = [worker.process.pid for worker in local.workers.values()]
        with cluster(local.scheduler_address) as executor:
            yield executor, _killing(lambda: pids)


def _killing(pids: Callable[[], list[int]]) -> Progress:
    killed: list[int] = []

    def kill_one(done: int, total: int) -> None:
        if done and not killed:
            killed.append(pids()[0])
            os.kill(killed[0], signal.SIGKILL)

    return kill_one


EXECUTORS: dict[str, Any] = {"threads": threads, "processes": processes, "dask": dask}


class Walk(PlazaSequence):
    """A walk across a plaza along another lane."""

    def __init__(self, plaza: Plaza, lane: float, steps: int = 6, name: str = "plaza") -> None:
        super().__init__(plaza, steps)
        self.name = name
        self.poses = self.poses.copy()
        self.poses[:, 1, 3] += lane


class Moved(Walk):
    """The same in a frame of its own."""

    def __init__(self, plaza: Plaza, lane: float, steps: int) -> None:
        super().__init__(plaza, lane, steps)
        self.poses = geometry.yaw_transform(lane, (40.0 * lane, 7.0, 0.0)) @ self.poses


def square(number: int) -> int:
    """A task that takes no time."""
    return number * number
