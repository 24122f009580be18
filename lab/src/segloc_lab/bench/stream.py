"""A robot that drives on: every scan of a 10 Hz stream taken in, every tenth one localized."""

from __future__ import annotations

import statistics
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from segloc import Localizer, RollingCloud, Scan, SegmentMap, build_map
from segloc.config import Config
from segloc.errors import SeglocError
from segloc.frontend import window
from segloc.localization import Localization
from segloc.map import DEFAULT_METHOD
from segloc.system.stage_times import StageTimes
from segloc.types import Float64

from ..padding import padded_with_copies
from ..stages import clock_for
from . import harness
from .harness import OURS, Row, optional

MAP_SEGMENTS = 50_000
QUERY_EVERY = 10
ANEW = "gathering every query anew"
TOLERANCE_M = 3.0
_STEP_M = 1.0  # 10 m/s
_WINDOWS_M = (41.0, 40.0)  # driven before anything is timed, and timed
_TOWN_M = 250.0
_MAPPED_M = 110.0


@dataclass(frozen=True)
class Stream:
    """Scans with odometry, the first of which only fill the window.

    Attributes
    ----------
    truths : (N, 4, 4) float64
        True T_map_sensor.
    start : int
        The first scan that is timed.
    """

    prior_map: SegmentMap
    scans: list[Scan]
    truths: Float64
    start: int


@dataclass(frozen=True)
class Run:
    """The answers to the queries of a run, and the milliseconds of its parts."""

    answers: list[Localization]
    ms: dict[str, float]


def stream(threads: int, repeats: int) -> Row:
    """Full HDL-64E scans, 64 beams by 1875 firings."""
    return stream_row("stream", simulated_stream("hdl64e", 1875), threads, repeats)


def stream_os1_128(threads: int, repeats: int) -> Row:
    """Ouster OS1-128, 1024 firings."""
    return stream_row("stream_os1_128", simulated_stream("os1-128", 1024), threads, repeats)


def stream_vlp16(threads: int, repeats: int) -> Row:
    """Velodyne VLP-16, 1800 firings."""
    return stream_row("stream_vlp16", simulated_stream("vlp16", 1800), threads, repeats)


def stream_row(name: str, driven: Stream, threads: int, repeats: int) -> Row:
    """Mean milliseconds a scan, queries included; medians of runs, ours and the rival in turns."""
    prior_map = padded_with_copies(driven.prior_map, MAP_SEGMENTS)
    config = Config.preset(prior_map.descriptor).model_copy(update={"threads": threads})
    localizer = Localizer(prior_map, config, clock=clock_for(threads))
    kinds: dict[str, Callable[[], Run]] = {
        OURS: lambda: _rolling(localizer, driven, threads),
        ANEW: lambda: _anew(localizer, driven, threads),
    }
    for run in kinds.values():
        run()
    runs: dict[str, list[Run]] = {kind: [] for kind in kinds}
    for _ in range(repeats):
        for kind, run in kinds.items():
            runs[kind].append(run())
    timed = len(driven.scans) - driven.start
    times = {
        kind: statistics.median(sum(run.ms.values()) for run in each) / timed
        for kind, each in runs.items()
    }
    ours = runs[OURS]
    queries = len(ours[0].answers)
    per = {"adding and dropping": ("a scan", timed), "local cloud": ("a query", queries)}
    details = {
        f"{part}, ms {per[part][0]}": statistics.median(run.ms[part] for run in ours) / per[part][1]
        for part in per
    }
    for stage in ("segmentation", "total"):
        ms = statistics.median(a.times_ms[stage] for run in ours for a in run.answers)
        details[f"{stage} of the rest of a query, ms" if stage == "total" else f"{stage}, ms"] = ms
    details |= {
        "points of a scan": float(np.median([len(scan) for scan in driven.scans])),
        "scans in the window": float(ours[0].answers[-1].counts["scans"]),
        "queries": float(queries),
        **{f"correct, {kind}": float(_correct(each[0], driven)) for kind, each in runs.items()},
    }
    return Row(name, threads, times[OURS], {ANEW: times[ANEW]}, details=details)


def _rolling(localizer: Localizer, driven: Stream, threads: int) -> Run:
    watch, answers = StageTimes(clock_for(threads)), []
    config = localizer.config
    rolling = RollingCloud(config.local_cloud, config.segmentation.accumulated.voxel_size)
    for scan in driven.scans[: driven.start]:
        rolling.add(scan)
    for k, scan in enumerate(driven.scans[driven.start :], 1):
        with watch("adding and dropping"):
            rolling.add(scan)
        if k % QUERY_EVERY == 0:
            with watch("local cloud"):
                cloud = rolling.cloud()
            with watch("localizing"):
                answers.append(localizer.localize(cloud))
    return Run(answers, watch.ms)


def _anew(localizer: Localizer, driven: Stream, threads: int) -> Run:
    watch, answers = StageTimes(clock_for(threads)), []
    local = localizer.config.local_cloud
    poses = np.array([scan.T_odom_sensor for scan in driven.scans])
    for k in range(driven.start + QUERY_EVERY - 1, len(driven.scans), QUERY_EVERY):
        length, gap = local.window_m, local.max_gap_m
        behind = window(poses, k, length, centred=False, max_gap_m=gap)
        with watch("localizing"):
            answers.append(localizer.localize([driven.scans[i] for i in behind]))
    return Run(answers, watch.ms)


def _correct(run: Run, driven: Stream) -> int:
    correct = 0
    for k, answer in enumerate(run.answers, 1):
        if answer.T_map_sensor is None:
            continue
        truth = driven.truths[driven.start + k * QUERY_EVERY - 1]
        error = float(np.linalg.norm(answer.T_map_sensor[:3, 3] - truth[:3, 3]))
        if error > TOLERANCE_M:
            raise SeglocError(f"a query was localized {error:.1f} m off")
        correct += 1
    if not correct:
        raise SeglocError("no query was localized")
    return correct


def simulated_stream(sensor: str, firings: int, method: str = DEFAULT_METHOD) -> Stream:
    """A later drive along a mapped street of a town; a plaza without the simulator."""
    config = Config.preset(method).model_copy(update={"threads": 1})
    if optional("embreex") is None:
        walk = harness.PlazaWalk(harness.Plaza(), steps=2 * QUERY_EVERY)
        scans = [walk.scan(i) for i in range(len(walk))]
        return Stream(build_map(walk, config), scans, walk.poses, QUERY_EVERY)
    from ..simulation import Route, hdl64e, simulate_session, town
    from ..simulation.sensors import SENSORS

    world = town(0, size_m=_TOWN_M)
    junctions = tuple(world.roads.walk(np.random.default_rng(0), [0], _MAPPED_M, avoid=[]))
    mapped = simulate_session(world, 0, Route(junctions, length_m=_MAPPED_M), hdl64e(900), 0)
    again = Route(junctions, 0.3, _STEP_M, sum(_WINDOWS_M))
    later = simulate_session(world, 1, again, SENSORS[sensor](firings), 1).with_odometry()
    scans = [later.scan(i) for i in range(len(later))]
    start = int(np.ceil(_WINDOWS_M[0] / _STEP_M))
    return Stream(build_map(mapped, config), scans, later.truth, start)
