"""Localizing a whole recording, query by query."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING, Protocol, TypeAlias

import numpy as np

from .. import geometry
from ..config import Config
from ..errors import ConfigError
from ..frontend.local_cloud import Accumulator, window
from ..frontend.rolling_cloud import RecordedWindows
from ..localization import Localization
from ..prior import Prior
from ..system.stage_times import Clock, StageTimes
from ..types import Float64, Int64, LocalCloud, Recording

if TYPE_CHECKING:
    from ..proposals.proposer import Query


Priors: TypeAlias = Prior | Sequence[Prior | None] | None
"""One for all queries, or one for each, or none."""


class Locates(Protocol):
    """What localizes: a :class:`segloc.Localizer`, or one in tiles."""

    @property
    def config(self) -> Config: ...
    @property
    def clock(self) -> Clock: ...
    def describe(self, scans: LocalCloud, times: StageTimes | None = None) -> Query: ...
    def locate(
        self,
        query: Query,
        times: StageTimes | None = None,
        deadline_ms: float | None = None,
        near: Prior | None = None,
    ) -> Localization: ...


def query_positions(poses: Float64, every_m: float, max_gap_m: float) -> Int64:
    """Positions in a sequence, one for every so many metres of travel.

    Each is the first scan at the end of such a stretch, so that it has the stretch behind it. A
    step longer than ``max_gap_m`` is a break in the recording: counting begins anew behind it.

    Parameters
    ----------
    poses : (N, 4, 4) float64
        NaN where there is none: such scans are left out.
    every_m, max_gap_m : float
        Metres.
    """
    known = np.flatnonzero(np.isfinite(poses).all(axis=(1, 2)))
    steps = np.linalg.norm(np.diff(poses[known, :3, 3], axis=0), axis=1)
    breaks = np.flatnonzero(steps > max_gap_m) + 1
    chosen = []
    for part in np.split(known, breaks):
        distance = geometry.travelled(poses[part])
        if len(part):
            chosen.append(part[geometry.stations(distance, every_m, every_m)])
    return np.concatenate(chosen, dtype=np.int64) if chosen else np.empty(0, np.int64)


def localize_sequence(
    localizer: Locates,
    sequence: Recording,
    positions: Int64,
    progress: Callable[[int, int], None] | None = None,
    near: Priors = None,
) -> list[Localization]:
    """Localize the scans at some positions of a sequence, each by itself.

    Where the sequence has poses, a query gathers the scans of the path behind it; otherwise it is
    the one scan alone. With a prior all of them are near it; or there is one for each, or None.

    Raises
    ------
    DatasetError
        If a scan cannot be read. A scan that is empty or shows nothing is "not localized".
    """
    results = []
    clouds = query_clouds(sequence, positions, localizer.config, localizer.clock)
    for (cloud, times), prior in zip(clouds, each_prior(near, len(positions)), strict=True):
        query = localizer.describe(cloud, times)
        results.append(localizer.locate(query, times, near=prior))
        if progress:
            progress(len(results), len(positions))
    return results


def each_prior(near: Priors, count: int) -> Sequence[Prior | None]:
    """The prior of each query.

    Raises
    ------
    ConfigError
        If there are not as many as queries.
    """
    if near is None or isinstance(near, Prior):
        return [near] * count
    if len(near) != count:
        raise ConfigError(f"{len(near)} priors for {count} queries")
    return near


def query_clouds(
    sequence: Recording, positions: Int64, config: Config, clock: Clock = time.perf_counter
) -> Iterator[tuple[LocalCloud, StageTimes]]:
    """The local cloud of each query, and how long it took to gather; see :func:`localize_sequence`.

    Windows that follow one another share their work.
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
