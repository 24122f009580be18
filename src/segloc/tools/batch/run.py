"""Localize a whole recording, query by query or in parallel parts, with priors from GNSS."""

from __future__ import annotations

import time
import uuid
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor
from dataclasses import replace
from functools import lru_cache, partial
from typing import TypeAlias

import numpy as np

from ... import geometry
from ...config import Config
from ...errors import ConfigError, DatasetError
from ...frontend.local_cloud import Accumulator, LocalCloudConfig, odometry_pose, window
from ...frontend.rolling_cloud import ScanWindow
from ...localization import Localization
from ...localizer import Localizer
from ...map.georeference import Georeference
from ...prior import Prior
from ...system.processes import as_finished
from ...system.stage_times import Clock, StageTimes
from ...tiles import localizer_in, open_map
from ...types import Float64, Int64, LocalCloud, Pose, Recording, Scan, Scanned, as_recording
from ..datasets.fixes import Fixes
from .score import PROCESSOR

Priors: TypeAlias = Prior | Sequence[Prior | None] | None
"""One prior for all queries, one per query, or none."""
QUERIES = 16
"""Queries per part: enough that neighbouring windows share work."""
LONGEST_GAP_S = 2.0
"""Maximum time between a query and its fix [s]."""
DEFAULT_ERROR_M, SIGMAS = 10.0, 3.0
"""Error assumed if the receiver reports none [m]; radius of a prior in standard deviations."""
MAX_ERROR_M = 500.0
"""Fixes that may be farther off are ignored [m]."""


def query_positions(poses: Float64, every_m: float, max_gap_m: float) -> Int64:
    """Return positions in a sequence, one per ``every_m`` of travel.

    Each is the first scan at the end of such a stretch, so that it can accumulate the stretch. A
    step longer than ``max_gap_m`` is a break in the recording, after which counting restarts.

    Parameters
    ----------
    poses : (N, 4, 4) float64
        NaN for scans without a pose, which are skipped.
    every_m, max_gap_m : float
        In metres.
    """
    known = np.flatnonzero(np.isfinite(poses).all(axis=(1, 2)))
    steps = np.linalg.norm(np.diff(poses[known, :3, 3], axis=0), axis=1)
    breaks = np.flatnonzero(steps > max_gap_m) + 1
    chosen = []
    for part in np.split(known, breaks):
        distance = geometry.distance_travelled(poses[part])
        if len(part):
            chosen.append(part[geometry.stations(distance, every_m, every_m)])
    return np.concatenate(chosen, dtype=np.int64) if chosen else np.empty(0, np.int64)


def localize_sequence(
    localizer: Localizer,
    scans: Scanned,
    positions: Int64,
    progress: Callable[[int, int], None] | None = None,
    near: Priors = None,
) -> list[Localization]:
    """Localize the scans at some positions of a recording, each independently.

    If the recording has poses, a query accumulates the scans before it; otherwise it is a single
    scan. A prior applies to all queries, or there is one (or None) per query. The times of a result
    hold the processor time of the query, too: that of all threads of this process.

    Raises
    ------
    DatasetError
        If a scan cannot be read. An empty scan is "not localized".
    """
    results = []
    for result in localized(localizer, as_recording(scans), positions, near):
        results.append(result)
        if progress:
            progress(len(results), len(positions))
    return results


def localized(
    localizer: Localizer, sequence: Recording, positions: Int64, near: Priors = None
) -> Iterator[Localization]:
    """Yield the answers of :func:`localize_sequence`, one by one."""
    clouds = query_clouds(sequence, positions, localizer.config, localizer.clock)
    begun = time.process_time()
    for (cloud, times), prior in zip(clouds, each_prior(near, len(positions)), strict=True):
        query = localizer.describe(cloud, times)
        result = localizer.locate(query, times, near=prior)
        spent_ms = 1e3 * (time.process_time() - begun)
        yield replace(result, times_ms={**result.times_ms, PROCESSOR: spent_ms})
        begun = time.process_time()


def each_prior(near: Priors, count: int) -> Sequence[Prior | None]:
    """Return the prior of each query.

    Raises
    ------
    ConfigError
        If their number differs from that of the queries.
    """
    if near is None or isinstance(near, Prior):
        return [near] * count
    if len(near) != count:
        raise ConfigError(f"{len(near)} priors for {count} queries")
    return near


def query_clouds(
    sequence: Recording, positions: Int64, config: Config, clock: Clock = time.perf_counter
) -> Iterator[tuple[LocalCloud, StageTimes]]:
    """Yield the local cloud of each query, and its stage times; see :func:`localize_sequence`.

    Consecutive windows share their work.
    """
    local, poses = config.local_cloud, sequence.poses
    accumulator = Accumulator(local)
    voxel_size = config.segmentation.accumulated.voxel_size
    windows = RecordedWindows(sequence.scan, local, voxel_size, local.window_m)
    for position in map(int, positions):
        times = StageTimes(clock)
        if poses is None:
            scan = sequence.scan(position)
            with times("gathering"):
                cloud = accumulator.gather(scan)
        else:
            length, gap = local.window_m, local.max_gap_m
            scans = window(poses, position, length, centred=False, max_gap_m=gap)
            cloud = windows.cloud(scans, position, times)
        yield cloud, times


