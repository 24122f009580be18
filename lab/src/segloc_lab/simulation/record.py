"""Write simulated scans to a folder that every reader of recordings understands."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Executor
from contextlib import nullcontext
from functools import partial
from os import PathLike
from pathlib import Path

import numpy as np

from segloc.errors import ConfigError, DatasetError
from segloc.io import Trajectory, write_scan, write_tum
from segloc.system.files import replacing
from segloc.system.processes import ProcessPool, as_finished
from segloc.types import Recording

from .motion.traversal import SimulatedSequence

_CHUNK = 8


def record(
    sequence: Recording,
    folder: str | PathLike[str],
    *,
    suffix: str | None = None,
    objects: bool = False,
    executor: Executor | None = None,
    workers: int = 2,
    progress: Callable[[int, int], None] | None = None,
) -> Path:
    """Cast all scans of a sequence and write them with their poses.

    Writes ``000000.npy`` and so on (float32, N x 3, sensor frame) and ``poses.tum``, the true
    T_world_sensor; also ``odometry.tum`` where the sequence's poses are not the truth. Their stamps
    are the seconds at which scans start, where the sensor moves, and else the scans' indices. What
    is written depends neither on the executor nor on the number of workers.

    Parameters
    ----------
    sequence : Recording
        Simulated, or another whose poses are known.
    folder : path
        Made where it does not exist.
    suffix : str, optional
        Of the scans' format; ".npy" by default, ".npz" where the points have times. ".laz" takes
        less room and holds times, too.
    objects : bool
        Also write ``objects/000000.npy`` and so on: which object each point lies on, (N,) int32.
    executor : Executor, optional
        Where to cast; by default a pool of ``workers`` fresh processes, or this process for one
        worker. A script that uses the pool needs the usual ``if __name__ == "__main__":``.
    workers : int
    progress : callable, optional
        Called with (scans done, scans in all).
    """
    if workers < 1:
        raise ConfigError(f"workers must be at least 1, not {workers}")
    if objects and not isinstance(sequence, SimulatedSequence):
        raise ConfigError(f"{sequence.name}: only simulated scans know the objects of their points")
    target = _made(Path(folder))
    if objects:
        _made(target / "objects")
    _write_poses(sequence, target)
    ending = suffix or (".npz" if getattr(sequence, "skew", False) else ".npy")
    chunks = [range(k, min(k + _CHUNK, len(sequence))) for k in range(0, len(sequence), _CHUNK)]
    done = 0
    write = partial(_write_scans, sequence, target, ending, objects)
    alone = executor is not None or workers == 1
    with nullcontext(executor) if alone else ProcessPool(workers) as pool:
        for _, count in as_finished(write, chunks, pool):
            done += count
            if progress is not None:
                progress(done, len(sequence))
    return target


def _made(folder: Path) -> Path:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise DatasetError(f"{folder}: cannot be made: {str(error.strerror).lower()}") from error
    return folder


def _write_poses(sequence: Recording, folder: Path) -> None:
    poses = sequence.poses
    if poses is None:
        raise DatasetError(f"{sequence.name}: a recording without poses cannot be recorded")
    truth = getattr(sequence, "truth", None)
    stamps = getattr(sequence, "stamps", None)
    if stamps is None or not (np.round(stamps, 9) % 1).any():  # whole ones are read as numbers
        stamps = sequence.indices.astype(np.float64)
    write_tum(folder / "poses.tum", Trajectory(stamps, poses if truth is None else truth))
    if truth is not None and not np.array_equal(poses, truth):
        write_tum(folder / "odometry.tum", Trajectory(stamps, poses))


def _write_scans(
    sequence: Recording, folder: Path, suffix: str, objects: bool, indices: range
) -> int:
    for i in indices:
        scan = sequence.scan(i)
        name = f"{sequence.indices[i]:06d}"
        write_scan(folder / f"{name}{suffix}", scan.points, scan.times)
        if objects and isinstance(sequence, SimulatedSequence):
            with replacing(folder / "objects" / f"{name}.npy", sweep=False) as file:
                np.save(file, sequence.object_ids(i))
    return len(indices)
