"""A robot localized online at 10 Hz on one core: share of the way localized, and cost.

    python -m segloc_lab.protocols.live_streams --sensor hdl64e --seeds 5200 5201 5202 5203
    python -m segloc_lab.protocols.live_streams --kitti DATA
    python -m segloc_lab.protocols.live_streams --minutes 60

Each seed is a town that is mapped by a thinned HDL-64E along 500 m, and driven through in another
session, partly beside the map, at 10 m/s with a full scan every metre; a tenth of the things is
replaced. Odometry drifts by half a percent. KITTI 00: the first half of the keyframes is mapped,
and the second followed. Localized: of the scans within 3 m of the mapped path. First fix: the robot
is switched on anew every 20 m of the way. False: metres localized, or degraded with a pose, more
than 2 m (KITTI, whose truth is good to a metre: 3 m) or 10 degrees off. Times are those of the
processor, with one thread. ``--minutes`` instead lets a robot go there and back along a street at
1.5 m/s, and notes its memory every minute. Runs can work at once; ``--add`` adds up.
"""

from __future__ import annotations

import os
import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from segloc import Config, Localizer, Scan, build_map, geometry
from segloc.batch import COVERAGE_RADIUS_M, distances_to_path, pose_errors
from segloc.live import LiveCore, State, Status
from segloc.types import Float64, Int64, Recording

from ..kitti00 import FIRST_HALF, SECOND_HALF, keyframes, poses_of
from ..recordings import kept
from ..report import Cell, Table, entries, keep, publish, resumed
from ..simulation import (
    SCENES,
    SENSORS,
    Conditions,
    OdometryNoise,
    SimulatedSequence,
    simulate_sessions,
)
from ..stages import held_mb

RATE_HZ = 10.0
STEP_M, SLOW_M, STREET_M = 1.0, 0.15, 150.0
STARTS_M, GIVE_UP_M = 20.0, 100.0
OFF_M, KITTI_OFF_M, OFF_DEG = 2.0, 3.0, 10.0
SAMPLE_SCANS = 600


@dataclass(frozen=True)
class Stream:
    """Scans with odometry and true poses.

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
    """Full scans, one metre apart, of a drive through a town mapped on another day."""
    localizer, again = _town(sensor, seed, 330.0, length_m, STEP_M)
    driven = again.with_odometry()
    name = f"town, {sensor}"
    return Stream(name, seed, localizer, kept(driven, root), driven.poses, driven.truth)


def _town(
    sensor: str, seed: int, size_m: float, length_m: float, spacing_m: float
) -> tuple[Localizer, SimulatedSequence]:
    """A mapped town, and a drive through it on another day."""
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
    """State after a scan, and its processor time [ms]."""

    state: State
    scan_ms: float
    query_ms: tuple[float, ...]


def followed(core: LiveCore, scan: Scan, stamp: float, T_odom_sensor: Float64) -> Step:
    """Add a scan, and make its queries."""
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
    """Return the error of a pose [m, deg]; infinite without one."""
    if state.T_map_base is None:
        return float("inf"), float("inf")
    metres, degrees = pose_errors(state.T_map_base[None], truth[None])
    return float(metres[0]), float(degrees[0])


def within_three_sigma(state: State, truth: Float64) -> bool:
    """Return whether the position error is at most three standard deviations."""
    if state.covariance is None or state.T_map_base is None:
        return False
    sigma = float(np.sqrt(np.linalg.eigvalsh(state.covariance[3:, 3:])[-1]))
    return error(state, truth)[0] <= 3.0 * sigma


def right(metres: float, degrees: float, off_m: float) -> bool:
    """Return whether a pose is within the tolerance."""
    return metres <= off_m and degrees <= OFF_DEG


def stream_record(stream: Stream) -> dict[str, Any]:
    """Localize along a stream, and restart along it."""
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
    degraded = [
        within_three_sigma(step.state, T)
        for step, T in zip(steps, stream.truths, strict=True)
        if step.state.status is Status.DEGRADED
    ]
    return {
        "stream": stream.name,
        "seed": stream.seed,
        "scans": len(steps),
        "covered": int(covered.sum()),
        "localized": int((sure & covered & ~off).sum()),
        "false_m": round(float(metres[sure & off].sum()), 2),
        "degraded_false_m": round(float(metres[~sure & off].sum()), 2),
        "degraded": len(degraded),
        "degraded_within": sum(degraded),
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
    path = stream.localizer.prior_map.trajectory
    return np.asarray(distances_to_path(stream.truths, path) <= COVERAGE_RADIUS_M)


def _first_fixes(stream: Stream, covered: np.ndarray) -> list[float | None]:
    """Return metres until localized, from places of the map; None off the map's trajectory."""
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
    """Drive back and forth along a street with a VLP-16; sample memory every minute."""
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
    """Yield positions from first to last and back, repeatedly."""
    lap = np.concatenate([np.arange(count), np.arange(count - 2, 0, -1)])
    return np.resize(lap, total).astype(np.int64)


os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")