class RecordedWindows:
    """Local clouds of windows along a recording; each scan is read and thinned once.

    Parameters
    ----------
    read : callable
        Returns the scan at a position of the recording, with its pose.
    config : LocalCloudConfig
    voxel_size : float
        Edge of the lattice [m].
    length_m : float
        Length of the longest window [m].
    """

    def __init__(
        self,
        read: Callable[[int], Scan],
        config: LocalCloudConfig,
        voxel_size: float,
        length_m: float,
    ) -> None:
        self._read = read
        self._window = ScanWindow(config, voxel_size, length_m)

    def cloud(self, scans: range, index: int, times: StageTimes | None = None) -> LocalCloud:
        """Return the local cloud of consecutive scans around one of them.

        Parameters
        ----------
        scans : range
            Positions. A window that begins and ends no earlier than the last one reuses its scans.
        index : int
            Position of the reference scan, one of them.
        times : StageTimes, optional
            Receives the time of "gathering", without reading.

        Raises
        ------
        InvalidScan
            If a scan has no pose.
        """
        window, held = self._window, self._window.numbers
        if held and not (held[0] <= scans.start <= held[-1] < scans.stop):
            window.clear()
            held = ()
        fresh = [self._with_pose(i) for i in scans if not held or i > held[-1]]
        with (times or StageTimes())("gathering"):
            while len(window) and window.numbers[0] < scans.start:
                window.drop(0)
            for i, (scan, T) in zip(scans[len(window) :], fresh, strict=True):
                window.push(i, scan, T)
            return window.cloud(index - scans.start)

    def _with_pose(self, i: int) -> tuple[Scan, Pose]:
        scan = self._read(i)
        return scan, odometry_pose(scan)


@lru_cache(maxsize=2)
def _open(where: str, config: Config, run: str) -> Localizer:
    """Open a map once per process and run, since maps may be replaced between runs."""
    return localizer_in(open_map(where), config)


def _localize(
    where: str,
    config: Config,
    run: str,
    recording: Recording,
    part: tuple[Int64, Sequence[Prior | None]],
) -> list[Localization]:
    """Localize some queries of a recording, in any process; can be repeated."""
    positions, near = part
    return localize_sequence(_open(where, config, run), recording, positions, near=near)


def localize_parts(
    where: str,
    config: Config,
    recording: Recording,
    positions: Int64,
    executor: Executor,
    progress: Callable[[int, int], None] | None = None,
    near: Priors = None,
) -> list[Localization]:
    """Localize the scans at some positions of a recording in parts, by an executor.

    Poses, confidences and reasons equal those of :func:`localize_sequence`, to the last bit; each
    process uses one thread.

    Parameters
    ----------
    where : str
        Map file, or folder or URL of tiles, readable by every worker.
    config : Config
    recording : Recording
        Must be picklable, and its files readable by the workers.
    positions : (Q,) int64
    executor : Executor
        Processes, threads, or a cluster.

    Raises
    ------
    SeglocError
        As localizing does; and if a process was killed and its tasks cannot be repeated.
    """
    single = config.model_copy(update={"threads": 1})
    localized = partial(_localize, where, single, uuid.uuid4().hex, recording)
    chunks = np.array_split(positions, max(1, -(-len(positions) // QUERIES)))
    priors, parts, done = each_prior(near, len(positions)), [], 0
    for chunk in chunks:
        parts.append((chunk, priors[done : done + len(chunk)]))
        done += len(chunk)
    found: dict[int, list[Localization]] = {}
    for number, results in as_finished(localized, parts, executor):
        found[number] = results
        if progress:
            progress(sum(map(len, found.values())), len(positions))
    return [result for number in sorted(found) for result in found[number]]


def gnss_priors(
    fixes: Fixes, georeference: Georeference, stamps: Float64 | None, least_m: float
) -> list[Prior | None]:
    """Make a prior for each query with a GNSS fix close in time.

    A query that is not found near its fix is searched in the whole map: between buildings fixes
    may be far off and underestimate their error.

    Parameters
    ----------
    fixes : Fixes
    georeference : Georeference
        Of the map.
    stamps : (N,) float64 or None
        Of the queries [s].
    least_m : float
        Radius for an exact fix [m]; covers errors of antenna, scan and map.

    Raises
    ------
    DatasetError
        If the queries have no stamps.
    ConfigError, MissingDependency
        As :meth:`segloc.map.georeference.Georeference.in_map`.
    """
    if not least_m > 0:
        raise ConfigError(f"prior: the radius must be above 0 m, not {least_m:g}")
    if stamps is None:
        raise DatasetError(f"{fixes.source}: stamped fixes, but the scans have no stamps")
    xy = georeference.in_map(fixes.degrees)[:, :2]
    error_m = np.where(np.isfinite(fixes.error_m), fixes.error_m, DEFAULT_ERROR_M)
    after = np.searchsorted(fixes.stamps, stamps).clip(1, max(len(fixes) - 1, 1)) % len(fixes)
    before = np.maximum(after - 1, 0)
    sooner = stamps - fixes.stamps[before] <= fixes.stamps[after] - stamps
    nearest = np.where(sooner, before, after)
    priors: list[Prior | None] = []
    for stamp, k in zip(stamps, nearest, strict=True):
        off_m = SIGMAS * float(error_m[k])
        late = abs(fixes.stamps[k] - stamp) > LONGEST_GAP_S
        useless = late or off_m > MAX_ERROR_M or not np.isfinite(xy[k]).all()
        priors.append(None if useless else Prior(xy[k], least_m + off_m, anywhere=True))
    return priors
