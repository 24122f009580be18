"""Streams of scans, and a robot followed along them in one thread, by the processor's clock."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from segloc import Config, Localizer, Scan, build_map, geometry
from segloc.batch.score import COVERAGE_RADIUS_M, distances_to_path, pose_errors
from segloc.live import LiveCore, State, Status
from segloc.types import Float64, Int64, Recording

from ..kitti00 import FIRST_HALF, SECOND_HALF, keyframes, poses_of
from ..memory import held_mb
from ..recordings import kept
from ..simulation import (
    SCENES,
    SENSORS,
    Conditions,
    OdometryNoise,
    SimulatedSequence,
    simulate_sessions,
)

RATE_HZ = 10.0
STEP_M, SLOW_M, STREET_M = 1.0, 0.15, 150.0
STARTS_M, GIVE_UP_M = 20.0, 100.0
OFF_M, KITTI_OFF_M, OFF_DEG = 2.0, 3.0, 10.0
SAMPLE_SCANS = 600


@dataclass(frozen=True)
class Stream:
    """Scans, where odometry says they were, and where they were.

    Attributes
    ----------
    odometry, truths : (N, 4, 4) float64
    off_m : float
        What is farther off is false.
    """

    name: str
    seed: int
    localizer: Localizer
    recording: Recording
    odometry: Float64
    truths: Float64
    off_m: float = OFF_M


def town_stream(sensor: str, seed: int, length_m: float, root: Path | None) -> Stream:
    """Full scans, a metre apart, of a drive through a town that was mapped on another day."""
    localizer, again = _town(sensor, seed, 330.0, length_m, STEP_M)
    driven = again.with_odometry()
    name = f"town, {sensor}"
    return Stream(name, seed, localizer, kept(driven, root), driven.poses, driven.truth)


def _town(
    sensor: str, seed: int, size_m: float, length_m: float, spacing_m: float
) -> tuple[Localizer, SimulatedSequence]:
    """A town that was mapped, and a drive through it on another day."""
    world = SCENES["town"](seed, size_m=size_m)
    days = [Conditions(), Conditions(replaced=0.1)]
    mapped = simulate_sessions(world, SENSORS["hdl64e"](900), days, length_m=length_m, seed=seed)[0]
    driven = simulate_sessions(
        world, SENSORS[sensor](), days, length_m=length_m, spacing_m=spacing_m, seed=seed
    )[1]
    return _localizer(mapped), driven


def kitti00_stream(data: Path) -> Stream:
    """Keyframes of the second half of KITTI 00 in a map of the first."""
    drive = keyframes(data, SECOND_HALF)
    truths = poses_of(drive)
    odometry = OdometryNoise().odometry(truths, np.random.default_rng(0))
    localizer = _localizer(keyframes(data, FIRST_HALF))
    return Stream("KITTI 00, keyframes", 0, localizer, drive, odometry, truths, KITTI_OFF_M)


def _localizer(mapped: Recording) -> Localizer:
    config = Config(threads=1)
    return Localizer(build_map(mapped, config), config)


@dataclass(frozen=True)
class Step:
    """What was said after a scan, and what it cost; milliseconds of the processor."""

    state: State
    scan_ms: float
    query_ms: tuple[float, ...]


def followed(core: LiveCore, scan: Scan, stamp: float, T_odom_sensor: Float64) -> Step:
    """Let a scan be taken in, and its queries be answered."""
    begun = time.process_time()
    core.add_odometry(stamp, T_odom_sensor)
    core.add_scan(scan, stamp)
    taken, queries = time.process_time(), []
    scan_ms = 1e3 * (taken - begun)
    while (asked := core.due()) is not None:
        core.answer(asked, core.ask(asked))
        queries.append(1e3 * (time.process_time() - taken))
        taken = time.process_time()
    return Step(core.state, scan_ms, tuple(queries))


def error(state: State, truth: Float64) -> tuple[float, float]:
    """Metres and degrees that a pose is off; infinite without one."""
    if state.T_map_base is None:
        return float("inf"), float("inf")
    metres, degrees = pose_errors(state.T_map_base[None], truth[None])
    return float(metres[0]), float(degrees[0])


def right(metres: float, degrees: float, off_m: float) -> bool:
    """Whether a pose is where it is said to be."""
    return metres <= off_m and degrees <= OFF_DEG


def stream_record(stream: Stream) -> dict[str, Any]:
    """Follow a robot along all of a stream, and switch it on anew along it."""
    steps = list(_along(stream, range(len(stream.odometry))))
    covered = _covered(stream)
    sure = np.array([step.state.status is Status.LOCALIZED for step in steps])
    errors = [error(s.state, T) for s, T in zip(steps, stream.truths, strict=True)]
    off = np.array(
        [
            step.state.localized and not right(*each, stream.off_m)
            for step, each in zip(steps, errors, strict=True)
        ]
    )
    metres = np.diff(geometry.travelled(stream.truths), prepend=0.0)
    return {
        "stream": stream.name,
        "seed": stream.seed,
        "scans": len(steps),
        "covered": int(covered.sum()),
        "localized": int((sure & covered & ~off).sum()),
        "false_m": round(float(metres[sure & off].sum()), 2),
        "degraded_false_m": round(float(metres[~sure & off].sum()), 2),
        "errors": np.round(np.array(errors)[sure & ~off, 0], 3).tolist(),
        "scan_ms": [round(step.scan_ms, 2) for step in steps],
        "query_ms": [round(ms, 2) for step in steps for ms in step.query_ms],
        "first_fix": _first_fixes(stream, covered),
    }


def _along(stream: Stream, positions: range) -> Iterator[Step]:
    core = LiveCore(stream.localizer, T_base_sensor=np.eye(4))
    for i in positions:
        scan = Scan(stream.recording.scan(i).points)
        yield followed(core, scan, i / RATE_HZ, stream.odometry[i])


def _covered(stream: Stream) -> np.ndarray:
    path = stream.localizer.in_one_piece().prior_map.trajectory
    return np.asarray(distances_to_path(stream.truths, path) <= COVERAGE_RADIUS_M)


def _first_fixes(stream: Stream, covered: np.ndarray) -> list[float | None]:
    """Metres driven until localized, from places of the map on; None: not on the map's path."""
    travelled, found = geometry.travelled(stream.truths), []
    for start in np.arange(0.0, travelled[-1], STARTS_M):
        first = int(np.searchsorted(travelled, start))
        stays = covered[first : int(np.searchsorted(travelled, start + GIVE_UP_M))]
        last = first + (len(stays) if stays.all() else int(stays.argmin()))
        if travelled[min(last, len(travelled) - 1)] - travelled[first] < GIVE_UP_M / 2:
            continue
        steps = enumerate(_along(stream, range(first, last)), first)
        fixed = (travelled[i] for i, step in steps if step.state.status is Status.LOCALIZED)
        at = next(fixed, None)
        found.append(None if at is None else round(float(at - travelled[first]), 1))
    return found


