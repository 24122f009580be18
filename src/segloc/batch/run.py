"""Localizing a whole recording, query by query."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from .. import geometry
from ..local_cloud import LocalCloudConfig, window
from ..localization import Localization
from ..types import Float64, Int64, Recording, Scan

if TYPE_CHECKING:
    from ..localizer import Localizer

_SCANS_IN_MEMORY = 64


def query_positions(poses: Float64, every_m: float, max_gap_m: float) -> Int64:
    """Positions in a sequence, one for every so many metres of travel.

    Each is the first scan at the end of such a stretch, so that it has the stretch behind it. A
    step longer than ``max_gap_m`` is a break in the recording: counting begins anew behind it.

    Parameters
    ----------
    poses : (N, 4, 4) float64
    every_m, max_gap_m : float
        Metres.
    """
    steps = np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1)
    breaks = np.flatnonzero(steps > max_gap_m) + 1
    chosen = []
    for part in np.split(np.arange(len(poses)), breaks):
        distance = geometry.travelled(poses[part])
        if len(part):
            chosen.append(part[geometry.stations(distance, every_m, every_m)])
    return np.concatenate(chosen, dtype=np.int64) if chosen else np.empty(0, np.int64)


def localize_sequence(
    localizer: Localizer,
    sequence: Recording,
    positions: Int64,
    progress: Callable[[int, int], None] | None = None,
) -> list[Localization]:
    """Localize the scans at some positions of a sequence, each by itself.

    Where the sequence has poses, a query gathers the scans of the path behind it; otherwise it is
    the one scan alone.

    Raises
    ------
    DatasetError
        If a scan cannot be read. A scan that is empty or shows nothing is "not localized".
    """
    results = []
    for scans in query_scans(sequence, positions, localizer.config.local_cloud):
        results.append(localizer.localize(scans))
        if progress:
            progress(len(results), len(positions))
    return results


def query_scans(
    sequence: Recording, positions: Int64, config: LocalCloudConfig
) -> Iterator[list[Scan]]:
    """The scans that each query gathers; see :func:`localize_sequence`."""
    read = lru_cache(_SCANS_IN_MEMORY)(sequence.scan)  # windows overlap
    poses = sequence.poses
    for position in map(int, positions):
        scans = range(position, position + 1)
        if poses is not None:
            length, gap = config.window_m, config.max_gap_m
            scans = window(poses, position, length, centred=False, max_gap_m=gap)
        yield [read(i) for i in scans]
