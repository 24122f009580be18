"""A robot localized online at 10 Hz on one core: share of the way localized, and cost.

    python -m segloc_lab.protocols.live_streams --sensor hdl64e --seeds 5200 5201 5202 5203
    python -m segloc_lab.protocols.live_streams --kitti DATA
    python -m segloc_lab.protocols.live_streams --minutes 60 --sensor os1-64

Each seed is a town that is mapped by a thinned HDL-64E along 500 m, and driven through in another
session, partly beside the map, at 10 m/s with a full scan every metre; a tenth of the things is
replaced. Odometry drifts by half a percent. KITTI 00: the first half of the keyframes is mapped,
and the second followed. Localized: of the scans within 3 m of the mapped path. First fix: the robot
is switched on anew every 20 m of the way. False: metres localized, or degraded with a pose, more
than 2 m (KITTI, whose truth is good to a metre: 3 m) or 10 degrees off. Times are those of the
processor, with one thread.

``--minutes`` instead lets a robot with nothing but a LiDAR go there and back along a mapped street
at 1.5 m/s, with odometry from its scans. Processor time by stage and resident memory are noted
after every tenth; it fails if memory then grows by 5 % or more after the first tenth. Runs can work
at once; ``--add`` adds up.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from segloc import Config, Localizer, Scan, build_map, geometry
from segloc.live import LidarOdometry, LiveCore, State, Status
from segloc.system.stage_times import StageTimes
from segloc.tools.batch import COVERAGE_RADIUS_M, distances_to_path
from segloc.types import Float32, Float64, Int64, Recording

from ..kitti00 import FIRST_HALF, SECOND_HALF, keyframes, poses_of
from ..outcomes import pose_error
from ..recordings import Kept, kept
from ..report import Cell, Table, publish
from ..runner import Runner
from ..simulation import (
    SCENES,
    SENSORS,
    Conditions,
    Lidar,
    OdometryNoise,
    Route,
    simulate_session,
    simulate_sessions,
)
from ..stages import held_mb, processor_clock
from .follower import Follower, Taken, taken

RATE_HZ = 10.0
STEP_M, SLOW_M, STREET_M = 1.0, 0.15, 40.0
STARTS_M, GIVE_UP_M = 20.0, 100.0
OFF_M, KITTI_OFF_M, OFF_DEG = 2.0, 3.0, 10.0
TENTHS, MAX_GROWTH = 10, 0.05

Sample = dict[str, Any]
Message = tuple[str, int]
"""``"odometry"`` or ``"scan"``, and its position."""


@dataclass(frozen=True)
class Stream:
    """Scans with odometry and true poses.

    Attributes
    ----------
    odometry, truths : (N, 4, 4) float64
    off_m : float
        What is farther off is false.
    rate_hz : float
        Of scans.
    starts_m, give_up_m : float
        Travel between the starts of a first fix (infinite: none), and until it is given up.
    messages : sequence of Message or None
        What arrives, in order; None: the odometry of each scan, then the scan.
    follower : Follower or None
        Follows the robot instead of this version.
    """

    name: str
    seed: int
    localizer: Localizer
    recording: Recording
    odometry: Float64
    truths: Float64
    off_m: float = OFF_M
    rate_hz: float = RATE_HZ
    starts_m: float = STARTS_M
    give_up_m: float = GIVE_UP_M
    messages: Sequence[Message] | None = None
    follower: Follower | None = None


def town_stream(sensor: str, seed: int, length_m: float, root: Path | None) -> Stream:
    """Full scans, one metre apart, of a drive through a town mapped on another day."""
    world = SCENES["town"](seed, size_m=330.0)
    days = [Conditions(), Conditions(replaced=0.1)]
    mapped = simulate_sessions(world, SENSORS["hdl64e"](900), days, length_m=length_m, seed=seed)[0]
    again = simulate_sessions(
        world, SENSORS[sensor](), days, length_m=length_m, spacing_m=STEP_M, seed=seed
    )[1]
    driven = again.with_odometry()
    name = f"town, {sensor}"
    return Stream(name, seed, _localizer(mapped), kept(driven, root), driven.poses, driven.truth)


def kitti00_stream(data: Path) -> Stream:
    """Keyframes of the second half of KITTI 00 in a map of the first."""
    drive = keyframes(data, SECOND_HALF)
    truths = poses_of(drive)
    odometry = OdometryNoise().odometry(truths, np.random.default_rng(0))
    localizer = _localizer(keyframes(data, FIRST_HALF))
    return Stream("KITTI 00, keyframes", 0, localizer, drive, odometry, truths, KITTI_OFF_M)


def _localizer(mapped: Recording) -> Localizer:
    config = Config(threads=1)
    return Localizer(build_map(mapped, config), config, clock=processor_clock)


@dataclass(frozen=True)
class Step:
    """State after a scan, and its processor time [ms]."""

    state: State
    scan_ms: float
    query_ms: tuple[float, ...]


def robot_of(stream: Stream) -> Callable[[float, Float32 | None, Float64 | None], Taken]:
    """Switch on a robot; return what takes a stamp with points, odometry or both."""
    if stream.follower is None:
        return partial(taken, LiveCore(stream.localizer, T_base_sensor=np.eye(4)))
    stream.follower.start()
    return stream.follower.take


def within_three_sigma(state: State, truth: Float64) -> bool:
    """Return whether the position error is at most three standard deviations."""
    if state.covariance is None or state.T_map_base is None:
        return False
    sigma = float(np.sqrt(np.linalg.eigvalsh(state.covariance[3:, 3:])[-1]))
    return pose_error(state.T_map_base, truth)[0] <= 3.0 * sigma


def right(metres: float, degrees: float, off_m: float) -> bool:
    """Return whether a pose is within the tolerance."""
    return metres <= off_m and degrees <= OFF_DEG


def stream_record(stream: Stream) -> dict[str, Any]:
    """Localize along a stream, and restart along it."""
    steps = list(_all(stream))
    covered = is_covered(stream)
    sure = np.array([step.state.status is Status.LOCALIZED for step in steps])
    # Of the time that a state is of: without new scans or odometry it is an earlier one.
    at = [round(step.state.stamp * stream.rate_hz) for step in steps]
    truths = stream.truths[np.clip(at, 0, len(steps) - 1)]
    errors = [pose_error(step.state.T_map_base, T) for step, T in zip(steps, truths, strict=True)]
    off = np.array(
        [
            step.state.localized and not right(*each, stream.off_m)
            for step, each in zip(steps, errors, strict=True)
        ]
    )
    metres = np.diff(geometry.distance_travelled(stream.truths), prepend=0.0)
    degraded = [
        within_three_sigma(step.state, T)
        for step, T in zip(steps, truths, strict=True)
        if step.state.status is Status.DEGRADED
    ]
    return {
        "stream": stream.name,
        "seed": stream.seed,
        "scans": len(steps),
        "covered": int(covered.sum()),
        "localized": int((sure & covered & ~off).sum()),
        "at": np.flatnonzero(sure & ~off).tolist(),
        "false_m": round(float(metres[sure & off].sum()), 2),
        "degraded_false_m": round(float(metres[~sure & off].sum()), 2),
        "degraded": len(degraded),
        "degraded_within": sum(degraded),
        "errors": np.round(np.array(errors)[sure & ~off, 0], 3).tolist(),
        "scan_ms": [round(step.scan_ms, 2) for step in steps],
        "query_ms": [round(ms, 2) for step in steps for ms in step.query_ms],
        "first_fix": _first_fixes(stream, covered),
    }


def _all(stream: Stream) -> Iterator[Step]:
    """Yield one step a scan of a stream: its messages up to the next scan."""
    if stream.messages is None:
        yield from _along(stream, range(len(stream.odometry)))
        return
    follow, steps = robot_of(stream), dict[int, Step]()
    last, nothing = 0, Step(State(0.0, Status.LOST), 0.0, ())
    for what, i in stream.messages:
        points = stream.recording.scan(i).points if what == "scan" else None
        odometry = stream.odometry[i] if what == "odometry" else None
        step = Step(*follow(i / stream.rate_hz, points, odometry))
        last = max(last, i)
        before = steps.get(last, nothing)
        times = before.scan_ms + step.scan_ms, before.query_ms + step.query_ms
        steps[last] = Step(step.state, *times)
    for i in range(len(stream.odometry)):
        nothing = steps.get(i, replace(nothing, scan_ms=0.0, query_ms=()))
        yield nothing


def _along(stream: Stream, positions: range) -> Iterator[Step]:
    follow = robot_of(stream)
    for i in positions:
        points = stream.recording.scan(i).points
        yield Step(*follow(i / stream.rate_hz, points, stream.odometry[i]))


def is_covered(stream: Stream) -> np.ndarray:
    """Return which scans are near the mapped path, (N,)."""
    path = stream.localizer.prior_map.trajectory
    return np.asarray(distances_to_path(stream.truths, path) <= COVERAGE_RADIUS_M)


def _first_fixes(stream: Stream, covered: np.ndarray) -> list[float | None]:
    """Return metres until localized, and rightly so, from places of the map; None if never."""
    if stream.starts_m == np.inf:
        return []
    travelled, found = geometry.distance_travelled(stream.truths), []
    for start in np.arange(0.0, travelled[-1], stream.starts_m):
        first = int(np.searchsorted(travelled, start))
        stays = covered[first : int(np.searchsorted(travelled, start + stream.give_up_m))]
        last = first + (len(stays) if stays.all() else int(stays.argmin()))
        if travelled[min(last, len(travelled) - 1)] - travelled[first] < stream.give_up_m / 2:
            continue
        steps = enumerate(_along(stream, range(first, last)), first)
        fixed = (
            travelled[i]
            for i, step in steps
            if step.state.status is Status.LOCALIZED
            and right(*pose_error(step.state.T_map_base, stream.truths[i]), stream.off_m)
        )
        at = next(fixed, None)
        found.append(None if at is None else round(float(at - travelled[first]), 1))
    return found


def alone(
    sensor: str, seed: int, minutes: float, root: Path, ends: float, thin: int = 1
) -> Iterator[Sample]:
    """Go there and back along a street with a LiDAR alone; return a sample after every tenth."""
    localizer, recording = _street(SENSORS[sensor]().thinned(thin), seed, root)
    positions = there_and_back(len(recording), round(minutes * 60 * RATE_HZ))
    for i in set(positions.tolist()):
        recording.scan(i)  # cast before anything is measured
    core, odometry = LiveCore(localizer, T_base_sensor=np.eye(4)), LidarOdometry()
    times, localized, false_m = StageTimes(processor_clock), 0, 0.0
    for k, i in enumerate(positions.tolist(), 1):
        _add_alone(core, odometry, Scan(recording.scan(i).points), k / RATE_HZ, times)
        sure = core.state.status is Status.LOCALIZED
        localized += sure
        off = pose_error(core.state.T_map_base, recording.truth[i])
        false_m += SLOW_M * (sure and not right(*off, OFF_M))
        if k * TENTHS // len(positions) > (k - 1) * TENTHS // len(positions):
            yield {
                "minutes": minutes,
                "sensor": f"{sensor}, one firing in {thin}" if thin > 1 else sensor,
                "scans": k,
                "mb": round(held_mb(), 2),
                "localized": localized,
                "false_m": round(false_m, 2),
                "losses": odometry.losses,
                "ms": {stage: round(ms / k, 3) for stage, ms in times.ms.items()},
            }
        if time.monotonic() > ends:
            return


def _street(lidar: Lidar, seed: int, root: Path) -> tuple[Localizer, Kept]:
    """A mapped street, and slow scans along it in another lane, on another day."""
    world = SCENES["town"](seed, size_m=200.0)
    junctions = tuple(world.roads.walk(np.random.default_rng(seed), [0], STREET_M, avoid=[]))
    way = Route(junctions, length_m=STREET_M)
    mapped = simulate_session(world, 0, way, SENSORS["hdl64e"](900), seed)
    again = replace(way, lane_offset_m=0.3, spacing_m=SLOW_M)
    changed = Conditions(replaced=0.1)
    driven = simulate_session(world, 1, again, lidar, seed, conditions=changed)
    return _localizer(mapped), kept(driven, root)


def _add_alone(
    core: LiveCore, odometry: LidarOdometry, scan: Scan, stamp: float, times: StageTimes
) -> None:
    """Add a scan as ``LiveCore(lidar_odometry=True)`` does, and make its queries."""
    segmented, lost = 0.0, odometry.losses
    with times("odometry"):
        poses = odometry.add(scan, stamp)
    with times("scan"):
        for known, T in poses:
            core.add_odometry(known, T)
        if odometry.losses > lost:
            core.report_lost_motion(odometry.fault)
        core.add_scan(scan, stamp)
    with times("query"):
        while (asked := core.due()) is not None:
            made = core.ask(asked)
            core.answer(asked, made)
            if made.found is not None:
                segmented += made.found[2].times_ms["segmentation"]
    times.ms["segmentation"] = times.ms.get("segmentation", 0.0) + segmented


def there_and_back(count: int, total: int) -> Int64:
    """Yield positions from first to last and back, repeatedly."""
    lap = np.concatenate([np.arange(count), np.arange(count - 2, 0, -1)])
    return np.resize(lap, total).astype(np.int64)


def table(records: list[dict[str, Any]]) -> Table:
    """Return a table with one row per kind of stream."""
    rows: list[dict[str, Cell]] = []
    for name in sorted({r["stream"] for r in records}):
        here = [r for r in records if r["stream"] == name]
        numbers = [key for key, value in here[0].items() if isinstance(value, int | float)]
        total = {key: sum(r[key] for r in here) for key in numbers}
        fixes = [np.inf if fix is None else fix for r in here for fix in r["first_fix"]]
        scan, query = (_joined(here, key) for key in ("scan_ms", "query_ms"))
        share = total["localized"] / max(1, total["covered"])
        load = (scan.sum() + query.sum()) / 1e3 * RATE_HZ / max(1, len(scan))
        rows.append(
            {
                "stream": name,
                "scans": total["scans"],
                "localized": f"{100 * share:.1f} %",
                "starts": len(fixes),
                "first fix, median / 95 % (m)": spread(fixes, 95, 0),
                "false (m)": round(total["false_m"], 1),
                "degraded and false (m)": round(total["degraded_false_m"], 1),
                "degraded within three sigma": f"{total['degraded_within']} of {total['degraded']}",
                "error, median / 95 % (m)": spread(_joined(here, "errors"), 95, 2),
                "a scan, median / 99 % (ms)": spread(scan, 99, 1),
                "a query, median / 99 % (ms)": spread(query, 99, 0),
                "share of a core at 10 Hz": f"{load:.2f}",
            }
        )
    return Table.of(rows, title="Streams")


def _joined(records: list[dict[str, Any]], key: str) -> Float64:
    return np.concatenate([np.asarray(r[key], dtype=np.float64) for r in records])


def spread(values: Iterable[float], high: int, digits: int) -> str:
    """Return the median and a higher percentile as text."""
    found = np.sort(np.asarray(list(values), dtype=np.float64))
    if not len(found):
        return "-"
    ranks = [found[min(len(found) - 1, int(np.ceil(q / 100 * len(found))) - 1)] for q in (50, high)]
    return " / ".join("never" if np.isinf(v) else f"{v:.{digits}f}" for v in ranks)


def alone_table(samples: list[Sample]) -> list[dict[str, Cell]]:
    """Return one row per tenth; times are means from the first scan on."""
    rows: list[dict[str, Cell]] = []
    for s in samples:
        odometry, scan, query, segmentation = (
            s["ms"][stage] for stage in ("odometry", "scan", "query", "segmentation")
        )
        rows.append(
            {
                "scans": s["scans"],
                "memory (MB)": f"{s['mb']:.1f}",
                "localized": f"{100 * s['localized'] / s['scans']:.1f} %",
                "false (m)": round(s["false_m"], 1),
                "odometry lost": s["losses"],
                "odometry (ms a scan)": f"{odometry:.1f}",
                "scan, de-skewed and accumulated (ms)": f"{scan:.1f}",
                "segmentation of queries (ms)": f"{segmentation:.1f}",
                "rest of queries (ms)": f"{query - segmentation:.1f}",
                "share of a core at 10 Hz": f"{(odometry + scan + query) * RATE_HZ / 1e3:.2f}",
            }
        )
    return rows


def growth(samples: list[Sample]) -> float:
    """Return by which share memory grows, at most, after the first tenth."""
    first, *later = (float(s["mb"]) for s in samples)
    return max(later, default=first) / first - 1.0


def report(records: list[dict[str, Any]], folder: Path | None) -> None:
    """Publish the tables of the streams, and of a LiDAR alone if measured."""
    streams = [r for r in records if "stream" in r]
    tables = [table(streams)] if streams else []
    for sensor, samples in samples_of(records).items():
        minutes = samples[-1]["scans"] / RATE_HZ / 60
        title = f"A LiDAR alone ({sensor}), {minutes:.1f} minutes of stream"
        note = (
            f"After the first row memory grows by {100 * growth(samples):.1f} % "
            f"(limit {100 * MAX_GROWTH:g} %). Times are of the processor, one thread."
        )
        tables.append(Table.of(alone_table(samples), note, title))
    publish(folder, "Robots followed on one core", *tables)


def samples_of(records: list[dict[str, Any]]) -> dict[str, list[Sample]]:
    """Return the samples of each sensor that was alone."""
    samples: dict[str, list[Sample]] = {}
    for record in records:
        if "minutes" in record:
            samples.setdefault(record["sensor"], []).append(record)
    return samples


def main() -> None:
    runner = Runner(__doc__, "streams.jsonl", choosing=("seeds", "scans"))
    add = runner.options.add_argument
    add("--sensor", choices=("hdl64e", "os1-64", "vlp16"), default="vlp16")
    add("--seeds", type=int, nargs="*", default=[5200])
    add("--length", type=float, default=500.0, help="metres of each")
    add("--kitti", type=Path, metavar="DATA")
    add("--minutes", type=float, help="minutes of stream of a LiDAR alone")
    add("--thin", type=int, default=1, help="one firing in COUNT, for --minutes")
    add("--scans", type=Path, help="a folder to keep simulated scans in")
    args = runner.parse()
    if args.minutes and not args.add:
        ends, where = time.monotonic() + args.seconds, args.scans or Path("scans")
        for sample in alone(args.sensor, args.seeds[0], args.minutes, where, ends, args.thin):
            runner.keep(sample)
    elif args.kitti and not args.add:
        runner.keep(stream_record(kitti00_stream(args.kitti)))
    seeds = [] if args.minutes or args.kitti else args.seeds
    records = runner.run(
        lambda seed: stream_record(town_stream(args.sensor, seed, args.length, args.scans)),
        seeds,
        ("stream", "seed"),
        lambda seed: (f"town, {args.sensor}", seed),
    )
    report(records, args.report)
    for sensor, samples in samples_of(records).items():
        if growth(samples) >= MAX_GROWTH:
            raise SystemExit(f"{sensor}: memory grows by {100 * growth(samples):.1f} %")


if __name__ == "__main__":
    main()