COLUMNS = (
    "stream",
    "scans",
    "localized",
    "starts",
    "first fix, median / 95 % (m)",
    "false (m)",
    "degraded and false (m)",
    "degraded within three sigma",
    "error, median / 95 % (m)",
    "a scan, median / 99 % (ms)",
    "a query, median / 99 % (ms)",
    "share of a core at 10 Hz",
)
MEMORY_COLUMNS = (
    "minutes",
    "scans",
    "memory (MB)",
    "localized",
    "false (m)",
    "share of a core at 10 Hz",
)
MINUTES = (1, 5, 10, 20, 30, 40, 50, 60)


def table(records: list[dict[str, Any]]) -> list[tuple[Cell, ...]]:
    """Return one row per kind of stream."""
    rows: list[tuple[Cell, ...]] = []
    for name in sorted({r["stream"] for r in records}):
        here = [r for r in records if r["stream"] == name]
        total = {key: sum(r[key] for r in here) for key in _SUMS}
        fixes = [np.inf if fix is None else fix for r in here for fix in r["first_fix"]]
        scan, query = (_joined(here, key) for key in ("scan_ms", "query_ms"))
        share = total["localized"] / max(1, total["covered"])
        load = (scan.sum() + query.sum()) / 1e3 * RATE_HZ / max(1, len(scan))
        rows.append(
            (
                name,
                total["scans"],
                f"{100 * share:.1f} %",
                len(fixes),
                _spread(fixes, 95, 0),
                round(total["false_m"], 1),
                round(total["degraded_false_m"], 1),
                f"{total['degraded_within']} of {total['degraded']}",
                _spread(_joined(here, "errors"), 95, 2),
                _spread(scan, 99, 1),
                _spread(query, 99, 0),
                f"{load:.2f}",
            )
        )
    return rows


_SUMS = (
    "scans",
    "covered",
    "localized",
    "false_m",
    "degraded_false_m",
    "degraded",
    "degraded_within",
)


def _joined(records: list[dict[str, Any]], key: str) -> Float64:
    return np.concatenate([np.asarray(r[key], dtype=np.float64) for r in records])


def _spread(values: Iterable[float], high: int, digits: int) -> str:
    found = np.sort(np.asarray(list(values), dtype=np.float64))
    if not len(found):
        return "-"
    ranks = [found[min(len(found) - 1, int(np.ceil(q / 100 * len(found))) - 1)] for q in (50, high)]
    return " / ".join("never" if np.isinf(v) else f"{v:.{digits}f}" for v in ranks)


def memory_table(samples: list[dict[str, Any]]) -> list[tuple[Cell, ...]]:
    """Return some of the samples, and the last."""
    chosen = [s for s in samples if s["minute"] in MINUTES or s is samples[-1]]
    return [
        (
            s["minute"],
            s["scans"],
            round(s["mb"], 1),
            f"{100 * s['localized'] / s['scans']:.1f} %",
            round(s["false_m"], 1),
            f"{s['seconds'] * RATE_HZ / s['scans']:.2f}",
        )
        for s in chosen
    ]


def report(records: list[dict[str, Any]], folder: Path | None) -> None:
    """Publish the tables of the streams, and of memory if measured."""
    streams = [r for r in records if "stream" in r]
    samples = sorted((r for r in records if "minute" in r), key=lambda s: float(s["minute"]))
    tables = [Table(COLUMNS, table(streams), title="Streams")] if streams else []
    if samples:
        last = samples[len(samples) // 2 :]
        slope = np.polyfit([s["scans"] for s in last], [s["mb"] for s in last], 1)[0]
        note = f"In the second half memory grows by {1e3 * slope:.3f} MB a thousand scans."
        tables.append(Table(MEMORY_COLUMNS, memory_table(samples), note, "Memory"))
    publish(folder, "Robots followed on one core", *tables)


def read(paths: Iterable[Path]) -> list[dict[str, Any]]:
    """Return the records of earlier runs."""
    return [entry for path in paths for entry in entries(path)]


def main() -> None:
    options = resumed(__doc__, "streams.jsonl")
    options.add_argument("--sensor", choices=("hdl64e", "vlp16"), default="vlp16")
    options.add_argument("--seeds", type=int, nargs="*", default=[5200])
    options.add_argument("--length", type=float, default=500.0, help="metres of each")
    options.add_argument("--kitti", type=Path, metavar="DATA")
    options.add_argument(
        "--minutes", type=int, help="minutes of stream over which memory is measured"
    )
    options.add_argument("--seconds", type=float, default=np.inf, help="begin nothing after these")
    options.add_argument("--scans", type=Path, help="a folder to keep simulated scans in")
    args = options.parse_args()
    if args.add:
        report(read(args.add), args.report)
        return
    ends = time.monotonic() + args.seconds
    earlier = read([args.out]) if args.out.exists() else []
    done = {(r.get("stream"), r.get("seed")) for r in earlier}
    if args.minutes:
        for sample in memory(args.seeds[0], args.minutes, args.scans or Path("scans"), ends):
            keep(args.out, sample)
    elif args.kitti:
        keep(args.out, stream_record(kitti00_stream(args.kitti)))
    else:
        for seed in args.seeds:
            if (f"town, {args.sensor}", seed) in done or time.monotonic() > ends:
                continue
            keep(args.out, stream_record(town_stream(args.sensor, seed, args.length, args.scans)))
    report(read([args.out]), args.report)


if __name__ == "__main__":
    main()
