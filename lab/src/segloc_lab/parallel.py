"""Tasks of a study, by processes or an executor; a run that is cut off goes on."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor
from pathlib import Path
from typing import Any, Protocol

from rich.progress import track

from segloc.system.processes import Result, Task, as_finished, single_threaded_pool

from .report import earlier, entries, keep


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


def kept_results(
    out: Path,
    work: Callable[[Task], dict[str, Any]],
    tasks: Sequence[Task],
    done: Callable[[Task, list[dict[str, Any]]], bool],
    *,
    workers: int = 1,
    what: str = "tasks",
) -> list[dict[str, Any]]:
    """Return the results of tasks; each is kept in a file of JSON lines as it comes.

    Parameters
    ----------
    out : Path
        Results of earlier runs are kept; their tasks are left out.
    work, tasks, workers
        As of :func:`in_parallel`.
    done : callable
        Whether earlier results hold that of a task.
    what : str
        Name of the tasks beside the progress.
    """
    before = earlier(out)
    left = [task for task in tasks if not done(task, before)]
    found = in_parallel(work, left, workers)
    for _, result in track(found, what, total=len(left)):
        keep(out, result)
    return entries(out) if out.exists() else []


class Named(Protocol):
    """A world with a name."""

    @property
    def name(self) -> str: ...


def world_is_done(world: Named, results: list[dict[str, Any]]) -> bool:
    """Return whether results name a world."""
    return any(result["world"] == world.name for result in results)
