"""Write simulated scans to a folder that every reader of recordings understands."""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable
from concurrent.futures import Executor, ProcessPoolExecutor, as_completed
from contextlib import nullcontext
from os import PathLike
from pathlib import Path

import numpy as np

from ..errors import ConfigError
from ..io.scans import write_scan
from ..io.trajectory import Trajectory, write_tum
from .traversal import SimulatedSequence

_CHUNK = 8


def record(
    sequence: SimulatedSequence,
    folder: str | PathLike[str],
    *,
    executor: Executor | None = None,
    workers: int = 2,
    progress: Callable[[int, int], None] | None = None,
) -> Path:
    """Cast all scans of a sequence and write them with their poses.

    Writes ``000000.npy`` and so on (float32, N x 3, sensor frame) and ``poses.tum``, the true
    T_world_sensor with the scan's index in place of a stamp; also ``odometry.tum`` where the
    sequence's poses are not the truth. What is written depends neither on the executor nor on the
    number of workers.

    Parameters
    ----------
    sequence : SimulatedSequence
    folder : path
        Made where it does not exist.
    executor : Executor, optional
        Where to cast; by default a pool of ``workers`` fresh processes, or this process for one
        worker. A script that uses the pool needs the usual ``if __name__ == "__main__":``.
    workers : int
    progress : callable, optional
        Called with (scans done, scans in all).

    Raises
    ------
    ConfigError
        If ``workers`` is below 1.
    DatasetError
        If a file cannot be written.
    """
    if workers < 1:
        raise ConfigError(f"workers must be at least 1, not {workers}")
    target = Path(folder)
    target.mkdir(parents=True, exist_ok=True)
    stamps = sequence.indices.astype(np.float64)
    write_tum(target / "poses.tum", Trajectory(stamps, sequence.truth))
    if not np.array_equal(sequence.poses, sequence.truth):
        write_tum(target / "odometry.tum", Trajectory(stamps, sequence.poses))
    chunks = [range(k, min(k + _CHUNK, len(sequence))) for k in range(0, len(sequence), _CHUNK)]
    done = 0

    def advance(count: int) -> None:
        nonlocal done
        done += count
        if progress is not None:
            progress(done, len(sequence))

    if executor is None and workers == 1:
        for chunk in chunks:
            advance(_write_scans(sequence, target, chunk))
        return target
    with process_pool(workers) if executor is None else nullcontext(executor) as pool:
        futures = [pool.submit(_write_scans, sequence, target, chunk) for chunk in chunks]
        for future in as_completed(futures):
            advance(future.result())
    return target


def process_pool(workers: int) -> ProcessPoolExecutor:
    """A pool of fresh processes: forked ones would inherit the ray caster's stopped threads."""
    return ProcessPoolExecutor(workers, mp_context=multiprocessing.get_context("spawn"))


def _write_scans(sequence: SimulatedSequence, folder: Path, indices: range) -> int:
    for i in indices:
        write_scan(folder / f"{sequence.indices[i]:06d}.npy", sequence.scan(i).points)
    return len(indices)