def memory(seed: int, minutes: int, root: Path, ends: float) -> Iterator[dict[str, Any]]:
    """A robot with a VLP-16 goes there and back along a street; a sample every minute."""
    localizer, driven = _town("vlp16", seed, 200.0, STREET_M, SLOW_M)
    recording = kept(driven, root)
    positions = there_and_back(len(driven), round(minutes * 60 * RATE_HZ))
    truths = driven.truth[positions]
    odometry = OdometryNoise().odometry(truths, np.random.default_rng(seed))
    for i in range(len(driven)):
        recording.scan(i)  # cast before anything is measured
    core = LiveCore(localizer, T_base_sensor=np.eye(4))
    localized, false_m, seconds = 0, 0.0, 0.0
    for k, i in enumerate(positions.tolist()):
        step = followed(core, Scan(recording.scan(i).points), k / RATE_HZ, odometry[k])
        sure = step.state.status is Status.LOCALIZED
        localized += sure
        false_m += SLOW_M * (sure and not right(*error(step.state, truths[k]), OFF_M))
        seconds += (step.scan_ms + sum(step.query_ms)) / 1e3
        if (k + 1) % SAMPLE_SCANS == 0:
            yield {
                "minute": (k + 1) // SAMPLE_SCANS,
                "scans": k + 1,
                "mb": round(held_mb(), 2),
                "localized": localized,
                "false_m": round(false_m, 2),
                "seconds": round(seconds, 2),
            }
        if time.monotonic() > ends:
            return


def there_and_back(count: int, total: int) -> Int64:
    """Positions from the first to the last, back to the first, and so on."""
    lap = np.concatenate([np.arange(count), np.arange(count - 2, 0, -1)])
    return np.resize(lap, total).astype(np.int64)
