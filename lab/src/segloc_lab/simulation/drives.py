"""Where sessions lead: the way that is mapped, and ways that come back to it."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Executor
from contextlib import nullcontext
from functools import partial
from itertools import pairwise
from os import PathLike
from pathlib import Path

import numpy as np

from segloc.errors import ConfigError, DatasetError
from segloc.system.files import replacing
from segloc.system.processes import ProcessPool, as_finished
from segloc.tools.io import Trajectory, write_scan, write_tum
from segloc.types import Recording

from .motion.platforms import Platform, Route
from .motion.traversal import SimulatedSequence, simulate_session
from .sensors.ranging import Lidar
from .worlds.world import Conditions, World

_LANES = (1.1, 0.2, 0.7, -0.4, 0.9)  # metres right of the centre line, session by session
_LANE_OF = 3.4  # half the width of a street that has room for all of these, metres


def mapped_way(world: World, rng: np.random.Generator, length_m: float) -> list[int]:
    """At least ``length_m`` through a world, by streets not taken before while there are any."""
    start = int(rng.integers(len(world.roads.nodes)))
    return world.roads.walk(rng, [start], length_m, avoid=[])


def way_back(
    world: World, rng: np.random.Generator, mapped: list[int], length_m: float
) -> list[int]:
    """Along the mapped way, off into streets it never took, back onto it the other way.

    Of several such drives the one whose three parts are most alike in length.
    """
    roads = world.roads
    if len(mapped) < 3:
        return roads.walk(rng, mapped[::-1], length_m, avoid=mapped)
    drives = []
    for _ in range(32):
        first = int(rng.integers(len(mapped) - 2))
        last = first + 2
        while last < len(mapped) and roads.length(mapped[first:last]) < 0.3 * length_m:
            last += 1
        route = roads.walk(rng, mapped[first:last], 0.2 * length_m, avoid=mapped)
        route = roads.join(route, mapped[::-1])
        left = max(0.0, length_m - roads.length(route))
        drives.append(roads.walk(rng, route, left, avoid=mapped))
    return max(drives, key=lambda route: min(_shares(world, route, mapped, length_m)))


def _shares(
    world: World, route: list[int], mapped: list[int], length: float
) -> tuple[float, float, float]:
    """Metres of the first ``length`` driven along a mapped route, against it, and off it."""
    with_it, against = set(pairwise(mapped)), set(pairwise(mapped[::-1]))
    shares, left = [0.0, 0.0, 0.0], length
    for pair in pairwise(route):
        metres = min(left, world.roads.length(list(pair)))
        shares[0 if pair in with_it else 1 if pair in against else 2] += metres
        left -= metres
    return shares[0], shares[1], shares[2]


def lane(world: World, session: int) -> float:
    """Metres right of the centre line, another in each session; less where ways are narrow."""
    return _LANES[session % len(_LANES)] * lane_scale(world)


def lane_scale(world: World) -> float:
    """The share of a lane's distance from the centre line that the ways of a world have room for.

    A lane is meant for streets of 3.4 m to either side.
    """
    return min(1.0, min(street.half_width for street in world.roads.streets) / _LANE_OF)


def simulate_sessions(
    world: World,
    sensor: Lidar,
    conditions: list[Conditions],
    *,
    length_m: float,
    spacing_m: float = 2.0,
    seed: int = 0,
    platform: Platform | None = None,
    skew: bool = False,
    storey: int = 0,
) -> list[SimulatedSequence]:
    """One drive for each of the conditions, ``session_0`` and so on; their poses are the truth.

    Session 0 is the one to map. Each later one drives part of its way in another lane, leaves it
    for ways that the map never saw, and comes back along it in the opposite direction.

    Parameters
    ----------
    conditions : list of Conditions
        Of each session.
    length_m : float
        Of each drive.
    spacing_m : float
        Between scans.
    seed : int
        Of routes and noise.
    platform : Platform, optional
        What carries the sensor; without one it is put from place to place at its own height.
    skew : bool
        Let the sensor move while it scans.
    storey : int
        Of a building; the ways are the same on all.
    """
    if not 0 < length_m < np.inf:
        raise ConfigError(f"length_m must be positive, not {length_m}")
    rng = np.random.default_rng([seed, 31])
    mapped = mapped_way(world, rng, length_m)
    drives = []
    for k, condition in enumerate(conditions):
        way = mapped if k == 0 else way_back(world, rng, mapped, length_m)
        route = Route(tuple(way), lane(world, k), spacing_m, length_m, storey)
        drives.append(
            simulate_session(
                world,
                k,
                route,
                sensor,
                seed,
                name=f"session_{k}",
                conditions=condition,
                platform=platform,
                skew=skew,
            )
        )
    return drives


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
